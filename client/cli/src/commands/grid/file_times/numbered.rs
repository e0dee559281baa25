//! Files with numbers in their names, which `--every` spaces evenly.
//!
//! Invariant: a notice names two files that follow each other; names without a common form have none.

use std::path::PathBuf;

use super::name_of;

/// The conflicts between the numbers in the names and even times: a gap, or another order.
pub(super) fn notice(files: &[PathBuf]) -> Option<String> {
    let names: Vec<String> = files.iter().map(|file| name_of(file)).collect();
    let parts = names.iter().map(|name| numbered(name)).collect::<Option<Vec<_>>>()?;
    let (first, last) = (parts.first()?, parts.last()?);
    if names.len() < 3 || parts.iter().any(|part| (part.0, part.2) != (first.0, first.2)) {
        return None;
    }
    let steps = || parts.windows(2).map(|pair| i128::from(pair[1].1) - i128::from(pair[0].1));
    let pair = |at: usize| Some((names.get(at)?, names.get(at + 1)?));
    if let Some((one, next)) = steps().position(|step| step <= 0).and_then(pair) {
        return Some(format!(
            "{one} comes before {next}: --every gives the files their times in the order given. --times-from PATTERN \
             takes the times from their names"
        ));
    }
    let step = steps().min()?;
    let (one, next) = steps().position(|other| other != step).and_then(pair)?;
    let span = i128::from(last.1) - i128::from(first.1);
    let missing = if span % step == 0 {
        format!("{} of {} are missing", span / step + 1 - names.len() as i128, span / step + 1)
    } else {
        "the steps between the numbers differ".to_owned()
    };
    Some(format!(
        "the numbers in the names have a gap from {one} to {next} ({missing}): with --every, the files after it get times \
         that are too early. --times-from PATTERN or --times-file CSV gives each file its own time"
    ))
}

/// A name in three parts: the text before its last number, the number, and the text after it, without the ending.
fn numbered(name: &str) -> Option<(&str, u64, &str)> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let end = stem.rfind(|character: char| character.is_ascii_digit())? + 1;
    let start = stem[..end]
        .rfind(|character: char| !character.is_ascii_digit())
        .map_or(0, |before| before + stem[before..].chars().next().map_or(1, char::len_utf8));
    Some((&stem[..start], stem[start..end].parse().ok()?, &stem[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn notice_for(names: &[&str]) -> String {
        let files: Vec<PathBuf> = names.iter().map(|name| PathBuf::from("maps").join(name)).collect();
        notice(&files).unwrap_or_default()
    }

    #[test]
    fn a_gap_and_another_order_are_noticed() {
        assert_eq!(notice_for(&["m_0001.yaml", "m_0002.yaml", "m_0003.yaml"]), "");
        assert_eq!(notice_for(&["m_10.yaml", "m_20.yaml", "m_30.yaml"]), "");
        let gap = notice_for(&["m_0001.yaml", "m_0002.yaml", "m_0005.yaml", "m_0006.yaml"]);
        assert!(gap.contains("from m_0002.yaml to m_0005.yaml (2 of 6 are missing)"), "{gap}");
        let uneven = notice_for(&["m_1é.yaml", "m_3é.yaml", "m_6é.yaml"]);
        assert!(uneven.contains("from m_3é.yaml to m_6é.yaml (the steps"), "{uneven}");
        let turned = notice_for(&["m_1.yaml", "m_10.yaml", "m_2.yaml"]);
        assert!(turned.contains("m_10.yaml comes before m_2.yaml"), "{turned}");
        for others in
            [&["a.yaml", "b.yaml", "c.yaml"][..], &["a1.yaml", "b2.yaml", "c9.yaml"], &["m_1.yaml", "m_9.yaml"]]
        {
            assert_eq!(notice_for(others), "", "{others:?}");
        }
    }
}

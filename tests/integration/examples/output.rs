//! Whether the output of a block of commands is the one on its page.

/// Matches any text in a line, or any number of lines.
const ANYTHING: char = '…';

/// Compares line by line; only the number of spaces between words may differ.
pub(crate) fn matches(expected: &str, shown: &str) -> bool {
    let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
    let lines = |text: &str| text.lines().map(words).filter(|line| !line.is_empty()).collect::<Vec<_>>();
    lines_match(&lines(expected), &lines(shown))
}

fn lines_match(expected: &[String], shown: &[String]) -> bool {
    match expected.split_first() {
        None => shown.is_empty(),
        Some((line, rest)) if line.chars().eq([ANYTHING]) => {
            (0..=shown.len()).any(|skipped| lines_match(rest, &shown[skipped..]))
        }
        Some((line, rest)) => {
            shown.split_first().is_some_and(|(first, others)| line_matches(line, first) && lines_match(rest, others))
        }
    }
}

fn line_matches(expected: &str, shown: &str) -> bool {
    let mut parts = expected.split(ANYTHING);
    let Some(mut rest) = parts.next().and_then(|start| shown.strip_prefix(start)) else { return false };
    let parts: Vec<&str> = parts.collect();
    let Some((end, middle)) = parts.split_last() else { return rest.is_empty() };
    for part in middle {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(end)
}

/// The output that a page should have instead, with its dots: lines that match any number of lines stay if the lines
/// around them are found, and a word that ends in dots is as long as before.
pub(crate) fn renewed(expected: &str, shown: &str) -> String {
    let (old, new): (Vec<&str>, Vec<&str>) = (expected.lines().collect(), shown.lines().collect());
    let is_gap = |line: &str| line.trim().chars().eq([ANYTHING]);
    if !old.iter().any(|line| is_gap(line)) {
        return lines_renewed(&old, &new);
    }
    // The lines between gaps are found by what is not a fraction in them.
    let mut rest = new.as_slice();
    let mut found = String::new();
    for line in &old {
        if is_gap(line) {
            found.push_str(line);
            found.push('\n');
            continue;
        }
        let found_by = |is_line: &dyn Fn(&str) -> bool| rest.iter().position(|new| is_line(new));
        let at = found_by(&|new| key(new) == key(line)).or_else(|| found_by(&|new| first(new) == first(line)));
        let Some(at) = at else { return lines_renewed(&old, &new) };
        found.push_str(&lines_renewed(&[line], &rest[at..=at]));
        rest = &rest[at + 1..];
    }
    found
}

/// The words of a line that stay if predictions change.
fn key(line: &str) -> Vec<&str> {
    line.split_whitespace().filter(|word| !word.contains(['.', ANYTHING]) && *word != "0").collect()
}

/// The word that names the subject of a line, where its columns have changed.
fn first(line: &str) -> Option<&str> {
    line.split_whitespace().next()
}

fn lines_renewed(old: &[&str], new: &[&str]) -> String {
    let renewed = |(number, line): (usize, &&str)| match old.get(number) {
        Some(old) if old.split_whitespace().count() == line.split_whitespace().count() => line_renewed(old, line),
        _ => (*line).to_owned(),
    };
    new.iter().enumerate().map(|line| renewed(line).trim_end().to_owned() + "\n").collect()
}

/// The line that was shown, with the dots of the old one: columns keep the places that they have on the screen.
fn line_renewed(old: &str, shown: &str) -> String {
    let mut line = shown.to_owned();
    for (old, word) in old.split_whitespace().zip(shown.split_whitespace()) {
        let Some(dots) = old.find(ANYTHING) else { continue };
        let new = if line_matches(old, word) {
            old.to_owned()
        } else {
            word.chars().take(old[..dots].chars().count()).chain([ANYTHING]).collect()
        };
        let space = " ".repeat(word.chars().count().saturating_sub(new.chars().count()));
        line = line.replacen(word, &(new + &space), 1);
    }
    line
}

#[test]
fn a_new_output_keeps_the_dots() {
    assert_eq!(renewed("a 0.9…\n…\nz 1.5\n…\n", "a 0.63\nb\nc\nz 1.6\nd\n"), "a 0.6…\n…\nz 1.6\n…\n");
    assert_eq!(renewed("t 12…  5\n", "t 1234 6\n"), "t 12…  6\n");
    assert_eq!(renewed("a\n", "b\nc\n"), "b\nc\n");
    assert_eq!(renewed("…\nx y 1\nz 2\n", "a\nx w\nz 2\n"), "…\nx w\nz 2\n");
}

#[test]
fn only_dots_and_spaces_may_differ() {
    assert!(matches("a  b\n", "a b\n"));
    assert!(matches("a 0.9…\n…\nz\n", "a 0.93\nb\nc\nz\n"));
    assert!(matches("…\n", ""));
    assert!(matches("x … y … z\n", "x 1 y 2 z\n"));
    assert!(!matches("a\n", "a\nb\n"));
    assert!(!matches("a\n", "ab\n"));
    assert!(!matches("a…b\n", "a 1 c\n"));
    assert!(!matches("a…a\n", "a\n"));
}

//! Whether a block of commands showed what its page says.

/// Stands for any text in a line, or for any number of lines.
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

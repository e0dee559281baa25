//! Patterns of names.
//!
//! Invariant: a pattern without `*` and `?` fits exactly the name that it is.

/// Whether a name matches a pattern: `*` matches any characters, `?` one.
#[must_use]
pub fn matches(pattern: &[char], name: &[char]) -> bool {
    let (mut at, mut read) = (0, 0);
    // After the last `*`, and how far that one reaches.
    let mut star: Option<(usize, usize)> = None;
    while let Some(&letter) = name.get(read) {
        match pattern.get(at) {
            Some('*') => {
                at += 1;
                star = Some((at, read));
            }
            Some(&one) if one == '?' || one == letter => (at, read) = (at + 1, read + 1),
            _ => {
                let Some((after, reach)) = star else { return false };
                star = Some((after, reach + 1));
                (at, read) = (after, reach + 1);
            }
        }
    }
    pattern.get(at..).is_some_and(|rest| rest.iter().all(|one| *one == '*'))
}

#[test]
fn a_star_is_any_letters_and_a_question_mark_one() {
    let fits =
        |pattern: &str, name: &str| matches(&pattern.chars().collect::<Vec<_>>(), &name.chars().collect::<Vec<_>>());
    for (pattern, name) in
        [("door", "door"), ("d*r", "door"), ("d*", "d"), ("*", ""), ("d??r", "door"), ("*o*", "door")]
    {
        assert!(fits(pattern, name), "{pattern} {name}");
    }
    for (pattern, name) in [("door", "doors"), ("d?r", "door"), ("*s", "door"), ("", "d")] {
        assert!(!fits(pattern, name), "{pattern} {name}");
    }
}

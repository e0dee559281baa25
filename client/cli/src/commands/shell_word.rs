//! Words of advised commands, as a shell takes them.
//!
//! Invariant: a shell that reads the quoted word gets the word.

/// A word as a shell takes it.
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./:=,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[test]
fn a_word_is_quoted_where_a_shell_would_cut_it() {
    assert_eq!(["a-b/c=1,d", "the door", "", "it's"].map(quoted), ["a-b/c=1,d", "'the door'", "''", r"'it'\''s'"]);
}

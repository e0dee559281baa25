//! Pages of lists: a token is the number of entries before the page.
//!
//! Invariant: the pages of a list that does not change follow each other without gaps, and the last has no token.

use std::ops::Range;

use super::InvalidField;

/// The page that a request asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    start: usize,
    size: usize,
}

impl Page {
    /// The range of the page in a list of `len` entries, and the token of the next page; empty: there is none.
    #[must_use]
    pub fn within(self, len: usize) -> (Range<usize>, String) {
        let start = self.start.min(len);
        let end = len.min(start + self.size);
        (start..end, if end < len { end.to_string() } else { String::new() })
    }
}

/// The page of a request; its size is `default` if it is 0, and `max` at most.
///
/// # Errors
/// A size above `max`, or a token that did not come from a reply.
pub fn page_from_wire(page_size: u32, token: &str, default: usize, max: usize) -> Result<Page, InvalidField> {
    let size = match usize::try_from(page_size).unwrap_or(usize::MAX) {
        0 => default,
        size if size <= max => size,
        size => return Err(InvalidField::new("page_size", format!("{size} is too many: at most {max}"))),
    };
    let foreign = |_| InvalidField::new("page_token", format!("{token:?} is not from a reply"));
    let start = if token.is_empty() { 0 } else { token.parse::<usize>().map_err(foreign)? };
    Ok(Page { start, size })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_follow_each_other_to_the_end() {
        let page = |size, token| page_from_wire(size, token, 10, 20);
        let within = |size, token| page(size, token).expect("right").within(25);
        assert_eq!(within(0, ""), (0..10, "10".to_owned()));
        assert_eq!(within(0, "10"), (10..20, "20".to_owned()));
        assert_eq!(within(0, "20"), (20..25, String::new()));
        assert_eq!(within(20, "99"), (25..25, String::new()));
        assert_eq!(page(21, "").expect_err("too many").field, "page_size");
        assert_eq!(page(0, "x").expect_err("no token").field, "page_token");
    }
}

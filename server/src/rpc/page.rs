//! Pages of lists: a token is the number of entries before the page.

use tidemap_proto::convert::InvalidField;

use super::status::RpcError;

/// The range of a page in a list of `len` entries, and the token of the next page.
///
/// # Errors
/// A page size above `max`, or an invalid token.
pub(super) fn page(
    len: usize,
    page_size: u32,
    default: usize,
    max: usize,
    token: &str,
) -> Result<(std::ops::Range<usize>, String), RpcError> {
    let size = match usize::try_from(page_size).unwrap_or(usize::MAX) {
        0 => default,
        size if size <= max => size,
        size => return Err(InvalidField::new("page_size", format!("{size} is too many: at most {max}")).into()),
    };
    let start = match token {
        "" => 0,
        token => token
            .parse::<usize>()
            .map_err(|_| InvalidField::new("page_token", format!("{token:?} did not come from a reply")))?,
    };
    let start = start.min(len);
    let end = len.min(start + size);
    Ok((start..end, if end < len { end.to_string() } else { String::new() }))
}

#[cfg(test)]
mod tests {
    use super::{RpcError, page as typed_page};
    use tidemap_proto::convert::InvalidField;

    fn page(
        len: usize,
        size: u32,
        default: usize,
        max: usize,
        token: &str,
    ) -> Result<(std::ops::Range<usize>, String), InvalidField> {
        typed_page(len, size, default, max, token).map_err(|error| match error {
            RpcError::Field(field) => field,
            other => panic!("{other}"),
        })
    }

    #[test]
    fn pages_follow_each_other_to_the_end() {
        assert_eq!(page(25, 0, 10, 20, ""), Ok((0..10, "10".to_owned())));
        assert_eq!(page(25, 0, 10, 20, "10"), Ok((10..20, "20".to_owned())));
        assert_eq!(page(25, 0, 10, 20, "20"), Ok((20..25, String::new())));
        assert_eq!(page(25, 20, 10, 20, "99"), Ok((25..25, String::new())));
        assert_eq!(page(25, 21, 10, 20, "").expect_err("too many").field, "page_size");
        assert_eq!(page(25, 0, 10, 20, "x").expect_err("no token").field, "page_token");
    }
}

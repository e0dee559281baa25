//! Splitting a line into fields.
//!
//! Invariant: a row is a line. A quoted field may contain commas and doubled quotes, but no line break, so that a
//! missing quote invalidates one row and not the rest of the file.

use std::borrow::Cow;

/// The fields of a line. Blanks around a field are ignored, except within quotes.
///
/// # Errors
/// The fault of the quotes.
pub fn split(line: &str) -> Result<Vec<Cow<'_, str>>, &'static str> {
    let mut fields = Vec::with_capacity(4);
    let mut rest = line;
    loop {
        let (field, after) = match rest.trim_start_matches([' ', '\t']).strip_prefix('"') {
            Some(quoted) => quoted_field(quoted)?,
            None => match rest.split_once(',') {
                Some((field, after)) => (Cow::Borrowed(field.trim()), Some(after)),
                None => (Cow::Borrowed(rest.trim()), None),
            },
        };
        fields.push(field);
        match after {
            Some(after) => rest = after,
            None => return Ok(fields),
        }
    }
}

/// A field after its opening quote, and the rest after the next comma.
fn quoted_field(text: &str) -> Result<(Cow<'_, str>, Option<&str>), &'static str> {
    let mut field = String::new();
    let mut rest = text;
    loop {
        let Some((piece, after)) = rest.split_once('"') else { return Err("a quote is not closed") };
        field.push_str(piece);
        if let Some(after) = after.strip_prefix('"') {
            field.push('"');
            rest = after;
            continue;
        }
        let after = after.trim_start();
        return match after.strip_prefix(',') {
            Some(after) => Ok((Cow::Owned(field), Some(after))),
            None if after.is_empty() => Ok((Cow::Owned(field), None)),
            None => Err("there is text between a closing quote and the comma"),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_split_as_spreadsheets_write_them() {
        for (line, fields) in [
            ("1,door,0", vec!["1", "door", "0"]),
            ("1, door ,0", vec!["1", "door", "0"]),
            ("1,\"door, left\",0", vec!["1", "door, left", "0"]),
            ("1,\"the \"\"red\"\" door\",0", vec!["1", "the \"red\" door", "0"]),
            ("1, \" door\" ,0", vec!["1", " door", "0"]),
            ("1,5\" pipe,0", vec!["1", "5\" pipe", "0"]),
            ("\"1\",\"\",\"0\"", vec!["1", "", "0"]),
            (",,", vec!["", "", ""]),
            ("", vec![""]),
        ] {
            let cut = split(line).map(|cut| cut.iter().map(ToString::to_string).collect::<Vec<_>>());
            assert_eq!(cut, Ok(fields.into_iter().map(str::to_owned).collect()), "{line}");
        }
    }

    #[test]
    fn invalid_quotes_are_refused() {
        assert_eq!(split("1,\"door,0"), Err("a quote is not closed"));
        assert_eq!(split("1,\"door\"s,0"), Err("there is text between a closing quote and the comma"));
    }
}

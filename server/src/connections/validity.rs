//! From when and until when a certificate is valid, read from its DER form (X.509, RFC 5280, section 4.1).
//!
//! Invariant: reads only; whether a certificate is good is for rustls to say. What is no certificate has no time.

/// An element of DER: its tag, its content, and what follows it.
fn element(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&tag, rest) = bytes.split_first()?;
    let (&first, rest) = rest.split_first()?;
    let (length, rest) = match first {
        0..=0x7f => (usize::from(first), rest),
        // A length of one to four bytes follows. 0x80, a length that is not told, is not DER.
        0x81..=0x84 => {
            let (digits, rest) = rest.split_at_checked(usize::from(first - 0x80))?;
            (digits.iter().fold(0, |length, &digit| length << 8 | usize::from(digit)), rest)
        }
        _ => return None,
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((tag, content, rest))
}

const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xa0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

/// When a certificate is valid, in seconds since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Validity {
    /// The first second.
    pub from_secs: i64,
    /// The last second.
    pub until_secs: i64,
}

/// When a certificate is valid.
pub(super) fn validity(certificate: &[u8]) -> Option<Validity> {
    let sequence = |bytes| element(bytes).filter(|&(tag, ..)| tag == SEQUENCE).map(|(_, content, _)| content);
    let mut fields = sequence(sequence(certificate)?)?;
    if let (VERSION, _, rest) = element(fields)? {
        fields = rest;
    }
    // The serial number, the algorithm and the issuer stand before the validity.
    for _ in 0..3 {
        fields = element(fields)?.2;
    }
    let (tag, text, not_after) = element(sequence(fields)?)?;
    let from_secs = time_secs(tag, std::str::from_utf8(text).ok()?)?;
    let (tag, text, _) = element(not_after)?;
    Some(Validity { from_secs, until_secs: time_secs(tag, std::str::from_utf8(text).ok()?)? })
}

/// `YYMMDDHHMMSSZ` or `YYYYMMDDHHMMSSZ`, the only forms that RFC 5280 allows.
fn time_secs(tag: u8, text: &str) -> Option<i64> {
    let digits = text.strip_suffix('Z').filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()))?;
    let (year, rest) = match tag {
        UTC_TIME if digits.len() == 12 => {
            let (year, rest) = digits.split_at(2);
            let century = if year < "50" { "20" } else { "19" };
            (format!("{century}{year}"), rest)
        }
        GENERALIZED_TIME if digits.len() == 14 => (digits[..4].to_owned(), &digits[4..]),
        _ => return None,
    };
    let part = |at: usize| &rest[at..at + 2];
    let rfc3339 = format!("{year}-{}-{}T{}:{}:{}Z", part(0), part(2), part(4), part(6), part(8));
    // Times in nanoseconds begin in 1677 and end in 2262; 99991231235959Z stands for no end.
    if year.as_str() < "1678" {
        return Some(i64::MIN / 1_000_000_000);
    }
    if year.as_str() > "2261" {
        return Some(i64::MAX / 1_000_000_000);
    }
    Some(tidemap_model::time::parse_time(&rfc3339).ok()?.div_euclid(1_000_000_000))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn der(tag: u8, content: &[u8]) -> Vec<u8> {
        let length = content.len();
        let mut bytes = match length {
            0..=0x7f => vec![tag, length as u8],
            _ => vec![tag, 0x82, (length >> 8) as u8, length as u8],
        };
        bytes.extend_from_slice(content);
        bytes
    }

    fn certificate(version: bool, tag: u8, not_after: &str) -> Vec<u8> {
        let mut fields = if version { der(VERSION, &der(2, &[2])) } else { Vec::new() };
        fields.extend(der(2, &[1]));
        fields.extend(der(SEQUENCE, &[]));
        // Long enough for a length of more than one byte.
        fields.extend(der(SEQUENCE, &der(12, &[b'a'; 300])));
        fields.extend(der(SEQUENCE, &[der(UTC_TIME, b"250101000000Z"), der(tag, not_after.as_bytes())].concat()));
        fields.extend(der(SEQUENCE, &[1, 2, 3]));
        der(SEQUENCE, &der(SEQUENCE, &fields))
    }

    fn ends_secs(certificate: &[u8]) -> Option<i64> {
        validity(certificate).map(|valid| valid.until_secs)
    }

    #[test]
    fn the_times_are_read_in_both_forms() {
        let valid = validity(&certificate(true, UTC_TIME, "260101120000Z"));
        assert_eq!(valid, Some(Validity { from_secs: 1_735_689_600, until_secs: 1_767_268_800 }));
        assert_eq!(time_secs(GENERALIZED_TIME, "00000101000000Z"), Some(i64::MIN / 1_000_000_000), "for ever");
        for version in [false, true] {
            assert_eq!(ends_secs(&certificate(version, UTC_TIME, "260101120000Z")), Some(1_767_268_800));
            assert_eq!(ends_secs(&certificate(version, GENERALIZED_TIME, "20600101000000Z")), Some(2_840_140_800));
        }
        assert_eq!(ends_secs(&certificate(true, UTC_TIME, "991231235959Z")), Some(946_684_799), "of the last century");
        let never = ends_secs(&certificate(true, GENERALIZED_TIME, "99991231235959Z"));
        assert_eq!(never, Some(i64::MAX / 1_000_000_000));
    }

    #[test]
    fn what_is_no_certificate_has_no_end() {
        let whole = certificate(true, UTC_TIME, "260101120000Z");
        for length in 0..whole.len() {
            let _ = ends_secs(&whole[..length]);
        }
        for at in 0..whole.len() {
            let mut wrong = whole.clone();
            wrong[at] ^= 0xff;
            let _ = ends_secs(&wrong);
        }
        for text in ["", "260101Z", "260101120000+", "26x101120000Z", "261301120000Z"] {
            assert_eq!(ends_secs(&certificate(true, UTC_TIME, text)), None, "{text}");
        }
    }
}

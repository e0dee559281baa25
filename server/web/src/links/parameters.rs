//! The parameters of an address: `?at=…&layer=…`.
//!
//! Invariant: each parameter is known and occurs once, so that a misspelt parameter is never ignored.

use super::{Failure, Parameter};

/// The parameters that were given.
pub(in super::super) struct Given(Vec<(&'static str, String)>);

/// A text without its percent signs; `None` if it is not UTF-8.
fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let digit = |byte: Option<u8>| byte.and_then(|byte| char::from(byte).to_digit(16));
        let (high, low) = (digit(rest.next())?, digit(rest.next())?);
        bytes.push(u8::try_from(high * 16 + low).ok()?);
    }
    String::from_utf8(bytes).ok()
}

impl Given {
    /// Parses the parameters of a query.
    pub(in super::super) fn of(query: Option<&str>, known: &'static [Parameter]) -> Result<Self, Failure> {
        let mut given: Vec<(&'static str, String)> = Vec::new();
        for part in query.unwrap_or("").split('&').filter(|part| !part.is_empty()) {
            let (name, value) = part.split_once('=').unwrap_or((part, ""));
            let Some(parameter) = known.iter().find(|parameter| parameter.name == name) else {
                let names: Vec<&str> = known.iter().map(|parameter| parameter.name).collect();
                let name: String = name.chars().take(40).collect();
                return Err(Failure::Invalid(format!(
                    "there is no parameter {name:?}: the parameters are {}",
                    names.join(", ")
                )));
            };
            if given.iter().any(|(name, _)| *name == parameter.name) {
                return Err(Failure::Invalid(format!("parameter {} is there twice", parameter.name)));
            }
            let Some(value) = decoded(value) else {
                return Err(Failure::Invalid(format!("parameter {} is not percent-encoded UTF-8", parameter.name)));
            };
            given.push((parameter.name, value));
        }
        Ok(Self(given))
    }

    /// The value of a parameter; `None` if it is not given, or empty.
    pub(in super::super) fn get(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(known, value)| *known == name && !value.is_empty()).map(|(_, value)| value.as_str())
    }

    /// A range of metres, `MIN:MAX`.
    pub(super) fn range(&self, name: &str) -> Result<Option<(f64, f64)>, Failure> {
        let Some(text) = self.get(name) else { return Ok(None) };
        let number = |text: &str| text.parse::<f64>().ok().filter(|metres| metres.is_finite());
        let range = text.split_once(':').and_then(|(min, max)| Some((number(min)?, number(max)?)));
        match range.filter(|(min, max)| min < max) {
            Some(range) => Ok(Some(range)),
            None => Err(Failure::Invalid(format!(
                "{name}={text:.40} is no range: use MIN:MAX in metres, such as {name}=0.1:1.8"
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: &[Parameter] = &[
        Parameter { name: "at", description: "", example: "" },
        Parameter { name: "z", description: "", example: "" },
    ];

    fn given(query: &str) -> Result<Given, String> {
        Given::of(Some(query), KNOWN).map_err(|failure| match failure {
            Failure::Invalid(text) => text,
            _ => "another failure".to_owned(),
        })
    }

    #[test]
    fn values_are_decoded() {
        let found = given("at=2025-01-01T00%3A00%3A00%2B01%3A00&z=-0.5:2").unwrap_or_else(|text| panic!("{text}"));
        assert_eq!(found.get("at"), Some("2025-01-01T00:00:00+01:00"));
        assert!(matches!(found.range("z"), Ok(Some((-0.5, 2.0)))));
        assert!(given("").is_ok_and(|none| none.get("at").is_none()));
    }

    #[test]
    fn what_is_not_known_is_refused() {
        for (query, text) in [
            ("att=1", "there is no parameter \"att\": the parameters are at, z"),
            ("at=1&at=2", "parameter at is there twice"),
            ("at=%f", "parameter at is not percent-encoded UTF-8"),
            ("at=%ff%fe", "parameter at is not percent-encoded UTF-8"),
        ] {
            assert_eq!(given(query).err().as_deref(), Some(text));
        }
        for range in ["1", "2:1", "1:1", "a:b", "nan:1", "0:inf"] {
            let found = given(&format!("z={range}")).unwrap_or_else(|text| panic!("{text}"));
            assert!(matches!(found.range("z"), Err(Failure::Invalid(_))), "{range}");
        }
    }
}

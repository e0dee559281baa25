//! Times in JSON: RFC 3339 or whole nanoseconds since 1970, in every field of a request that is a time or a
//! row of times.
//! Invariant: a text is not changed if it has no such field, or if its times have the form of their fields already.
//! Nothing is kept of a request but its text.

use std::{borrow::Cow, fmt};

use prost_reflect::{FieldDescriptor, Kind, MessageDescriptor};
use serde::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use tidemap_map::spec::REAL_CLOCK_MIN_NANOS;
use tidemap_model::time::{format_rfc3339, parse_time};

/// The message type of single times.
const TIMESTAMP: &str = "google.protobuf.Timestamp";
/// Number of digits before the first `-`: a time of RFC 3339 begins with `2025-`, and no number does.
const YEAR_DIGITS: usize = 4;

/// The form in which a field holds a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TimeForm {
    /// Nanoseconds.
    Nanos,
    /// A message of its own.
    Timestamp,
}

/// The form in which a field holds a time; `None`: the field is no time. Whole numbers of fixed size are times, and
/// nothing else is.
pub(super) fn form_of(field: &FieldDescriptor) -> Option<TimeForm> {
    match field.kind() {
        Kind::Sfixed64 if field.name().ends_with("_nanos") => Some(TimeForm::Nanos),
        Kind::Message(message) if message.full_name() == TIMESTAMP => Some(TimeForm::Timestamp),
        _ => None,
    }
}

/// A number that is a time before 1990, which comes from a clock that is not set, or from another unit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Early {
    /// The field's name.
    pub field: String,
    /// The time that the number would be, nanoseconds since 1970.
    pub nanos: i64,
}

/// A request whose times have the form of their fields.
#[derive(Debug)]
pub(super) struct ReadRequest<'a> {
    /// The text of the request.
    pub text: Cow<'a, [u8]>,
    /// The first number that is early. A date that somebody wrote out is taken as it is.
    pub early: Option<Early>,
}

/// Reads the times of a request. A text that is no JSON is not changed: the next reader reports the error.
///
/// # Errors
/// A time that is not valid, with its field.
pub(super) fn read<'a>(text: &'a [u8], input: &MessageDescriptor) -> Result<ReadRequest<'a>, String> {
    let mut rewriter = Rewriter { out: Vec::with_capacity(text.len()), is_changed: false, early: None, wrong: None };
    let mut json = serde_json::Deserializer::from_slice(text);
    let place = Rewritten { rewriter: &mut rewriter, holds: Holds::Message(input.clone()) };
    let is_read = place.deserialize(&mut json).is_ok() && json.end().is_ok();
    let Rewriter { out, is_changed, early, wrong } = rewriter;
    match wrong {
        Some(wrong) => Err(wrong),
        None if is_read && is_changed => Ok(ReadRequest { text: Cow::Owned(out), early }),
        None => Ok(ReadRequest { text: Cow::Borrowed(text), early }),
    }
}

/// A request that is read and written again, value by value.
struct Rewriter {
    out: Vec<u8>,
    is_changed: bool,
    early: Option<Early>,
    wrong: Option<String>,
}

impl Rewriter {
    fn put<T: serde::Serialize + ?Sized>(&mut self, value: &T) {
        // Texts and numbers can be written, and a vector takes them.
        let _ = serde_json::to_writer(&mut self.out, value);
    }

    /// Writes a number that is in the place of a time.
    fn number(&mut self, field: &FieldDescriptor, form: TimeForm, nanos: i64) {
        // A single field that is 0 is a field that is not set.
        let is_unset = nanos == 0 && form == TimeForm::Nanos && !field.is_list();
        if nanos < REAL_CLOCK_MIN_NANOS && !is_unset && self.early.is_none() {
            self.early = Some(Early { field: field.json_name().to_owned(), nanos });
        }
        match form {
            TimeForm::Nanos => self.put(&nanos.to_string()),
            TimeForm::Timestamp if nanos < 0 => self.wrong(field, &format!("{nanos} is before 1970")),
            TimeForm::Timestamp => {
                self.is_changed = true;
                self.put(&format_rfc3339(nanos));
            }
        }
    }

    /// Writes a text that is in the place of a time.
    fn text(&mut self, field: &FieldDescriptor, form: TimeForm, text: &str) {
        if let Ok(nanos) = text.parse() {
            return self.number(field, form, nanos);
        }
        let is_date = text.as_bytes().get(YEAR_DIGITS) == Some(&b'-');
        match parse_time(text) {
            Ok(nanos) if is_date && form == TimeForm::Nanos => {
                self.is_changed = true;
                self.put(&nanos.to_string());
            }
            Err(error) if is_date && form == TimeForm::Nanos => self.wrong(field, &error.to_string()),
            _ => self.put(text),
        }
    }

    fn wrong(&mut self, field: &FieldDescriptor, why: &str) {
        self.out.extend_from_slice(b"null");
        let text = || format!("{}: {why}: use RFC 3339, or nanoseconds since 1970", field.json_name());
        self.wrong.get_or_insert_with(text);
    }
}

/// The content of a place of a request.
#[derive(Clone)]
enum Holds {
    Message(MessageDescriptor),
    Time(FieldDescriptor, TimeForm),
    Other,
}

impl Holds {
    /// The content of a member of an object.
    fn of(parent: &Holds, name: &str) -> Holds {
        let Holds::Message(message) = parent else { return Holds::Other };
        let field = message.get_field_by_json_name(name).or_else(|| message.get_field_by_name(name));
        let Some(field) = field.filter(|field| !field.is_map()) else { return Holds::Other };
        match (form_of(&field), field.kind()) {
            (Some(form), _) => Holds::Time(field, form),
            (None, Kind::Message(message)) => Holds::Message(message),
            _ => Holds::Other,
        }
    }
}

/// A value to be read and written again.
struct Rewritten<'r> {
    rewriter: &'r mut Rewriter,
    holds: Holds,
}

impl<'de> DeserializeSeed<'de> for Rewritten<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Rewritten<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        self.rewriter.out.extend_from_slice(b"null");
        Ok(())
    }

    fn visit_bool<E>(self, value: bool) -> Result<(), E> {
        self.rewriter.put(&value);
        Ok(())
    }

    fn visit_i64<E>(self, value: i64) -> Result<(), E> {
        match &self.holds {
            Holds::Time(field, form) => self.rewriter.number(field, *form, value),
            _ => self.rewriter.put(&value),
        }
        Ok(())
    }

    fn visit_u64<E>(self, value: u64) -> Result<(), E> {
        match (&self.holds, i64::try_from(value)) {
            (Holds::Time(field, form), Ok(nanos)) => self.rewriter.number(field, *form, nanos),
            _ => self.rewriter.put(&value),
        }
        Ok(())
    }

    fn visit_f64<E>(self, value: f64) -> Result<(), E> {
        let is_whole = value.fract() == 0.0 && value.abs() < 9.2e18;
        match &self.holds {
            Holds::Time(field, form) if is_whole => self.rewriter.number(field, *form, value as i64),
            _ => self.rewriter.put(&value),
        }
        Ok(())
    }

    fn visit_str<E>(self, value: &str) -> Result<(), E> {
        match &self.holds {
            Holds::Time(field, form) => self.rewriter.text(field, *form, value),
            _ => self.rewriter.put(value),
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<(), A::Error> {
        let mut before = b'[';
        loop {
            let at = self.rewriter.out.len();
            self.rewriter.out.push(before);
            let place = Rewritten { rewriter: &mut *self.rewriter, holds: self.holds.clone() };
            if values.next_element_seed(place)?.is_none() {
                self.rewriter.out.truncate(at);
                break;
            }
            before = b',';
        }
        if before == b'[' {
            self.rewriter.out.push(b'[');
        }
        self.rewriter.out.push(b']');
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<(), A::Error> {
        self.rewriter.out.push(b'{');
        let mut is_first = true;
        while let Some(name) = members.next_key::<Cow<'de, str>>()? {
            if !std::mem::take(&mut is_first) {
                self.rewriter.out.push(b',');
            }
            self.rewriter.put(&*name);
            self.rewriter.out.push(b':');
            let holds = Holds::of(&self.holds, &name);
            members.next_value_seed(Rewritten { rewriter: &mut *self.rewriter, holds })?;
        }
        self.rewriter.out.push(b'}');
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use prost_reflect::DescriptorPool;

    use super::*;

    fn input(name: &str) -> MessageDescriptor {
        let pool = DescriptorPool::decode(tidemap_proto::v1::DESCRIPTORS).expect("descriptors");
        pool.get_message_by_name(&format!("tidemap.v1.{name}")).expect("a message")
    }

    fn rewritten(name: &str, text: &str) -> Result<(String, Option<Early>), String> {
        let read = read(text.as_bytes(), &input(name))?;
        Ok((String::from_utf8_lossy(&read.text).into_owned(), read.early))
    }

    #[test]
    fn rows_and_single_times_are_rfc_3339_or_nanoseconds() {
        let nanos = "1738058400000000000";
        let date = "2025-01-28T10:00:00Z";
        for (text, expected) in [
            (
                format!(r#"{{"timesNanos": ["{date}", "2025-01-28T11:00:00+01:00"]}}"#),
                format!("[\"{nanos}\",\"{nanos}\"]"),
            ),
            (
                format!(r#"{{"timesNanos": ["{nanos}", {nanos}, "{date}"]}}"#),
                format!("[\"{nanos}\",\"{nanos}\",\"{nanos}\"]"),
            ),
        ] {
            let (found, early) = rewritten("PredictStatesRequest", &text).expect("times");
            assert_eq!((found, early), (format!("{{\"timesNanos\":{expected}}}"), None), "{text}");
        }
        for text in [nanos.to_owned(), format!("\"{nanos}\"")] {
            let text = format!(r#"{{"readings": [{{"state": "{date}", "time": {text}}}]}}"#);
            let (found, early) = rewritten("ReportRequest", &text).expect("times");
            assert_eq!(found, format!(r#"{{"readings":[{{"state":"{date}","time":"{date}"}}]}}"#));
            assert_eq!(early, None);
        }
    }

    #[test]
    fn what_needs_no_change_stays_to_the_last_blank() {
        for text in [
            r#"{ "map" : "home", "timesNanos" : ["1738058400000000000"], "intervalLevel": 0.25 }"#,
            r#"{"states": ["2025-01-28T10:00:00Z"], "nonsense": [{}, [], null, true, -1, 1e300]}"#,
            r#"{"timesNanos": ["#,
            r#"{"timesNanos": ["soon"]} and more"#,
            "[[]]",
            "",
        ] {
            let (found, early) = rewritten("PredictStatesRequest", text).expect("no wrong times");
            assert_eq!((found.as_str(), early), (text, None));
        }
        let mixed = r#"{"a": [{}, [], [[1,2.5],null], true, "é\"\n"], "times_nanos": ["2025-01-28T10:00:00Z"]}"#;
        let expected = r#"{"a":[{},[],[[1,2.5],null],true,"é\"\n"],"times_nanos":["1738058400000000000"]}"#;
        assert_eq!(rewritten("PredictStatesRequest", mixed).expect("times").0, expected);
    }

    #[test]
    fn early_numbers_are_found_and_dates_are_meant() {
        let early =
            |name: &str, text: &str| rewritten(name, text).expect("times").1.map(|early| (early.field, early.nanos));
        for text in [
            r#"{"timesNanos": [1738058400]}"#,
            r#"{"timesNanos": ["1738058400"]}"#,
            r#"{"timesNanos": [1738058400.0]}"#,
        ] {
            assert_eq!(early("PredictStatesRequest", text), Some(("timesNanos".to_owned(), 1_738_058_400)), "{text}");
        }
        assert_eq!(early("PredictStatesRequest", r#"{"timesNanos": ["1970-01-01T00:00:01Z"]}"#), None);
        assert_eq!(early("PredictStatesRequest", r#"{"timesNanos": [0]}"#), Some(("timesNanos".to_owned(), 0)));
        let single = early("ReportRequest", r#"{"readings": [{"time": 1738058400}]}"#);
        assert_eq!(single, Some(("time".to_owned(), 1_738_058_400)));
    }

    #[test]
    fn a_wrong_time_names_its_field() {
        for (text, words) in [
            (r#"{"timesNanos": ["2025-01-28T10:00:00"]}"#, "timesNanos: "),
            (r#"{"timesNanos": ["2025-13-28T10:00:00Z"]}"#, "2025-13-28"),
        ] {
            let error = rewritten("PredictStatesRequest", text).expect_err("wrong");
            assert!(error.contains(words) && error.contains("RFC 3339"), "{error}");
        }
    }

    /// Every field of a request that is a time or a row of times is found by its type and its name.
    #[test]
    fn every_fixed_number_of_the_wire_is_a_time() {
        let pool = DescriptorPool::decode(tidemap_proto::v1::DESCRIPTORS).expect("descriptors");
        let mut found = 0;
        for field in pool.all_messages().flat_map(|message| message.fields().collect::<Vec<_>>()) {
            if field.kind() == Kind::Sfixed64 {
                assert_eq!(form_of(&field), Some(TimeForm::Nanos), "{}", field.full_name());
                found += 1;
            }
        }
        assert!(found > 15, "{found}");
    }
}

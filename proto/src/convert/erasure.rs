//! Requests to erase observations.
//!
//! Invariant: the named objects fit together; the erasure itself checks whether the map has them.

use tidemap_map::erasure::{ErasureRequest, RequestedPart};

use super::{InvalidField, cells::cell_from_wire, time::nanos_from_timestamp};
use crate::v1;

/// The observations that a request erases.
///
/// # Errors
/// The invalid field: the request names nothing, or its names do not go together, or it names a cell of a grid.
pub fn erasure_from_wire(request: &v1::EraseRequest) -> Result<ErasureRequest, InvalidField> {
    let v1::EraseRequest { state, producer, label, from_time, to_time, forget_sequence: forgets, .. } = request;
    let wrong = |field: &str, problem: &str| Err(InvalidField::new(field, problem));
    let name = (!state.is_empty()).then(|| state.clone());
    let has_interval = from_time.is_some() || to_time.is_some();
    if producer.is_empty() && label.is_some() {
        return wrong("label", "a label is one of a producer: name the producer, too");
    }
    if *forgets && (producer.is_empty() || label.is_none() || name.is_some() || has_interval) {
        let problem = "a sequence is forgotten as a whole: name producer and label, and neither state nor interval";
        return wrong("forget_sequence", problem);
    }
    if cell_from_wire("state", state)?.is_some() {
        return wrong("state", "cells of a grid cannot be erased one by one: name a state, or delete the map");
    }
    if producer.is_empty() && !has_interval {
        return match name {
            Some(_) => Ok(ErasureRequest { state: name, part: None }),
            None => wrong("state", "name what is to be erased: a state, a producer, an interval, or some of these"),
        };
    }
    let nanos = |field: &str, time: &Option<_>| time.map(|time| nanos_from_timestamp(field, time)).transpose();
    let from_nanos = nanos("from_time", from_time)?.unwrap_or(i64::MIN);
    let to_nanos = nanos("to_time", to_time)?.unwrap_or(i64::MAX);
    if from_nanos >= to_nanos {
        return wrong("to_time", "it must be later than from_time: it is the end of the interval, and not part of it");
    }
    let producer = (!producer.is_empty()).then(|| (producer.clone(), label.clone()));
    Ok(ErasureRequest { state: name, part: Some(RequestedPart { producer, from_nanos, to_nanos, forgets: *forgets }) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convert::time::timestamp;

    fn field(request: &v1::EraseRequest) -> String {
        erasure_from_wire(request).expect_err("wrong").field
    }

    #[test]
    fn something_that_can_be_erased_must_be_named() {
        assert_eq!(field(&v1::EraseRequest::default()), "state");
        let cell = "cell/1/2/3".to_owned();
        assert_eq!(field(&v1::EraseRequest { state: cell, ..Default::default() }), "state");
        let erasure = erasure_from_wire(&v1::EraseRequest { state: "door".to_owned(), ..Default::default() });
        assert!(matches!(erasure, Ok(ErasureRequest { state: Some(_), part: None })));
    }

    #[test]
    fn what_does_not_go_together_is_named() {
        let label = Some("a".to_owned());
        assert_eq!(field(&v1::EraseRequest { label: label.clone(), ..Default::default() }), "label");
        assert_eq!(field(&v1::EraseRequest { forget_sequence: true, ..Default::default() }), "forget_sequence");
        let (from_time, to_time) = (Some(timestamp(9)), Some(timestamp(9)));
        assert_eq!(field(&v1::EraseRequest { from_time, to_time, ..Default::default() }), "to_time");
        let producer = "robot".to_owned();
        let whole = v1::EraseRequest { producer, label, forget_sequence: true, ..Default::default() };
        let part = erasure_from_wire(&whole).expect("right").part.expect("a part");
        assert!(part.forgets && part.from_nanos == i64::MIN && part.to_nanos == i64::MAX);
    }
}

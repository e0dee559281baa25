//! The map of a request is what prost decodes, whatever the bytes are.

use proptest::prelude::*;
use prost::bytes::Bytes;

use super::*;
use crate::v1::{
    EvaluateHeader, EvaluateStatesRequest, Hello, ObservationBatch, ObserveRequest, PredictStatesRequest,
    evaluate_states_request, observe_request,
};

const OBSERVE: &str = "/tidemap.v1.ObservationService/Observe";
const EVALUATE: &str = "/tidemap.v1.QueryService/EvaluateStates";
const PREDICT: &str = "/tidemap.v1.QueryService/PredictStates";

fn named(map: String) -> Option<String> {
    Some(map).filter(|map| !map.is_empty())
}

/// The map by decoding; `None` as well if that fails.
fn decoded(path: &str, bytes: &[u8]) -> Option<String> {
    let map = match path {
        PREDICT => PredictStatesRequest::decode(bytes).ok()?.map,
        OBSERVE => match ObserveRequest::decode(bytes).ok()?.message? {
            observe_request::Message::Hello(hello) => hello.map,
            _ => return None,
        },
        _ => match EvaluateStatesRequest::decode(bytes).ok()?.message? {
            evaluate_states_request::Message::Header(header) => header.map,
            evaluate_states_request::Message::Observations(_) => return None,
        },
    };
    named(map)
}

/// A part of a request: fields may come again, and in any order.
fn part() -> impl Strategy<Value = (u8, String, String)> {
    (0..5_u8, "[a-z]{0,4}", "[a-z]{0,3}")
}

fn encoded(path: &str, (kind, map, other): (u8, String, String)) -> Vec<u8> {
    let message = |message| ObserveRequest { message: Some(message) };
    match (path, kind) {
        (PREDICT, _) => {
            PredictStatesRequest { map, states: vec![other], ..PredictStatesRequest::default() }.encode_to_vec()
        }
        (OBSERVE, 0) => message(observe_request::Message::Batch(ObservationBatch::default())).encode_to_vec(),
        (OBSERVE, _) => {
            let hello = Hello { map, producer: other, nightly: kind == 1, ..Hello::default() };
            message(observe_request::Message::Hello(hello)).encode_to_vec()
        }
        (_, 0) => {
            let columns = evaluate_states_request::Message::Observations(Default::default());
            EvaluateStatesRequest { message: Some(columns) }.encode_to_vec()
        }
        _ => {
            let header = EvaluateHeader { map, max_order: Some(u32::from(kind)), ..EvaluateHeader::default() };
            EvaluateStatesRequest { message: Some(evaluate_states_request::Message::Header(header)) }.encode_to_vec()
        }
    }
}

proptest! {
    #[test]
    fn the_map_of_merged_parts_is_what_decoding_gives(parts in prop::collection::vec(part(), 0..5)) {
        for path in [PREDICT, OBSERVE, EVALUATE] {
            let bytes: Vec<u8> = parts.iter().flat_map(|part| encoded(path, part.clone())).collect();
            prop_assert_eq!(map_of(path, &bytes).map(str::to_owned), decoded(path, &bytes));
        }
    }

    #[test]
    fn bytes_that_decode_to_a_map_name_it(
        part in part(), cut in 0..40_usize, flip in 0..40_usize, value: u8,
    ) {
        for path in [PREDICT, OBSERVE, EVALUATE] {
            let mut bytes = encoded(path, part.clone());
            bytes.truncate(bytes.len().saturating_sub(cut % 4));
            if let Some(byte) = bytes.get_mut(flip) {
                *byte ^= value;
            }
            // A message that cannot be decoded is refused wherever it arrives.
            if let Some(map) = decoded(path, &bytes) {
                let has_groups = bytes.iter().any(|byte| matches!(byte & 7, 3 | 4));
                let found = map_of(path, &bytes);
                prop_assert!(found == Some(&map) || (found.is_none() && has_groups), "{found:?} {map:?}");
            }
        }
    }
}

#[test]
fn each_method_with_a_map_is_known() {
    assert_eq!(FIELDS[PREDICT], MapField::Direct(1));
    assert_eq!(FIELDS[OBSERVE], MapField::Nested { message: 1, choices: vec![1, 2, 3, 4, 5], field: 3 });
    assert_eq!(FIELDS[EVALUATE], MapField::Nested { message: 1, choices: vec![1, 2], field: 1 });
    assert!(names_a_map("/tidemap.v1.MaintenanceService/RunUpdate"));
    assert!(!names_a_map("/tidemap.v1.MaintenanceService/GetJob") && !names_a_map("/tidemap.v1.MapService/ListMaps"));
    assert!(FIELDS.len() > 55, "{}", FIELDS.len());
    assert_eq!(map_of(PREDICT, &Bytes::new()), None);
}

#[test]
fn a_map_is_asked_for_by_its_name() {
    let get = crate::v1::GetMapRequest { name: "office".to_owned() };
    assert_eq!(map_of("/tidemap.v1.MapService/GetMap", &get.encode_to_vec()), Some("office"));
    assert!(!names_a_map("/tidemap.v1.MapService/DeleteMap"));
}

//! The maximum number of elements of each repeated field of a request. A request is counted while it is still encoded,
//! because an empty element takes two bytes on the wire and a hundred or more in memory.
//!
//! Invariant: every repeated field that a request can hold has a bound, and a request beyond a bound is never decoded.
//! The counts are totals of a whole request: elements that are spread over many parts count as well.

use std::{collections::HashMap, sync::LazyLock};

use prost::{
    Message as _,
    bytes::Buf as _,
    encoding::{WireType, decode_key, decode_varint},
};
use prost_types::{
    DescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};

use crate::v1::DESCRIPTORS;

/// Messages within messages: no request is deeper, and the decoder refuses what is.
const DEPTH_MAX: usize = 32;

/// Times of a request: more do not fit in 1 MiB.
const TIMES: usize = 131_072;
/// Names of states, places, nodes or locations.
const NAMES: usize = 65_536;
/// The greatest `max_batch_observations` and `max_batch_scans` that a daemon can be set to.
const BATCH: usize = 65_536;
/// Readings of a report.
pub const READINGS: usize = 1000;
/// The greatest `max_scan_tiles` that a daemon can be set to.
const TILES: usize = 100_000;
/// The greatest `max_scan_points` that a daemon can be set to, and what fits in its greatest message.
const POINTS: usize = 4 << 20;

/// The bounds, by message and field.
const BOUNDS: &[(&str, usize)] = &[
    ("AddLandmarksRequest.landmarks", 4096),
    ("AddStateRequest.labels", 1024),
    ("ClassifyActivityRequest.likelihoods", 1024),
    ("CreateMapRequest.models", 64),
    ("EvaluateHeader.models", 1024),
    ("EvaluateViewsRequest.times_nanos", TIMES),
    ("EvaluateViewsRequest.viewpoints", NAMES),
    ("GetInformationRequest.locations", NAMES),
    ("GetInformationRequest.states", NAMES),
    ("GetInformationRequest.times_nanos", TIMES),
    ("Landmark.covariance", 32 * 4096),
    ("ListSurprisesRequest.states", NAMES),
    ("LoadTopologyRequest.edges", 250_000),
    ("LoadTopologyRequest.nodes", 100_000),
    ("LocaliseRequest.features", 10_000),
    ("LocaliseRequest.nodes", 1000),
    ("Location.states", NAMES),
    ("NextJointRequest.states", NAMES),
    ("NoGoArea.corners", 1_000),
    ("ObservationColumns.coordinates", 16 * BATCH),
    ("ObservationColumns.new_dimensions", BATCH),
    ("ObservationColumns.new_kinds", BATCH),
    ("ObservationColumns.new_states", BATCH),
    ("ObservationColumns.shares", 64 * BATCH),
    ("ObservationColumns.state_indices", BATCH),
    ("ObservationColumns.time_deltas", BATCH),
    ("ObservationColumns.values", BATCH),
    ("PeriodList.periods", 65_536),
    ("PlanDayRequest.locations", NAMES),
    ("PlanDayRequest.task_states", NAMES),
    ("PlanDayRequest.viewpoints", NAMES),
    ("PlanSlotRequest.locations", NAMES),
    ("PointCloud.xyz_m", POINTS),
    ("PositionBox.high_m", 64),
    ("PositionBox.low_m", 64),
    ("PredictAtPlacesRequest.density_values", 1000),
    ("PredictAtPlacesRequest.places_m", 300_000),
    ("PredictAtPlacesRequest.times_nanos", TIMES),
    ("PredictFlowRequest.times_nanos", TIMES),
    ("PredictPositionsRequest.times_nanos", TIMES),
    ("PredictPresenceRequest.times_nanos", TIMES),
    ("PredictStatesRequest.states", NAMES),
    ("PredictStatesRequest.times_nanos", TIMES),
    ("RangeScan.ranges_m", POINTS),
    ("Reading.position", 16 * READINGS),
    ("Reading.shares", 64 * READINGS),
    ("RemoveLandmarksRequest.names", 4096),
    ("ReportRequest.readings", READINGS),
    ("ReportBatch.reports", BATCH),
    ("ScanBatch.new_tiles", 3 * TILES),
    ("ScanBatch.scans", BATCH),
    ("ScanBatch.time_deltas", BATCH),
    ("Sighting.out_of_view", NAMES),
    ("Sighting.seen", NAMES),
    ("TileScan.masked", POINTS),
    ("TileScan.observed_flips", POINTS),
    ("TileScan.occupied_flips", POINTS),
    ("TileScan.seen", POINTS),
    ("WatchAnomaliesRequest.states", NAMES),
];

/// A request with more elements of a field than its bound allows.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: more than {max} elements in one request: send several requests")]
pub struct TooManyElements {
    /// Message and field, for example `LoadTopologyRequest.edges`.
    pub field: &'static str,
    /// The bound.
    pub max: usize,
}

#[derive(Debug)]
struct Field {
    /// The bound of the field and its place among the counts, if it is repeated.
    bound: Option<Bound>,
    /// The message that it holds.
    message: Option<usize>,
    element: Element,
}

#[derive(Clone, Copy, Debug)]
struct Bound {
    name: &'static str,
    max: usize,
    place: usize,
}

/// How the elements of a packed field are counted.
#[derive(Clone, Copy, Debug)]
enum Element {
    /// Numbers of so many bytes.
    Fixed(usize),
    /// Numbers of one to ten bytes; the last byte of each is less than 128.
    Varint,
    /// Strings, bytes and messages are never packed.
    Single,
}

#[derive(Debug)]
struct Bounds {
    by_name: HashMap<String, usize>,
    /// For each message, its fields by number.
    messages: Vec<HashMap<u32, Field>>,
    places: usize,
}

static ALL: LazyLock<Bounds> = LazyLock::new(Bounds::new);

impl Bounds {
    fn new() -> Self {
        let set = FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default();
        let mut described: Vec<(String, &DescriptorProto)> = Vec::new();
        for file in &set.file {
            for message in &file.message_type {
                describe(file.package(), message, &mut described);
            }
        }
        let by_name: HashMap<String, usize> =
            described.iter().enumerate().map(|(index, (name, _))| (name.clone(), index)).collect();
        let mut places = 0;
        let mut messages = Vec::with_capacity(described.len());
        for (name, message) in &described {
            let mut fields = HashMap::new();
            for field in &message.field {
                let name = format!("{}.{}", name.trim_start_matches("tidemap.v1."), field.name());
                let bound = BOUNDS.iter().find(|(bounded, _)| field.label() == Label::Repeated && *bounded == name);
                let bound = bound.map(|&(name, max)| {
                    places += 1;
                    Bound { name, max, place: places - 1 }
                });
                let element = match field.r#type() {
                    Type::Double | Type::Fixed64 | Type::Sfixed64 => Element::Fixed(8),
                    Type::Float | Type::Fixed32 | Type::Sfixed32 => Element::Fixed(4),
                    Type::String | Type::Bytes | Type::Message | Type::Group => Element::Single,
                    _ => Element::Varint,
                };
                let message = by_name.get(field.type_name().trim_start_matches('.')).copied();
                fields.insert(field.number().unsigned_abs(), Field { bound, message, element });
            }
            messages.push(fields);
        }
        Self { by_name, messages, places }
    }

    /// Counts the elements of an encoded message. Bytes that are no message are left to the decoder.
    fn count(
        &self,
        message: usize,
        mut bytes: &[u8],
        depth: usize,
        counts: &mut [usize],
    ) -> Result<(), TooManyElements> {
        while !bytes.is_empty() {
            let Ok((number, wire_type)) = decode_key(&mut bytes) else { return Ok(()) };
            let field = self.messages[message].get(&number);
            let payload = match wire_type {
                WireType::Varint => {
                    if decode_varint(&mut bytes).is_err() {
                        return Ok(());
                    }
                    None
                }
                WireType::LengthDelimited => {
                    let length = decode_varint(&mut bytes).ok().and_then(|length| usize::try_from(length).ok());
                    let Some((payload, rest)) = length.and_then(|length| bytes.split_at_checked(length)) else {
                        return Ok(());
                    };
                    bytes = rest;
                    Some(payload)
                }
                WireType::SixtyFourBit if bytes.len() >= 8 => {
                    bytes.advance(8);
                    None
                }
                WireType::ThirtyTwoBit if bytes.len() >= 4 => {
                    bytes.advance(4);
                    None
                }
                _ => return Ok(()),
            };
            let Some(field) = field else { continue };
            if let Some(bound) = field.bound {
                let count = &mut counts[bound.place];
                *count += match (payload, field.element) {
                    (Some(packed), Element::Fixed(width)) => packed.len() / width,
                    (Some(packed), Element::Varint) => packed.iter().filter(|byte| **byte < 128).count(),
                    _ => 1,
                };
                if *count > bound.max {
                    return Err(TooManyElements { field: bound.name, max: bound.max });
                }
            }
            if let (Some(payload), Some(message)) = (payload, field.message)
                && depth < DEPTH_MAX
            {
                self.count(message, payload, depth + 1, counts)?;
            }
        }
        Ok(())
    }
}

fn describe<'a>(outer: &str, message: &'a DescriptorProto, described: &mut Vec<(String, &'a DescriptorProto)>) {
    let name = format!("{outer}.{}", message.name());
    for nested in &message.nested_type {
        describe(&name, nested, described);
    }
    described.push((name, message));
}

/// Counts the elements of an encoded message. A message without repeated fields, or of another package, passes.
///
/// # Errors
/// A field has more elements than its bound allows.
pub fn check(message_name: &str, encoded: &[u8]) -> Result<(), TooManyElements> {
    let bounds = &*ALL;
    match bounds.by_name.get(message_name) {
        Some(&message) => bounds.count(message, encoded, 0, &mut vec![0; bounds.places]),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;

//! Payloads of the log's frames.
//!
//! A column holds one value per accepted observation, or a single value if all are equal:
//! - states: the numbers of the states as varints;
//! - times: the differences from one time to the next in units of `time_unit_nanos`, as zigzag varints;
//! - values: by their encoding, [`VALUES_BITS`], [`VALUES_DOUBLES`] or [`VALUES_FLOATS`].
//!
//! Invariant: the lengths of the columns follow from `count`, so a column that was cut or lengthened is detected.

/// The values are bits, the first in the lowest bit of the first byte, padded with zero bits: 0.0 or 1.0.
pub const VALUES_BITS: u32 = 0;
/// The values are doubles of eight bytes.
pub const VALUES_DOUBLES: u32 = 1;
/// The values are floats of four bytes.
pub const VALUES_FLOATS: u32 = 2;

/// A state that appears for the first time.
#[derive(Clone, PartialEq, prost::Message)]
pub struct NewState {
    #[prost(uint32, tag = "1")]
    pub id: u32,
    #[prost(string, tag = "2")]
    pub name: String,
    /// Its kind: 0 probability; from format 2 on 1 continuous, 2 count, 3 a vector of 2
    /// coordinates, 4 one of 3. Values of these are from -1e12 to 1e12. A vector is as many states of kind 1 as it has
    /// coordinates, called NAME/x, NAME/y and NAME/z, with this number and those after it.
    #[prost(uint32, tag = "3")]
    pub kind: u32,
}

/// The start of an update.
#[derive(Clone, PartialEq, prost::Message)]
pub struct UpdateStart {
    /// Number of the generation.
    #[prost(uint64, tag = "1")]
    pub generation: u64,
    /// The cut: earlier observations are learned, later ones are pending.
    #[prost(sint64, tag = "2")]
    pub cut_nanos: i64,
    /// 1 request, 2 midnight, 3 data time, 4 pending limit.
    #[prost(uint32, tag = "3")]
    pub cause: u32,
}

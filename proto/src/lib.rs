//! The wire, `tidemap.v1`: generated message and service types and, with the feature `convert`, the conversions between
//! them and the domain types of `tidemap-model`, `tidemap-map` and `tidemap-plan`.
//!
//! Invariant: nothing here makes decisions. Conversions validate what is received, not what is sent; v1 only grows.

pub mod bounds;
pub mod bytes_codec;
pub mod codec;
#[cfg(feature = "convert")]
pub mod convert;
pub mod first_message;
pub mod map_of;
pub mod read_token;

/// Generated from `proto/tidemap/v1/*.proto`; each item is documented there.
#[allow(missing_docs, clippy::all, clippy::pedantic)]
pub mod v1 {
    tonic::include_proto!("tidemap.v1");

    /// Encoded `FileDescriptorSet` of the package, for reflection.
    pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/tidemap.v1.bin"));
}

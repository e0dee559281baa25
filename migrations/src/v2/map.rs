//! What a map is: as in format 1, with its grid and for how long exact observations are kept.
//!
//! Invariant: a message of format 1 reads as one of these whose further fields are absent.

/// The fixed properties of a map.
#[derive(Clone, PartialEq, prost::Message)]
pub struct MapSpec {
    /// Its name.
    #[prost(string, tag = "1")]
    pub name: String,
    /// IANA name of its time zone.
    #[prost(string, tag = "2")]
    pub zone: String,
    /// Base period, where the periodicities are harmonics; 0 where they are a list.
    #[prost(sint64, tag = "3")]
    pub harmonics_base_nanos: i64,
    /// Number of harmonics; 0 where they are a list.
    #[prost(uint32, tag = "4")]
    pub harmonics_count: u32,
    /// Periods, where they are a list.
    #[prost(sint64, repeated, tag = "5")]
    pub period_nanos: Vec<i64>,
    /// 1 squared error, 2 zero-one.
    #[prost(uint32, tag = "6")]
    pub criterion: u32,
    /// When it was created.
    #[prost(sint64, tag = "7")]
    pub created_nanos: i64,
    /// How long exact observations of named states are kept; absent: for ever.
    #[prost(message, optional, tag = "8")]
    pub retention: Option<Retention>,
    /// The grid; absent: there is none.
    #[prost(message, optional, tag = "9")]
    pub grid: Option<GridSpec>,
    /// Whether history files hold all that the map's retention asks for, so that the log's beginning may be deleted.
    /// False for a map that was created under format 1, whose log is its history.
    #[prost(bool, tag = "10")]
    pub history_complete: bool,
}

/// How long exact observations are kept.
#[derive(Clone, Copy, PartialEq, prost::Message)]
pub struct Retention {
    /// 0 not at all, 1 for a duration, 2 for ever.
    #[prost(uint32, tag = "1")]
    pub kind: u32,
    /// The duration; 0 for the other kinds.
    #[prost(sint64, tag = "2")]
    pub nanos: i64,
}

/// The fixed properties of a grid.
#[derive(Clone, PartialEq, prost::Message)]
pub struct GridSpec {
    /// Frame id.
    #[prost(string, tag = "1")]
    pub frame_id: String,
    /// Whether it has the one layer z = 0 alone.
    #[prost(bool, tag = "2")]
    pub is_flat: bool,
    /// Edge of a cell in metres.
    #[prost(fixed64, tag = "3")]
    pub resolution_bits: u64,
    /// Lower corner of cell (0, 0, 0) in metres: three.
    #[prost(fixed64, repeated, tag = "4")]
    pub origin_bits: Vec<u64>,
    /// The cells that there may be; absent: it grows.
    #[prost(message, optional, tag = "5")]
    pub extent: Option<CellBox>,
    /// P(reads occupied | is occupied).
    #[prost(fixed64, tag = "6")]
    pub hit_bits: u64,
    /// P(reads occupied | is free).
    #[prost(fixed64, tag = "7")]
    pub false_alarm_bits: u64,
    /// P(is occupied).
    #[prost(fixed64, tag = "8")]
    pub prior_bits: u64,
    /// How long exact readings are kept.
    #[prost(message, optional, tag = "9")]
    pub retention: Option<Retention>,
}

/// A box of cells.
#[derive(Clone, PartialEq, prost::Message)]
pub struct CellBox {
    /// Lowest cell: x, y, z.
    #[prost(sint32, repeated, tag = "1")]
    pub min: Vec<i32>,
    /// Beyond the highest cell: x, y, z.
    #[prost(sint32, repeated, tag = "2")]
    pub max: Vec<i32>,
}

#[cfg(test)]
mod tests {
    use prost::Message as _;

    use super::*;
    use crate::v1;

    #[test]
    fn a_map_of_format_1_has_no_further_fields() {
        let old = v1::map::MapSpec {
            name: "office".to_owned(),
            zone: "Europe/Prague".to_owned(),
            harmonics_base_nanos: 7,
            harmonics_count: 3,
            period_nanos: vec![5, -6],
            criterion: 2,
            created_nanos: -9,
        };
        let new = MapSpec::decode(&old.encode_to_vec()[..]).expect("a message");
        assert_eq!((&new.retention, &new.grid, new.history_complete), (&None, &None, false));
        assert_eq!(new.encode_to_vec(), old.encode_to_vec());
    }
}

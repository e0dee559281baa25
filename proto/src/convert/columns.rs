//! Columns of observations.
//!
//! Invariant: decoding checks the form of the columns (lengths, exactly one kind of values), not the observations: an
//! invalid observation is refused on its own later, and its neighbours are not.

use super::InvalidField;
use crate::v1::{ObservationColumns, StateKind};

/// Unpacked columns of observations; all have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DecodedColumns {
    /// Time in nanoseconds UTC; negative if the sender sent it so, or if a delta in its unit exceeds i64.
    pub times_nanos: Vec<i64>,
    /// Index into the stream's table of names.
    pub state_indices: Vec<u32>,
    /// Value; any double.
    pub values: Vec<f64>,
}

/// Columns of observations as sent, still packed.
#[derive(Clone, Debug)]
pub struct PackedColumns(ObservationColumns);

impl From<ObservationColumns> for PackedColumns {
    fn from(columns: ObservationColumns) -> Self {
        Self(columns)
    }
}

impl PackedColumns {
    /// Number of observations.
    #[must_use]
    pub fn observations(&self) -> usize {
        self.0.time_deltas.len()
    }

    /// Whether any observation is a position.
    #[must_use]
    pub fn has_coordinates(&self) -> bool {
        !self.0.coordinates.is_empty()
    }

    /// Takes the names that the message adds to the stream's table.
    #[must_use]
    pub fn take_names(&mut self) -> Vec<String> {
        std::mem::take(&mut self.0.new_states)
    }

    /// Does the same as [`PackedColumns::take_names`], and returns with each name whether it is declared as the name of
    /// a label.
    #[must_use]
    pub fn take_named_kinds(&mut self) -> Vec<(String, bool)> {
        let kinds = std::mem::take(&mut self.0.new_kinds);
        let is_label = |at: usize| kinds.get(at).is_some_and(|kind| *kind == i32::from(StateKind::Categorical));
        self.take_names().into_iter().enumerate().map(|(at, name)| (name, is_label(at))).collect()
    }

    /// Takes the coordinates of the positions.
    #[must_use]
    pub fn take_coordinates(&mut self) -> Vec<f64> {
        std::mem::take(&mut self.0.coordinates)
    }

    /// Takes the shares of the labels of categorical states.
    #[must_use]
    pub fn take_shares(&mut self) -> Vec<f64> {
        std::mem::take(&mut self.0.shares)
    }

    /// Unpacks the observations. The caller checks their number before.
    ///
    /// # Errors
    /// The field with an invalid length or form.
    pub fn unpack(self) -> Result<DecodedColumns, InvalidField> {
        decode(self.0)
    }
}

/// Unpacks columns.
///
/// # Errors
/// The field with an invalid length or form. The caller checks the number of observations before.
pub fn decode(columns: ObservationColumns) -> Result<DecodedColumns, InvalidField> {
    let count = columns.time_deltas.len();
    if count == 0 {
        return Err(InvalidField::new("observations.time_deltas", "there is no observation: send at least 1"));
    }
    let values = match (columns.bits.is_empty(), columns.values.is_empty()) {
        (true, false) if columns.values.len() == count => columns.values,
        (true, false) => return Err(length("values", columns.values.len(), count)),
        (false, true) if columns.bits.len() == count.div_ceil(8) => {
            (0..count).map(|i| f64::from(columns.bits[i / 8] >> (i % 8) & 1)).collect()
        }
        (false, true) => {
            return Err(InvalidField::new(
                "observations.bits",
                format!("{} bytes for {count} observations: should be {}", columns.bits.len(), count.div_ceil(8)),
            ));
        }
        _ => return Err(InvalidField::new("observations.values", "exactly one of bits and values must be set")),
    };
    let state_indices = match columns.state_indices.len() {
        0 => vec![0; count],
        len if len == count => columns.state_indices,
        len => return Err(length("state_indices", len, count)),
    };
    // 0 is what proto3 sends for "not set", and the default is 1.
    let unit = i64::try_from(columns.time_unit_nanos.max(1)).map_err(|_| {
        let text = format!("{} ns is too large: at most {} are possible", columns.time_unit_nanos, i64::MAX);
        InvalidField::new("observations.time_unit_nanos", text)
    })?;
    let mut time = Some(columns.first_time_nanos);
    let times_nanos = columns
        .time_deltas
        .iter()
        .map(|delta| {
            // If a product overflows, this observation and those after it are refused one by one, as before 1970. A sum
            // may wrap: a sender whose deltas wrapped gets its own times back, and only invalid ones are refused.
            time = time.and_then(|time| Some(time.wrapping_add(delta.checked_mul(unit)?)));
            time.unwrap_or(-1)
        })
        .collect();
    Ok(DecodedColumns { times_nanos, state_indices, values })
}

fn length(column: &str, len: usize, count: usize) -> InvalidField {
    InvalidField::new(
        format!("observations.{column}"),
        format!("{len} entries, but time_deltas has {count}: all columns have the same length"),
    )
}

/// Packs observations: the greatest time unit that fits, and values as bits if all are 0 or 1. The slices have the same
/// length; times may come in any order.
#[must_use]
pub fn encode(
    times_nanos: &[i64],
    state_indices: &[u32],
    values: &[f64],
    new_states: Vec<String>,
) -> ObservationColumns {
    let deltas = || times_nanos.windows(2).map(|pair| pair[1].wrapping_sub(pair[0]));
    let mut unit = 0u64;
    for delta in deltas() {
        let delta = delta.unsigned_abs();
        // There is one division per observation once the unit has settled.
        if unit == 0 || delta % unit != 0 {
            unit = greatest_common_divisor(unit, delta);
        }
        if unit == 1 {
            break;
        }
    }
    // Differences of 2^63 and more do not fit i64; such times are not realistic.
    let unit = i64::try_from(unit).unwrap_or(1).max(1);
    let mut time_deltas = Vec::with_capacity(times_nanos.len());
    time_deltas.push(0);
    time_deltas.extend(deltas().map(|delta| delta / unit));
    let one_state = state_indices.iter().all(|&index| index == 0);
    let binary = values.iter().all(|value| value.to_bits() == 0 || value.to_bits() == 1f64.to_bits());
    let mut bits = vec![0u8; if binary { values.len().div_ceil(8) } else { 0 }];
    if binary {
        for (i, _) in values.iter().enumerate().filter(|(_, value)| value.to_bits() != 0) {
            bits[i / 8] |= 1 << (i % 8);
        }
    }
    ObservationColumns {
        time_unit_nanos: unit as u64,
        first_time_nanos: times_nanos.first().copied().unwrap_or(0),
        time_deltas,
        state_indices: if one_state { Vec::new() } else { state_indices.to_vec() },
        new_states,
        new_kinds: Vec::new(),
        new_dimensions: Vec::new(),
        coordinates: Vec::new(),
        shares: Vec::new(),
        bits: bits.into(),
        values: if binary { Vec::new() } else { values.to_vec() },
    }
}

pub(super) fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(times: &[i64], indices: &[u32], values: &[f64], unit: u64) {
        let columns = encode(times, indices, values, Vec::new());
        assert_eq!(columns.time_unit_nanos, unit);
        let decoded = decode(columns).expect("well formed");
        assert_eq!(decoded.times_nanos, times);
        assert_eq!(decoded.state_indices, indices);
        assert_eq!(
            decoded.values.iter().map(|v| v.to_bits()).collect::<Vec<_>>(),
            values.iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        );
    }

    #[test]
    fn columns_survive_the_wire() {
        check(&[60_000_000_000, 0, 120_000_000_000], &[0, 0, 0], &[0.0, 1.0, 1.0], 60_000_000_000);
        check(&[5, 8, 20], &[0, 7, 0], &[0.25, 1.0, f64::NAN], 3);
        check(&[7], &[0], &[-0.0], 1);
        check(&[3, 3], &[1, 1], &[1.0, 0.0], 1);
        check(&[0, i64::MAX, 0], &[0, 1, 2], &[0.0; 3], i64::MAX as u64);
        check(&[i64::MIN, i64::MAX, -1, 0], &[0, 1, 2, 3], &[0.0; 4], 1);
        check(&[i64::MIN, -1, i64::MAX - 1], &[0, 1, 2], &[0.0; 3], i64::MAX as u64);
    }

    #[test]
    fn deltas_beyond_i64_never_come_out_as_times() {
        let columns = |unit, first, deltas: &[i64]| ObservationColumns {
            time_unit_nanos: unit,
            first_time_nanos: first,
            time_deltas: deltas.to_vec(),
            values: vec![0.0; deltas.len()],
            ..ObservationColumns::default()
        };
        let times = |unit, first, deltas| decode(columns(unit, first, deltas)).expect("well formed").times_nanos;
        assert_eq!(times(0, 5, &[0, 2]), [5, 7]);
        // 2^62 units of 8 ns wrap to 0: each of these would have come out as 5.
        assert_eq!(times(8, 5, &[0, 1 << 62, 1]), [5, -1, -1]);
        assert_eq!(times(1, i64::MAX, &[0, 1, -1]), [i64::MAX, i64::MIN, i64::MAX]);
        let error = decode(columns(1 << 63, 5, &[0])).expect_err("too large");
        assert_eq!(error.field, "observations.time_unit_nanos");
    }

    #[test]
    fn malformed_columns_name_the_column() {
        let good = encode(&[1, 2, 3], &[0, 1, 2], &[0.5; 3], Vec::new());
        let wrong = |change: fn(&mut ObservationColumns)| {
            let mut columns = good.clone();
            change(&mut columns);
            decode(columns).expect_err("malformed").field
        };
        assert_eq!(wrong(|c| c.time_deltas.clear()), "observations.time_deltas");
        assert_eq!(wrong(|c| c.values.truncate(2)), "observations.values");
        assert_eq!(wrong(|c| c.values.clear()), "observations.values");
        assert_eq!(wrong(|c| c.bits = vec![0].into()), "observations.values");
        assert_eq!(wrong(|c| c.state_indices.truncate(1)), "observations.state_indices");
        assert_eq!(
            wrong(|c| {
                c.values.clear();
                c.bits = vec![0, 0].into();
            }),
            "observations.bits"
        );
    }
}

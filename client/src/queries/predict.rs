//! Predictions of any number of states and times, requested in pieces within the limits of the daemon.
//!
//! Invariant: every state gets a prediction for every time, by state and then by time; a reply that omits or reorders
//! anything is an error.

use std::ops::Range;

use tidemap_model::LABELS;
use tidemap_proto::{
    convert::{
        query::{selector_from_wire, selector_to_wire},
        time::instant,
    },
    v1,
};
use tonic::Streaming;

use super::ModelSelector;
use crate::{connection::Client, error::Error};

/// Limits of one request of the daemon, with a margin in the bytes.
const STATES_MAX: usize = 10_000;
const PREDICTIONS_MAX: usize = 1_000_000;
const TIMES_MAX: usize = 65_536;
const NAME_BYTES_MAX: usize = 400_000;
/// Bytes of a name on the wire in addition to its text.
const NAME_BYTES_EXTRA: usize = 3;

/// Predictions of one state at consecutive requested times.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictionRun {
    /// Index of the state in the request.
    pub state: usize,
    /// The axis of a vector: 0 for x.
    pub axis: Option<usize>,
    /// The label of a categorical state.
    pub label: Option<String>,
    /// Index of the first time in the request.
    pub first_time: usize,
    /// Probability that the state is 1, or the expected value of other kinds, one per time.
    pub probabilities: Vec<f64>,
    /// Lower end of the credible interval, one per time, or empty.
    pub lower: Vec<f64>,
    /// Upper end of the credible interval, one per time, or empty.
    pub upper: Vec<f64>,
    /// The probability that each interval holds, at least the requested level; one per time, or empty.
    pub masses: Vec<f64>,
    /// Entropy of each prediction.
    pub entropies_bits: Vec<f64>,
    /// Order of the spectral model that predicted.
    pub order: u32,
    /// Number of acknowledged observations of the state.
    pub observations: u64,
    /// Time of the newest observation.
    pub last_nanos: Option<i64>,
    /// Number of observations that no update has learned yet.
    pub pending: u64,
    /// The model that predicted. `None`: nothing was learned, and the prior predicts.
    pub answered_by: Option<ModelSelector>,
}

impl PredictionRun {
    /// The age of the newest observation at a time, see [`age_nanos`]. `None`: there is no observation.
    #[must_use]
    pub fn age_nanos(&self, at_nanos: i64) -> Option<i64> {
        self.last_nanos.map(|last_nanos| age_nanos(last_nanos, at_nanos))
    }
}

/// The time from the newest observation to a time, in nanoseconds; 0 for a time before the newest observation, because
/// observations on both sides describe it.
#[must_use]
pub fn age_nanos(last_nanos: i64, at_nanos: i64) -> i64 {
    at_nanos.saturating_sub(last_nanos).max(0)
}

/// Predictions in progress.
#[derive(Debug)]
pub struct Predictions {
    client: Client,
    map: String,
    states: Vec<String>,
    times: Vec<i64>,
    model: ModelSelector,
    interval_level: f64,
    pieces: std::vec::IntoIter<Piece>,
    current: Option<(Piece, Streaming<v1::PredictStatesResponse>)>,
    /// The next expected prediction, if the daemon keeps the order.
    next: Next,
}

/// One request.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Piece {
    states: Range<usize>,
    times: Range<usize>,
}

impl Client {
    /// Predicts `states` at `times` (nanoseconds). Nothing is sent before the first [`Predictions::next`].
    #[must_use]
    pub fn predict(&self, map: &str, states: Vec<String>, times: Vec<i64>, model: ModelSelector) -> Predictions {
        let lengths: Vec<usize> = states.iter().map(String::len).collect();
        let pieces = pieces(&lengths, times.len()).into_iter();
        Predictions {
            client: self.clone(),
            map: map.to_owned(),
            states,
            times,
            model,
            interval_level: 0.0,
            pieces,
            current: None,
            next: Next::default(),
        }
    }
}

impl Predictions {
    /// The next predictions; `None` after the last.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist.
    pub async fn next(&mut self) -> Result<Option<PredictionRun>, Error> {
        loop {
            if let Some((piece, replies)) = &mut self.current {
                let reply = replies.message().await.map_err(|status| self.client.error(&status))?;
                if let Some(reply) = reply {
                    return checked(reply, piece, &mut self.next).map(Some);
                }
                if !self.next.is_after(piece.states.len()) {
                    return Err(Error::Protocol("predictions are missing"));
                }
                self.current = None;
            }
            let Some(piece) = self.pieces.next() else { return Ok(None) };
            let request = v1::PredictStatesRequest {
                map: self.map.clone(),
                states: self.states[piece.states.clone()].to_vec(),
                times_nanos: self.times[piece.times.clone()].to_vec(),
                model: Some(selector_to_wire(self.model)),
                interval_level: self.interval_level,
            };
            let answer = self.client.query_service().predict_states(request).await;
            let replies = answer.map_err(|status| self.client.error(&status))?.into_inner();
            self.next = Next::default();
            self.current = Some((piece, replies));
        }
    }

    /// Also requests credible intervals, which contain the mean over the hour around a time with this probability, in
    /// (0, 1).
    #[must_use]
    pub fn with_intervals(self, level: f64) -> Self {
        Self { interval_level: level, ..self }
    }

    /// The requested states.
    #[must_use]
    pub fn states(&self) -> &[String] {
        &self.states
    }

    /// The requested times.
    #[must_use]
    pub fn times(&self) -> &[i64] {
        &self.times
    }
}

/// The next expected prediction of a piece.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Next {
    state: usize,
    /// Number of complete axes or labels: after the second, the daemon decides whether there are more.
    axes: usize,
    time: usize,
}

impl Next {
    /// Whether all of the given number of states have arrived.
    fn is_after(self, states: usize) -> bool {
        self.time == 0
            && (self == Self { state: states, axes: 0, time: 0 } || (self.state + 1 == states && self.axes >= 2))
    }

    /// Whether this prediction may come now: `axis` is 0 for a state that is not a vector.
    fn may_be(self, state: usize, axis: usize, time: usize) -> bool {
        let is_next = match axis {
            0 => (state, self.axes) == (self.state, 0),
            _ => (state, axis) == (self.state, self.axes + 1),
        };
        // A vector of two coordinates, or a categorical state, is complete, and this belongs to the next state.
        let is_beyond = self.axes >= 2 && self.time == 0 && state == self.state + 1 && axis <= 1;
        time == self.time && axis <= *LABELS.end() && (is_next || is_beyond)
    }

    /// The prediction expected after the last time of this one.
    fn after(state: usize, axis: usize) -> Self {
        if axis == 0 || axis == 3 {
            Self { state: state + 1, axes: 0, time: 0 }
        } else {
            Self { state, axes: axis, time: 0 }
        }
    }
}

fn checked(reply: v1::PredictStatesResponse, piece: &Piece, next: &mut Next) -> Result<PredictionRun, Error> {
    let (state, time, count) = (reply.state_index as usize, reply.first_time_index as usize, reply.probabilities.len());
    let axis = reply.axis as usize;
    let in_order = next.may_be(state, axis, time) && state < piece.states.len();
    let fits = count > 0 && time + count <= piece.times.len();
    let fits_too = |column: &Vec<f64>| column.is_empty() || column.len() == count;
    let columns = [&reply.lower, &reply.upper, &reply.masses, &reply.entropies_bits];
    if !in_order || !fits || !columns.into_iter().all(fits_too) {
        return Err(Error::Protocol("predictions are not those that were requested"));
    }
    *next = match time + count {
        // The daemon knows the number of labels.
        all if all == piece.times.len() && !reply.label.is_empty() => Next { state, axes: axis, time: 0 },
        all if all == piece.times.len() => Next::after(state, axis),
        time => Next { state, axes: axis.saturating_sub(1), time },
    };
    Ok(PredictionRun {
        state: piece.states.start + state,
        axis: axis.checked_sub(1),
        label: Some(reply.label).filter(|label| !label.is_empty()),
        first_time: piece.times.start + time,
        probabilities: reply.probabilities,
        lower: reply.lower,
        upper: reply.upper,
        masses: reply.masses,
        entropies_bits: reply.entropies_bits,
        order: reply.order,
        observations: reply.observations,
        last_nanos: instant(reply.last_time),
        pending: reply.pending,
        answered_by: reply.answered_by.and_then(|model| selector_from_wire("answered_by", Some(model)).ok()),
    })
}

/// Splits the request: states together as long as all times fit, else state by state.
fn pieces(name_lengths: &[usize], times: usize) -> Vec<Piece> {
    let mut pieces = Vec::new();
    if times == 0 {
        return pieces;
    }
    let together = if times > TIMES_MAX { 1 } else { (PREDICTIONS_MAX / times).clamp(1, STATES_MAX) };
    let mut start = 0;
    while start < name_lengths.len() {
        let mut bytes = 0;
        let fitting = name_lengths[start..].iter().take(together).take_while(|&&length| {
            bytes += length + NAME_BYTES_EXTRA;
            bytes <= NAME_BYTES_MAX
        });
        let end = start + fitting.count().max(1);
        for first in (0..times).step_by(TIMES_MAX) {
            pieces.push(Piece { states: start..end, times: first..times.min(first + TIMES_MAX) });
        }
        start = end;
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_is_cut_up_by_the_limits_and_keeps_its_order() {
        assert_eq!(pieces(&[4, 4], 3), [Piece { states: 0..2, times: 0..3 }]);
        assert_eq!(pieces(&[4, 4], 0), []);
        assert_eq!(
            pieces(&[4; 25_000], 1).iter().map(|piece| piece.states.len()).collect::<Vec<_>>(),
            [10_000, 10_000, 5_000]
        );
        assert_eq!(pieces(&[4; 40], 50_000).iter().map(|piece| piece.states.len()).collect::<Vec<_>>(), [20, 20]);
        let long = pieces(&[4, 4], 100_000);
        assert_eq!(
            long,
            [
                Piece { states: 0..1, times: 0..65_536 },
                Piece { states: 0..1, times: 65_536..100_000 },
                Piece { states: 1..2, times: 0..65_536 },
                Piece { states: 1..2, times: 65_536..100_000 },
            ]
        );
        let names = pieces(&[512; 2_000], 1);
        assert_eq!(names.iter().map(|piece| piece.states.len()).collect::<Vec<_>>(), [776, 776, 448]);
    }

    #[test]
    fn an_answer_out_of_order_is_an_error() {
        let piece = Piece { states: 10..12, times: 0..3 };
        let reply = |state_index, first_time_index, count| v1::PredictStatesResponse {
            state_index,
            first_time_index,
            probabilities: vec![0.5; count],
            entropies_bits: vec![1.0; count],
            ..Default::default()
        };
        let mut next = Next::default();
        assert_eq!(checked(reply(0, 0, 2), &piece, &mut next).map(|run| run.state), Ok(10));
        assert!(checked(reply(1, 0, 3), &piece, &mut next.clone()).is_err(), "a time is left out");
        assert!(checked(reply(0, 2, 2), &piece, &mut next.clone()).is_err(), "more than was asked for");
        assert!(checked(reply(0, 2, 0), &piece, &mut next.clone()).is_err(), "nothing at all");
        assert_eq!(checked(reply(0, 2, 1), &piece, &mut next).map(|run| run.first_time), Ok(2));
        assert_eq!(checked(reply(1, 0, 3), &piece, &mut next).map(|run| run.state), Ok(11));
        assert!(next.is_after(2));
        assert!(checked(reply(2, 0, 3), &piece, &mut next).is_err(), "no such state");
    }

    #[test]
    fn a_vector_is_answered_axis_by_axis() {
        let piece = Piece { states: 10..13, times: 0..3 };
        let reply = |state_index, axis, first_time_index, count| v1::PredictStatesResponse {
            state_index,
            axis,
            first_time_index,
            probabilities: vec![1.5; count],
            ..Default::default()
        };
        let mut next = Next::default();
        let mut take = |state, axis, time, count| {
            checked(reply(state, axis, time, count), &piece, &mut next).map(|run| (run.state, run.axis, run.first_time))
        };
        assert!(take(0, 2, 0, 3).is_err(), "x is left out");
        assert_eq!(take(0, 1, 0, 2), Ok((10, Some(0), 0)));
        assert!(take(0, 2, 0, 3).is_err() && take(0, 1, 0, 3).is_err(), "a time of x is left out");
        assert_eq!(take(0, 1, 2, 1), Ok((10, Some(0), 2)));
        assert!(take(1, 0, 0, 3).is_err() && take(0, 3, 0, 3).is_err(), "y is left out");
        assert_eq!(take(0, 2, 0, 3), Ok((10, Some(1), 0)));
        assert!(take(2, 0, 0, 3).is_err() && take(1, 2, 0, 3).is_err(), "a state or x is left out");
        assert_eq!(take(1, 0, 0, 3), Ok((11, None, 0)));
        for axis in 1..=3 {
            assert_eq!(take(2, axis, 0, 3), Ok((12, Some(axis as usize - 1), 0)));
        }
        assert!(next.is_after(3));
        assert!(Next { state: 2, axes: 2, time: 0 }.is_after(3) && !Next { state: 2, axes: 1, time: 0 }.is_after(3));
    }
}

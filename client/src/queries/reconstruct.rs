//! Exact observations of the past.
//!
//! Invariant: observations come by time, each once, within the requested interval; anything else is an error.

use tidemap_proto::{convert::time::timestamp, v1};
use tonic::Streaming;

use crate::{connection::Client, error::Error};

/// A reply in progress.
#[derive(Debug)]
pub struct Reconstruction {
    client: Client,
    replies: Streaming<v1::ReconstructResponse>,
    from_nanos: i64,
    to_nanos: i64,
}

impl Client {
    /// Reads back the observations of a state, or of a cell (`cell/X/Y/Z`), from one time up to, not including,
    /// another.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist, `FAILED_PRECONDITION` if the map does not
    /// keep its history, `OUT_OF_RANGE` if the history does not reach back that far.
    pub async fn reconstruct(
        &self,
        map: &str,
        state: &str,
        from_nanos: i64,
        to_nanos: i64,
    ) -> Result<Reconstruction, Error> {
        let [from_time, to_time] = [from_nanos, to_nanos].map(|nanos| Some(timestamp(nanos)));
        let request = v1::ReconstructRequest { map: map.to_owned(), state: state.to_owned(), from_time, to_time };
        let answer = self.query_service().reconstruct(request).await.map_err(|status| self.error(&status))?;
        Ok(Reconstruction { client: self.clone(), replies: answer.into_inner(), from_nanos, to_nanos })
    }
}

impl Reconstruction {
    /// The next times and values; `None` after the last.
    ///
    /// # Errors
    /// [`Error`]
    pub async fn next(&mut self) -> Result<Option<Vec<(i64, f64)>>, Error> {
        let Some(reply) = self.replies.message().await.map_err(|status| self.client.error(&status))? else {
            return Ok(None);
        };
        let seen = checked(reply, self.from_nanos..self.to_nanos)?;
        if let Some((last, _)) = seen.last() {
            self.from_nanos = *last;
        }
        Ok(Some(seen))
    }
}

/// Several producers may observe a state at the same time.
fn checked(reply: v1::ReconstructResponse, requested: std::ops::Range<i64>) -> Result<Vec<(i64, f64)>, Error> {
    let v1::ReconstructResponse { times_nanos, values } = reply;
    let ascending = times_nanos.is_sorted() && times_nanos.iter().all(|time| requested.contains(time));
    if times_nanos.len() != values.len() || !ascending {
        return Err(Error::Protocol("observations are not those that were requested"));
    }
    Ok(times_nanos.into_iter().zip(values).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observations_come_by_time_and_within_what_was_requested() {
        let reply = |times: &[i64]| v1::ReconstructResponse { times_nanos: times.to_vec(), values: vec![1.0; 2] };
        assert_eq!(checked(reply(&[5, 9]), 5..10), Ok(vec![(5, 1.0), (9, 1.0)]));
        assert_eq!(checked(reply(&[5, 5]), 5..10), Ok(vec![(5, 1.0), (5, 1.0)]));
        for wrong in [&[9, 5][..], &[4, 5], &[5, 10], &[5], &[5, 6, 7]] {
            assert!(checked(reply(wrong), 5..10).is_err(), "{wrong:?}");
        }
    }
}

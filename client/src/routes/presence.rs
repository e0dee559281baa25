//! Who is where at which time, and when several are likely all at once.
//!
//! Invariant: probabilities and shares are in the order of the nodes.

use tidemap_proto::convert::query::selector_to_wire;
use tidemap_proto::convert::time::{duration, instant, timestamp};
use tidemap_proto::v1;

use crate::{connection::Client, error::Error, queries::ModelSelector};

/// What is asked of presence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PresenceQuery {
    /// Name of the map.
    pub map: String,
    /// Who or what: the states `node/N/OBJECT`; empty: the states called like the nodes.
    pub object: String,
    /// At which times, nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// Which model predicts.
    pub model: ModelSelector,
}

/// Who is where.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Presence {
    /// Names of the nodes that were observed.
    pub nodes: Vec<String>,
    /// By time, as asked.
    pub times: Vec<PresenceAt>,
    /// Names of nodes that were never observed, the first 1000.
    pub unobserved: Vec<String>,
    /// How many these are in all.
    pub unobserved_nodes: u32,
}

/// Who is where at a time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PresenceAt {
    /// The time, nanoseconds UTC.
    pub time_nanos: i64,
    /// How likely somebody is at each node.
    pub probabilities: Vec<f64>,
    /// The same over their sum; empty where all are 0.
    pub shares: Vec<f64>,
    /// How likely anybody is anywhere.
    pub anybody: f64,
}

/// What is asked of several states at once. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointQuery {
    /// Name of the map.
    pub map: String,
    /// Names of states, probabilities all.
    pub states: Vec<String>,
    /// The first time that counts, nanoseconds UTC.
    pub from_nanos: i64,
    /// How far to look ahead, nanoseconds.
    pub within_nanos: Option<i64>,
    /// Distance of the times that are looked at, nanoseconds.
    pub step_nanos: Option<i64>,
    /// What the product of the probabilities has to exceed.
    pub threshold: Option<f64>,
    /// Which model predicts.
    pub model: ModelSelector,
}

/// When several states are likely to be 1 all at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// The first time at which the product exceeds the threshold, nanoseconds UTC.
    pub time_nanos: Option<i64>,
    /// The product then, or the greatest there is.
    pub probability: f64,
    /// When the greatest product is, of the times that were looked at.
    pub best_nanos: i64,
}

impl Client {
    /// How likely somebody, or something, is at each node of a map at the times.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` where there is no such map, `FAILED_PRECONDITION` where it has no nodes, or none that
    /// was observed.
    pub async fn predict_presence(&self, query: PresenceQuery) -> Result<Presence, Error> {
        let PresenceQuery { map, object, times_nanos, model } = query;
        let request = v1::PredictPresenceRequest { map, object, times_nanos, model: Some(selector_to_wire(model)) };
        let answer = self.search_service().predict_presence(request).await.map_err(|status| self.error(&status))?;
        let told = answer.into_inner();
        let at = |at: v1::PresenceAt| {
            let v1::PresenceAt { time_nanos, probabilities, shares, anybody } = at;
            PresenceAt { time_nanos, probabilities, shares, anybody }
        };
        Ok(Presence {
            nodes: told.nodes,
            times: told.times.into_iter().map(at).collect(),
            unobserved: told.unobserved,
            unobserved_nodes: told.unobserved_nodes,
        })
    }

    /// The next time at which the states of a set are likely enough to be 1 all together.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` where there is no such map or state.
    pub async fn next_joint(&self, query: JointQuery) -> Result<Joint, Error> {
        let request = v1::NextJointRequest {
            map: query.map,
            states: query.states,
            from_time: Some(timestamp(query.from_nanos)),
            within: query.within_nanos.map(duration),
            step: query.step_nanos.map(duration),
            threshold: query.threshold,
            model: Some(selector_to_wire(query.model)),
        };
        let answer = self.search_service().next_joint(request).await.map_err(|status| self.error(&status))?;
        let v1::NextJointResponse { time, probability, best_time } = answer.into_inner();
        let best_nanos = instant(best_time).ok_or(Error::Protocol("a joint has no best time"))?;
        Ok(Joint { time_nanos: instant(time), probability, best_nanos })
    }
}

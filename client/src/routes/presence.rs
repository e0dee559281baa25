//! PresenceForecast of a target over time, and the next time at which several states are likely to be 1 together.
//!
//! Invariant: probabilities and shares are in the order of the nodes.

use tidemap_proto::{
    convert::{
        query::selector_to_wire,
        time::{duration, instant, timestamp},
    },
    v1,
};

use crate::{connection::Client, error::Error, queries::ModelSelector};

/// A request for presence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PresenceQuery {
    /// Name of the map.
    pub map: String,
    /// Name of the target: presence is read from the states `node/N/OBJECT`. Empty: from the states that are named like
    /// the nodes.
    pub object: String,
    /// Times, nanoseconds UTC; at least one.
    pub times_nanos: Vec<i64>,
    /// The model that predicts.
    pub model: ModelSelector,
}

/// The presence of a target.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PresenceForecast {
    /// Names of the nodes that were observed.
    pub nodes: Vec<String>,
    /// The presence, in the order of the requested times.
    pub times: Vec<PresenceAt>,
    /// Names of the nodes that were never observed, the first 1000.
    pub unobserved: Vec<String>,
    /// Number of nodes that were never observed.
    pub unobserved_nodes: u32,
}

/// The presence at one time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PresenceAt {
    /// The time, nanoseconds UTC.
    pub time_nanos: i64,
    /// Probability of presence at each node.
    pub probabilities: Vec<f64>,
    /// The probabilities divided by their sum; empty if all are 0.
    pub shares: Vec<f64>,
    /// Probability of presence at any node.
    pub anybody: f64,
}

/// A request about several states together. `None`: the daemon's default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointQuery {
    /// Name of the map.
    pub map: String,
    /// Names of states, all of them probabilities.
    pub states: Vec<String>,
    /// The first time that counts, nanoseconds UTC.
    pub from_nanos: i64,
    /// The forecast horizon, nanoseconds.
    pub within_nanos: Option<i64>,
    /// Interval between the times that are tried, nanoseconds.
    pub step_nanos: Option<i64>,
    /// Threshold that the product of the probabilities must exceed.
    pub threshold: Option<f64>,
    /// The model that predicts.
    pub model: ModelSelector,
}

/// The next time at which several states are likely to be 1 together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// The first time at which the product exceeds the threshold, nanoseconds UTC.
    pub time_nanos: Option<i64>,
    /// The product at that time, or the greatest product.
    pub probability: f64,
    /// The time of the greatest product, among all tried times.
    pub best_nanos: i64,
}

impl Client {
    /// Forecasts the presence of a target at each node of a map at the times.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist, `FAILED_PRECONDITION` if it has no nodes, or none
    /// was observed.
    pub async fn predict_presence(&self, query: PresenceQuery) -> Result<PresenceForecast, Error> {
        let PresenceQuery { map, object, times_nanos, model } = query;
        let request = v1::PredictPresenceRequest { map, object, times_nanos, model: Some(selector_to_wire(model)) };
        let answer = self.search_service().predict_presence(request).await.map_err(|status| self.error(&status))?;
        let reply = answer.into_inner();
        let at = |at: v1::PresenceAt| {
            let v1::PresenceAt { time_nanos, probabilities, shares, anybody } = at;
            PresenceAt { time_nanos, probabilities, shares, anybody }
        };
        Ok(PresenceForecast {
            nodes: reply.nodes,
            times: reply.times.into_iter().map(at).collect(),
            unobserved: reply.unobserved,
            unobserved_nodes: reply.unobserved_nodes,
        })
    }

    /// Finds the next time at which all states of a set are likely to be 1.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map or state does not exist.
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

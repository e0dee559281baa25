//! The numbers of observations of each topic that were accepted, skipped and refused, and the reasons.
//!
//! Invariant: reasons are counted, not kept one by one; their number is bounded.

use std::collections::BTreeMap;

use tidemap_recordings::{
    convert::{BeamCounts, NotMade},
    plan::Plan,
    survey::Surveyed,
};

use crate::progress::status_line;

/// Maximum number of different reasons of a topic.
const REASONS_MAX: usize = 20;

/// Counts of a topic.
#[derive(Clone, Debug, Default)]
pub(super) struct TopicCount {
    /// Observations that are durable and that no earlier run had sent.
    pub(super) accepted: u64,
    /// Messages, or parts of messages, that become no observation: without a place, or left out by a mapping.
    pub(super) skipped: u64,
    /// Observations that are wrong, or that the daemon refused.
    pub(super) refused: u64,
    /// The beams of the scans and clouds that have a place.
    beams: BeamCounts,
    reasons: BTreeMap<String, u64>,
    other_reasons: u64,
}

impl TopicCount {
    fn reason(&mut self, why: &str) {
        if let Some(count) = self.reasons.get_mut(why) {
            *count += 1;
        } else if self.reasons.len() < REASONS_MAX {
            self.reasons.insert(why.to_owned(), 1);
        } else {
            self.other_reasons += 1;
        }
    }
}

/// Counts of all topics, in the order of the survey.
#[derive(Clone, Debug)]
pub(super) struct TopicCounts(Vec<TopicCount>);

impl TopicCounts {
    pub(super) fn new(surveyed: &Surveyed) -> Self {
        Self(vec![TopicCount::default(); surveyed.topics.len()])
    }

    /// Counts of a recording of which no scan and no cloud has a place: all are skipped.
    pub(super) fn without_place(surveyed: &Surveyed, plan: &Plan) -> Self {
        let skipped = surveyed.topics.iter().zip(&plan.topics).map(|(topic, plan)| {
            let skipped = if plan.is_observed() { topic.messages } else { 0 };
            TopicCount { skipped, ..TopicCount::default() }
        });
        Self(skipped.collect())
    }

    pub(super) fn topics(&self) -> impl Iterator<Item = &TopicCount> {
        self.0.iter()
    }

    pub(super) fn not_made(&mut self, topic: usize, why: &NotMade) {
        let Some(count) = self.0.get_mut(topic) else { return };
        match why {
            NotMade::Wrong(_) => count.refused += 1,
            NotMade::NoTransform(_)
            | NotMade::NoFrame(_)
            | NotMade::NoSensor(_)
            | NotMade::Nothing(_)
            | NotMade::Thinned
            | NotMade::OtherPart
            | NotMade::SameStamp
            | NotMade::Repeated
            | NotMade::LeftOut(_) => count.skipped += 1,
        }
        count.reason(&why.to_string());
    }

    pub(super) fn refused(&mut self, topic: usize, why: &str) {
        let Some(count) = self.0.get_mut(topic) else { return };
        count.refused += 1;
        count.reason(why);
    }

    pub(super) fn accepted(&mut self, topic: usize) {
        if let Some(count) = self.0.get_mut(topic) {
            count.accepted += 1;
        }
    }

    /// Takes the beams of each topic so far.
    pub(super) fn have_beams(&mut self, beams: &BTreeMap<usize, BeamCounts>) {
        for (topic, beams) in beams {
            if let Some(count) = self.0.get_mut(*topic) {
                count.beams = *beams;
            }
        }
    }

    /// Whether anything is wrong, or was refused.
    pub(super) fn has_refused(&self) -> bool {
        self.0.iter().any(|count| count.refused > 0)
    }

    /// Reports the reasons, and the beams without a return.
    pub(super) fn report(&self, surveyed: &Surveyed) {
        for (topic, count) in surveyed.topics.iter().zip(&self.0) {
            for notice in count.beams.notices() {
                status_line(&format!("{}: {notice}", topic.name));
            }
            for (why, times) in &count.reasons {
                let times = if *times == 1 { String::new() } else { format!(", {times} times") };
                status_line(&format!("{}: {why}{times}", topic.name));
            }
            if count.other_reasons > 0 {
                status_line(&format!("{}: {} more for other reasons", topic.name, count.other_reasons));
            }
        }
    }
}

//! Sends the observations of a fork to its map again, as if from their producers.
//!
//! Invariant: an observation is sent under the number and the incarnation that its producer gave it, so that the map
//! has it once, however often this is repeated. After an observation that cannot be sent, no further observation of its
//! producer is sent.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use tidemap_client::{
    Client,
    cluster::ForkPart,
    observe::{Producer, ProducerError, ProducerOptions},
};
use tidemap_proto::v1::{self, forked_observation::Content};

/// The longest time for which the map may be without a writer meanwhile.
const PATIENCE: Duration = Duration::from_secs(30);
/// The result of taking in a fork.
#[derive(Debug, Default)]
pub(super) struct TakenIn {
    /// Observations that the map has now, and did not have before.
    pub taken: u64,
    /// The reasons why observations were not taken: sentences for people.
    pub reasons: BTreeSet<String>,
}

/// A producer of the fork.
enum Sending {
    /// No observation of the producer has come yet.
    Waits,
    Open(Box<Resent>),
    /// No further observation of the producer is sent.
    Ended,
}

/// A stream in the name of a producer.
struct Resent {
    producer: Producer,
    /// The incarnation of the fork, which the stream has presented.
    incarnation: u64,
    /// Numbers of observations that the map refused the first time, too.
    refused: BTreeSet<u64>,
    sent: u64,
}

/// The next step for an observation.
enum Step {
    /// The map has it.
    Known,
    Send,
    /// Nothing more can be sent, and why.
    End(String),
}

fn step(observation: &v1::ForkedObservation, next: u64) -> Step {
    let sequence = observation.sequence;
    if sequence < next {
        return Step::Known;
    }
    if sequence > next {
        return Step::End(format!("the map lacks observations {next} to {} before it", sequence - 1));
    }
    match &observation.content {
        Some(Content::Left(what)) => Step::End(format!("observation {sequence} is {what}, which cannot be sent again")),
        _ => Step::Send,
    }
}

impl Resent {
    async fn open(client: &Client, map: &str, part: &v1::ForkedObservations) -> Result<Resent, ProducerError> {
        let options = ProducerOptions {
            incarnation: part.incarnation,
            patience: PATIENCE,
            ..ProducerOptions::new(&part.producer, &part.label, map)
        };
        let producer = Producer::open(client, options).await?;
        Ok(Resent { producer, incarnation: part.incarnation, refused: BTreeSet::new(), sent: 0 })
    }

    async fn send(&mut self, observation: v1::ForkedObservation) -> Result<(), ProducerError> {
        let v1::ForkedObservation { sequence, state, time_nanos, content } = observation;
        match content {
            Some(Content::Value(value)) => self.producer.send(&state, time_nanos, value).await?,
            Some(Content::Position(position)) => {
                self.producer.send_position(&state, time_nanos, &position.coordinates).await?
            }
            Some(Content::Label(label)) => self.producer.send_label(&state, time_nanos, &label).await?,
            // The observation was refused, and is refused again: no state has an empty name.
            Some(Content::Left(_)) | None => {
                self.refused.insert(sequence);
                return self.producer.send("", 0, 0.0).await.map(drop);
            }
        };
        self.sent += 1;
        Ok(())
    }

    /// Waits until everything is durable; returns the number of observations that the map has taken, and the reasons if
    /// not all were taken.
    async fn close(mut self) -> (u64, Option<String>) {
        let closed = self.producer.close().await;
        let refusals = self.producer.take_refusals();
        let mut new = refusals.into_iter().filter(|refusal| !self.refused.contains(&refusal.sequence)).peekable();
        let reason = new.peek().map(|first| first.detail.clone());
        let taken = self.sent.saturating_sub(new.count() as u64);
        match closed {
            Ok(_) => (taken, reason.map(|reason| format!("the map refuses observations: {reason}"))),
            Err(error) => (0, Some(error.to_string())),
        }
    }
}

/// Producers, with label, whose observations in a fork are not all in the map, and those of these producers that stream
/// now.
async fn lacking(to: &Client, map: &str, fork: &v1::LogFork) -> anyhow::Result<BTreeMap<(String, String), bool>> {
    let rows = fork.producers.iter().filter(|row| row.known_observations < row.observations);
    let mut lacking: BTreeMap<(String, String), bool> =
        rows.map(|row| ((row.producer.clone(), row.label.clone()), false)).collect();
    if !lacking.is_empty() {
        for known in to.producers(map).await?.into_iter().filter(|known| known.is_connected) {
            lacking.entry((known.producer, known.label)).and_modify(|is_streaming| *is_streaming = true);
        }
    }
    Ok(lacking)
}

/// Sends the observations that a fork of the daemon `from` holds and the map lacks, through the daemon `to`.
///
/// # Errors
/// The fork or the producers of the map cannot be read.
pub(super) async fn take_in(to: &Client, from: &Client, map: &str, fork: &v1::LogFork) -> anyhow::Result<TakenIn> {
    let mut taken_in = TakenIn::default();
    let mut producers: BTreeMap<(String, String), Sending> = BTreeMap::new();
    for (key, is_streaming) in lacking(to, map, fork).await? {
        // Another stream with the producer's incarnation would end its open stream.
        if is_streaming {
            let why = "it sends observations now. Stop it, and run the command again";
            taken_in.reasons.insert(format!("producer {:?}: {why}", key.0));
            producers.insert(key, Sending::Ended);
        } else {
            producers.insert(key, Sending::Waits);
        }
    }
    let mut parts = from.read_fork(map, &fork.name).await?;
    while let Some(part) = parts.next().await? {
        match part {
            ForkPart::State(request) => {
                let state = request.state.clone();
                if let Err(error) = to.add_requested_state(request).await {
                    taken_in.reasons.insert(format!("state {state:?} cannot be added: {error}"));
                }
            }
            ForkPart::Other(what) => drop(taken_in.reasons.insert(format!("it holds {what}"))),
            ForkPart::Observations(part) => {
                let key = (part.producer.clone(), part.label.clone());
                // The map has everything of the others.
                let Some(sending) = producers.remove(&key) else { continue };
                let sending = match sending {
                    Sending::Open(resent) if resent.incarnation == part.incarnation => Sending::Open(resent),
                    // The producer began anew within the fork.
                    Sending::Open(resent) => {
                        end(*resent, &part.producer, &mut taken_in).await;
                        open(to, map, &part, &mut taken_in).await
                    }
                    Sending::Waits => open(to, map, &part, &mut taken_in).await,
                    Sending::Ended => Sending::Ended,
                };
                let sending = match sending {
                    Sending::Open(resent) => send_part(resent, part, &mut taken_in).await,
                    other => other,
                };
                producers.insert(key, sending);
            }
        }
    }
    for ((producer, _), sending) in producers {
        if let Sending::Open(resent) = sending {
            end(*resent, &producer, &mut taken_in).await;
        }
    }
    Ok(taken_in)
}

async fn open(to: &Client, map: &str, part: &v1::ForkedObservations, taken_in: &mut TakenIn) -> Sending {
    match Resent::open(to, map, part).await {
        Ok(resent) => Sending::Open(Box::new(resent)),
        Err(error) => {
            taken_in.reasons.insert(format!("producer {:?}: {error}", part.producer));
            Sending::Ended
        }
    }
}

async fn end(resent: Resent, producer: &str, taken_in: &mut TakenIn) {
    let (taken, reason) = resent.close().await;
    taken_in.taken += taken;
    taken_in.reasons.extend(reason.map(|reason| format!("producer {producer:?}: {reason}")));
}

async fn send_part(mut resent: Box<Resent>, part: v1::ForkedObservations, taken_in: &mut TakenIn) -> Sending {
    for observation in part.observations {
        let why = match step(&observation, resent.producer.last_sequence() + 1) {
            Step::Known => continue,
            Step::Send => match resent.send(observation).await {
                Ok(()) => continue,
                Err(error) => error.to_string(),
            },
            Step::End(why) => why,
        };
        taken_in.reasons.insert(format!("producer {:?}: {why}", part.producer));
        end(*resent, &part.producer, taken_in).await;
        return Sending::Ended;
    }
    Sending::Open(resent)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observations_are_sent_in_their_order_and_without_gaps() {
        let observation =
            |sequence, content| v1::ForkedObservation { sequence, content, ..v1::ForkedObservation::default() };
        assert!(matches!(step(&observation(3, Some(Content::Value(1.0))), 4), Step::Known));
        assert!(matches!(step(&observation(4, Some(Content::Value(1.0))), 4), Step::Send));
        assert!(matches!(step(&observation(4, None), 4), Step::Send), "its number is used up again");
        let Step::End(why) = step(&observation(6, Some(Content::Value(1.0))), 4) else { panic!("a gap") };
        assert!(why.contains("4 to 5"), "{why}");
        let Step::End(why) = step(&observation(4, Some(Content::Left("a scan".to_owned()))), 4) else {
            panic!("a scan")
        };
        assert!(why.contains("a scan"), "{why}");
        assert!(matches!(step(&observation(3, Some(Content::Left("a scan".to_owned()))), 4), Step::Known));
    }
}

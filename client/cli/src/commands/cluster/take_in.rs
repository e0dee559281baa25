//! Sending what a fork holds to its map again, as from its producers.
//!
//! Invariant: an observation is sent under the number and the incarnation that its producer gave it, so that the map
//! has it once, however often this is repeated. After an observation that cannot be sent nothing more of its producer
//! is.

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

/// How long the map may be without a writer meanwhile.
const PATIENCE: Duration = Duration::from_secs(30);
/// A robot that streams under the name goes on; this waits for it only briefly.
const KEY_PATIENCE: Duration = Duration::from_secs(5);

/// What became of a fork.
#[derive(Debug, Default)]
pub(super) struct TakenIn {
    /// Observations that the map has now, and did not have before.
    pub taken: u64,
    /// Why not all of them: sentences for people.
    pub reasons: BTreeSet<String>,
}

/// A producer of the fork.
enum Sending {
    Open(Box<Resent>),
    /// Nothing more of it is sent.
    Ended,
}

/// A stream in the name of a producer.
struct Resent {
    producer: Producer,
    /// Numbers of observations that the map refused the first time, too.
    refused: BTreeSet<u64>,
    sent: u64,
}

/// What an observation needs to be sent.
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
            key_patience: KEY_PATIENCE,
            ..ProducerOptions::new(&part.producer, &part.label, map)
        };
        let producer = Producer::open(client, options).await?;
        Ok(Resent { producer, refused: BTreeSet::new(), sent: 0 })
    }

    async fn send(&mut self, observation: v1::ForkedObservation) -> Result<(), ProducerError> {
        let v1::ForkedObservation { sequence, state, time_nanos, content } = observation;
        match content {
            Some(Content::Value(value)) => self.producer.send(&state, time_nanos, value).await?,
            Some(Content::Position(position)) => {
                self.producer.send_position(&state, time_nanos, &position.coordinates).await?
            }
            Some(Content::Label(label)) => self.producer.send_label(&state, time_nanos, &label).await?,
            // It was refused, and is again: no state has an empty name.
            Some(Content::Left(_)) | None => {
                self.refused.insert(sequence);
                return self.producer.send("", 0, 0.0).await.map(drop);
            }
        };
        self.sent += 1;
        Ok(())
    }

    /// Waits until everything is durable; gives how many observations the map has taken, and why not more.
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

/// Sends what a fork of the daemon `from` holds, and the map lacks, through the daemon `to`.
///
/// # Errors
/// The fork cannot be read, or a state of it not be added.
pub(super) async fn take_in(to: &Client, from: &Client, map: &str, fork: &str) -> anyhow::Result<TakenIn> {
    let mut taken_in = TakenIn::default();
    let mut producers: BTreeMap<(String, String), Sending> = BTreeMap::new();
    let mut parts = from.read_fork(map, fork).await?;
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
                let sending = match producers.remove(&key) {
                    Some(sending) => sending,
                    None => match Resent::open(to, map, &part).await {
                        Ok(resent) => Sending::Open(Box::new(resent)),
                        Err(error) => {
                            taken_in.reasons.insert(format!("producer {:?}: {error}", part.producer));
                            Sending::Ended
                        }
                    },
                };
                let sending = match sending {
                    Sending::Open(resent) => send_part(resent, part, &mut taken_in).await,
                    Sending::Ended => Sending::Ended,
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

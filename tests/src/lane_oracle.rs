//! The data that each daemon of a cluster must hold, given the numbers acknowledged to the producers of
//! [`crate::lanes`], and a daemon that is alone and learns the same.
//!
//! Invariant: computed only from the feed and the producers' sequence numbers. Producers are paused meanwhile.

use std::{collections::HashSet, time::Duration};

use tidemap_client::{
    Client,
    error::{Error, ServerError},
    maps::NewMap,
    observe::{Producer, ProducerOptions},
    queries::ModelDescription,
    updates::JobState,
};
use tonic::Code;

use crate::{
    feed::Feed,
    lanes::{lane_state, observation},
    oracle::{Mark, producer_name},
    stream::{RawStream, hello},
};

/// Every request is answered by then.
const WITHIN: Duration = Duration::from_secs(300);

/// A time after all that producers with these marks have sent.
#[must_use]
pub fn time_after(feed: &Feed, marks: &[Mark]) -> i64 {
    let newest = marks.iter().map(|mark| mark.sent).max().unwrap_or(0);
    let quiet = Feed { refused_every: 0, ..*feed };
    let times =
        (newest.saturating_sub(Feed::JITTER).max(1)..=newest.max(1)).map(|n| quiet.observation(0, n).time_nanos);
    times.max().unwrap_or(0) + i64::try_from(Feed::JITTER).unwrap_or(0) * feed.step_nanos
}

/// The times and values that a state must have, of the numbers `from..=durable`, in the order of their times.
fn expected(feed: &Feed, producer: usize, state: u32, from: u64, durable: u64) -> Vec<(i64, f64)> {
    let all = (from.max(1)..=durable).map(|sequence| observation(feed, producer, sequence));
    let accepted = all.filter(|o| o.state == state && !o.is_refused());
    let mut rows: Vec<(i64, f64)> = accepted.map(|o| (o.time_nanos, o.value)).collect();
    rows.sort_by_key(|row| row.0);
    rows
}

/// Checks one daemon's map: all observations of the numbers from `since` on, each once, and the number of all of them.
/// Returns what is wrong.
///
/// # Errors
/// The daemon does not answer.
pub async fn check(
    client: &Client,
    map: &str,
    feed: &Feed,
    marks: &[Mark],
    since: &[u64],
) -> Result<Vec<String>, Error> {
    let mut wrong = Vec::new();
    let known = client.producers(map).await?;
    let mut total = 0;
    for (producer, mark) in marks.iter().enumerate() {
        let name = producer_name(producer);
        let durable = known.iter().find(|known| known.producer == name).map_or(0, |known| known.durable_sequence);
        if durable != mark.acknowledged {
            wrong.push(format!("{name}: {} is acknowledged, and {durable} is durable", mark.acknowledged));
        }
        let since = since.get(producer).copied().unwrap_or(0);
        // Times are out of order by less than this.
        let (first, last) = (since.saturating_sub(2 * Feed::JITTER), mark.acknowledged);
        let from_nanos = Feed { refused_every: 0, ..*feed }.observation(0, since.max(1)).time_nanos;
        let until_nanos = time_after(feed, marks) + 1;
        for state in 0..feed.states {
            let mut wanted = expected(feed, producer, state, first, last);
            wanted.retain(|row| row.0 >= from_nanos);
            let found = rows(client, map, &lane_state(producer, state), from_nanos, until_nanos).await?;
            wrong.extend(difference(&lane_state(producer, state), &wanted, &found));
        }
        total += (1..=last).filter(|sequence| !observation(feed, producer, *sequence).is_refused()).count() as u64;
    }
    let observations = client.map(map).await?.observations;
    if observations != total {
        wrong.push(format!("the map should have {total} observations, and has {observations}"));
    }
    Ok(wrong)
}

async fn rows(client: &Client, map: &str, state: &str, from: i64, until: i64) -> Result<Vec<(i64, f64)>, Error> {
    let mut found = Vec::new();
    match client.reconstruct(map, state, from, until).await {
        Ok(mut replies) => {
            while let Some(seen) = replies.next().await? {
                found.extend(seen);
            }
            Ok(found)
        }
        // Nothing of the map was ever acknowledged.
        Err(Error::Server(ServerError { code: Code::NotFound, .. })) => Ok(found),
        Err(error) => Err(error),
    }
}

/// The difference between the found and the wanted observations.
#[must_use]
pub fn difference(state: &str, wanted: &[(i64, f64)], found: &[(i64, f64)]) -> Option<String> {
    if wanted == found {
        return None;
    }
    let key = |row: &(i64, f64)| (row.0, row.1.to_bits());
    let [in_wanted, in_found]: [HashSet<_>; 2] = [wanted, found].map(|rows| rows.iter().map(key).collect());
    let missing: Vec<_> = wanted.iter().filter(|row| !in_found.contains(&key(row))).collect();
    let foreign: Vec<_> = found.iter().filter(|row| !in_wanted.contains(&key(row))).collect();
    let doubled = found.windows(2).filter(|pair| pair[0] == pair[1]).count();
    Some(format!(
        "{state}: {} rows are missing (the first {:?}), {} were never sent (the first {:?}), {doubled} are there twice",
        missing.len(),
        missing.first(),
        foreign.len(),
        foreign.first()
    ))
}

/// Checks the checksum over all that each producer has sent, as the writer of the map has it. Returns what is wrong.
pub async fn check_sums(address: &str, map: &str, feed: &Feed, marks: &[Mark]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (producer, mark) in marks.iter().enumerate() {
        let name = producer_name(producer);
        let (mut stream, welcome) = match RawStream::open(address, hello(&name, map)).await {
            Ok(opened) => opened,
            Err(ended) => {
                wrong.push(format!("no answer: {name} is not welcome: {ended:?}"));
                continue;
            }
        };
        // The key is free again once the daemon has answered.
        stream.close();
        stream.end().await;
        let sum = (1..=mark.acknowledged).fold(0, |crc, sequence| {
            let o = observation(feed, producer, sequence);
            let crc = crc32c::crc32c_append(crc, lane_state(producer, o.state).as_bytes());
            let crc = crc32c::crc32c_append(crc, &o.time_nanos.to_le_bytes());
            crc32c::crc32c_append(crc, &o.value.to_le_bytes())
        });
        let found = (welcome.durable_sequence, welcome.content_crc);
        if found != (mark.acknowledged, sum) {
            wrong.push(format!(
                "{name}: number and checksum should be {:?}, and are {found:?}",
                (mark.acknowledged, sum)
            ));
        }
    }
    wrong
}

/// Updates a map with what comes before a time, and waits for the end of it.
///
/// # Errors
/// The update does not end well.
pub async fn update(client: &Client, map: &str, until_nanos: i64) -> Result<(), String> {
    let updating = async {
        let job = client.run_update(map, Some(until_nanos)).await?;
        let mut watch = client.watch_job(job.id).await?;
        let mut last = job;
        while let Some(job) = watch.next().await? {
            last = job;
        }
        Ok::<_, Error>(last)
    };
    match tokio::time::timeout(WITHIN, updating).await {
        Ok(Ok(job)) if job.state == JobState::Done => Ok(()),
        Ok(Ok(job)) => Err(format!("the update ended: {}", job.error)),
        Ok(Err(error)) => Err(format!("no answer: the update: {error}")),
        Err(_) => Err(format!("the update did not end in {} s", WITHIN.as_secs())),
    }
}

/// Sends to a daemon that is alone the acknowledged observations that it lacks.
///
/// # Errors
/// The daemon does not take them.
pub async fn follow_alone(alone: &Client, map: &str, feed: &Feed, marks: &[Mark]) -> Result<(), String> {
    if alone.map(map).await.is_err() {
        let created = alone.create_map(NewMap { name: map.to_owned(), ..NewMap::default() }).await;
        created.map_err(|error| format!("the daemon that is alone: {error}"))?;
    }
    for (producer, mark) in marks.iter().enumerate() {
        let sending = async {
            let options = ProducerOptions::new(&producer_name(producer), "", map);
            let mut stream = Producer::open(alone, options).await?;
            for sequence in stream.last_sequence() + 1..=mark.acknowledged {
                let o = observation(feed, producer, sequence);
                stream.send(&lane_state(producer, o.state), o.time_nanos, o.value).await?;
            }
            stream.close().await
        };
        sending.await.map_err(|error| format!("the daemon that is alone: {error}"))?;
    }
    Ok(())
}

async fn model(client: &Client, map: &str, state: &str) -> Result<Option<ModelDescription>, Error> {
    match client.describe_model(map, state).await {
        Ok(model) => Ok(Some(model)),
        Err(Error::Server(ServerError { code: Code::NotFound, .. })) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Compares the models of all states on a daemon with those of one that is alone, number for number.
///
/// # Errors
/// One of them does not answer.
pub async fn compare(
    client: &Client,
    alone: &Client,
    map: &str,
    (producers, states): (usize, u32),
) -> Result<Vec<String>, Error> {
    let mut wrong = Vec::new();
    for (producer, state) in (0..producers).flat_map(|producer| (0..states).map(move |state| (producer, state))) {
        let name = lane_state(producer, state);
        let (own, other) = (model(client, map, &name).await?, model(alone, map, &name).await?);
        if own != other {
            wrong.push(format!("{name}: the model is {own:?}, and {other:?} on the daemon that is alone"));
        }
    }
    Ok(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_missing_doubled_or_foreign_are_counted() {
        let wanted = [(1, 0.0), (2, 1.0), (3, 1.0)];
        assert_eq!(difference("door", &wanted, &wanted), None);
        let lost = difference("door", &wanted, &wanted[1..]).unwrap_or_default();
        assert!(lost.contains("1 rows are missing (the first Some((1, 0.0)))"), "{lost}");
        let doubled = difference("door", &wanted, &[wanted[0], wanted[1], wanted[1], wanted[2]]).unwrap_or_default();
        assert!(doubled.contains("1 are there twice"), "{doubled}");
        let foreign = difference("door", &wanted, &[wanted[0], wanted[1], wanted[2], (9, 0.5)]).unwrap_or_default();
        assert!(foreign.contains("1 were never sent (the first Some((9, 0.5)))"), "{foreign}");
    }

    #[test]
    fn the_time_after_all_is_after_all() {
        let feed = Feed::new(7);
        let marks = [Mark { acknowledged: 900, sent: 1000 }, Mark { acknowledged: 3, sent: 5 }];
        let after = time_after(&feed, &marks);
        for (producer, mark) in marks.iter().enumerate() {
            assert!((1..=mark.sent).all(|n| observation(&feed, producer, n).time_nanos < after));
        }
    }
}

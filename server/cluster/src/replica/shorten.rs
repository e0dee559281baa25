//! Shortens a shared log: the writer removes from the stream the messages that the checkpoints of other daemons cover.
//!
//! Invariant: a message is removed only if all its records are covered. The rest begins with the first part of a group
//! that follows the groups before it. So a daemon that reads the stream from its first message never takes a void
//! message for the beginning.

use super::compare::Scan;
use crate::{
    engine::{Engine, EngineError, Message},
    message::GroupPart,
};

/// Number of messages before the cut that are read to find a group that is not void. They stay if none is found.
const WINDOW: u64 = if cfg!(test) { 8 } else { 256 };
/// Number of messages whose lengths are read to estimate those of all.
const SAMPLES: u64 = 16;

/// The part of a stream that may be removed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shortening {
    /// Number of the map in the cluster.
    pub map: u64,
    /// The stream of the map.
    pub stream: String,
    /// The last record that checkpoints cover.
    pub covered: u64,
    /// Bytes that the stream keeps, approximately.
    pub keep_bytes: u64,
}

/// Removes messages from the beginning of a stream; returns how many. It removes less than allowed where it is not
/// certain, so it can be called again until it returns 0.
///
/// # Errors
/// [`EngineError`].
pub async fn shorten<E: Engine>(engine: &E, shortening: &Shortening) -> Result<u64, EngineError> {
    let Shortening { map, stream, covered, keep_bytes } = shortening;
    let ends = engine.ends(stream).await?;
    let bytes = engine.health(stream).await?.bytes;
    let excess = bytes.saturating_sub(*keep_bytes);
    if excess == 0 || ends.first > ends.last {
        return Ok(0);
    }
    let reader = StreamReader { engine, stream, map: *map };
    let covered = reader.first_behind(*covered, (ends.first, ends.last)).await?;
    let average = bytes / (ends.last - ends.first + 1);
    let by_size = ends.first.saturating_add(excess / reader.length(ends.first, covered).await?.max(average).max(1));
    let cut = reader.group_before(covered.min(by_size), ends.first).await?;
    if cut <= ends.first {
        return Ok(0);
    }
    engine.purge_before(stream, cut).await?;
    Ok(cut - ends.first)
}

struct StreamReader<'a, E: Engine> {
    engine: &'a E,
    stream: &'a str,
    map: u64,
}

impl<E: Engine> StreamReader<'_, E> {
    fn part(&self, message: &Message) -> Result<Option<GroupPart>, EngineError> {
        let invalid = |reason| EngineError::Refused(format!("message {} is not valid: {reason}", message.sequence));
        Ok(GroupPart::decode(&message.content).map_err(invalid)?.filter(|part| part.map == self.map))
    }

    async fn part_up_to(&self, sequence: u64, first: u64) -> Result<Option<GroupPart>, EngineError> {
        for sequence in (first..=sequence).rev() {
            if let Some(message) = self.engine.read(self.stream, sequence).await?
                && let Some(part) = self.part(&message)?
            {
                return Ok(Some(part));
            }
        }
        Ok(None)
    }

    /// The first message with a record behind a position; the number after `last` where there is none.
    async fn first_behind(&self, position: u64, (first, last): (u64, u64)) -> Result<u64, EngineError> {
        let (mut low, mut high) = (first, last + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            let part = self.part_up_to(middle, low).await?;
            if part.is_some_and(|part| part.after.position > position) { high = middle } else { low = middle + 1 }
        }
        Ok(low)
    }

    /// The greatest length of some messages before `end`.
    async fn length(&self, first: u64, end: u64) -> Result<u64, EngineError> {
        let mut greatest = 0;
        for sample in 0..SAMPLES.min(end.saturating_sub(first)) {
            let sequence = first + (end - first) * sample / SAMPLES;
            let message = self.engine.read(self.stream, sequence).await?;
            greatest = greatest.max(message.map_or(0, |message| message.content.len() as u64));
        }
        Ok(greatest)
    }

    /// The first message of a group before `end` that is not void; `first` where none is certain.
    async fn group_before(&self, end: u64, first: u64) -> Result<u64, EngineError> {
        let (mut scan, mut groups) = (Scan::default(), 0);
        let mut next = end.saturating_sub(WINDOW).max(first);
        while next < end {
            let Some(message) = self.engine.read(self.stream, next).await? else { return Ok(first) };
            let part = self.part(&message)?;
            groups += usize::from(part.as_ref().is_some_and(|part| part.part == 0));
            scan.take(next, part);
            next += 1;
        }
        // The window may have begun with a void message: the messages that follow it would not be accepted.
        let is_sure = scan.marks.len() > 1 && scan.marks.len() * 2 > groups;
        Ok(scan.marks.last().filter(|_| is_sure).map_or(first, |mark| mark.first))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bytes::Bytes;
    use tidemap_store::{LogPoint, RecordGroup};

    use super::*;
    use crate::{
        message::encode,
        simulated::{EngineFaults, SimulatedEngine, Simulation},
    };

    const PATIENCE: Duration = Duration::from_millis(500);

    fn point(position: u64) -> LogPoint {
        LogPoint { position, chain: position as u32 * 7 }
    }

    /// A stream of 100 groups of two records, each one message of about 100 bytes.
    async fn stream() -> SimulatedEngine {
        let engine = Simulation::new(1, EngineFaults::none()).client("a");
        engine.create_stream("tm", 3).await.expect("made");
        for group in 0..100 {
            let group = RecordGroup { before: point(group * 2), after: point(group * 2 + 2), frames: vec![1; 40] };
            let sequence = group.before.position / 2;
            append(&engine, sequence, encode(&group, 5, 1).remove(0)).await;
        }
        engine
    }

    async fn append(engine: &SimulatedEngine, expected: u64, message: Bytes) {
        engine.append_if("tm", expected, message, PATIENCE).await.expect("appended");
    }

    async fn first(engine: &SimulatedEngine) -> u64 {
        engine.ends("tm").await.expect("there").first
    }

    fn shortening(covered: u64, keep_bytes: u64) -> Shortening {
        Shortening { map: 5, stream: "tm".to_owned(), covered, keep_bytes }
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_covered_goes_and_a_whole_group_comes_first() {
        let engine = stream().await;
        assert_eq!(shorten(&engine, &shortening(3, 0)).await, Ok(0), "too little to be sure");
        for covered in [121, 161] {
            while shorten(&engine, &shortening(covered, 0)).await.expect("answered") > 0 {}
            let first = first(&engine).await;
            let message = engine.read("tm", first).await.expect("answered").expect("there");
            let part = GroupPart::decode(&message.content).expect("valid").expect("of tidemap");
            assert!(part.part == 0 && part.before.position < covered, "{first}");
            assert!(part.before.position + 8 > covered, "nearly all that is covered is gone: {first}");
        }
        assert_eq!(shorten(&engine, &shortening(50, 0)).await, Ok(0), "that is gone already");
        assert_eq!(engine.ends("tm").await.expect("there").last, 100);
    }

    #[tokio::test(start_paused = true)]
    async fn some_bytes_stay_whatever_is_covered() {
        let engine = stream().await;
        assert_eq!(shorten(&engine, &shortening(200, 1 << 20)).await, Ok(0));
        while shorten(&engine, &shortening(200, 5000)).await.expect("answered") > 0 {}
        let kept = engine.health("tm").await.expect("there").bytes;
        assert!((5000..6500).contains(&kept), "{kept}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_void_message_does_not_become_the_first() {
        let engine = stream().await;
        let group = |before, after| RecordGroup { before: point(before), after: point(after), frames: vec![1; 40] };
        // An old writer has appended behind a number that was used again; then the log has gone on.
        append(&engine, 100, encode(&group(150, 152), 5, 1).remove(0)).await;
        append(&engine, 101, encode(&group(200, 202), 5, 2).remove(0)).await;
        append(&engine, 102, Bytes::from_static(b"hello")).await;
        append(&engine, 103, encode(&group(202, 204), 5, 2).remove(0)).await;
        while shorten(&engine, &shortening(204, 0)).await.expect("answered") > 0 {}
        let first = first(&engine).await;
        assert!(first != 101 && first != 103, "{first}");
        assert!(first > 90, "{first}");
    }
}

//! Metrics of silent producers: robots that sent data lately and do not send now.
//!
//! Invariant: the number of series is at most the setting; the producers that are silent for longest are kept. A map
//! whose writer does not reply in time delays the metrics by no more than [`ANSWER_WITHIN`]: its previous values are
//! reported again.

use std::{collections::BTreeMap, fmt::Write as _, time::Duration};

use tidemap_base::telemetry::descriptions::{PRODUCER_SILENT, meaning};
use tidemap_ingest::{
    catalog::Catalog,
    handle::OpenProgress,
    protocol::{Command, KnownProducer},
};
use tidemap_store::MapId;
use tokio::{sync::Mutex, sync::oneshot, time::Instant};

/// A producer that has sent nothing for longer has left, and is not reported.
const CONTACT_WITHIN_NANOS: i64 = 7 * 86_400 * 1_000_000_000;
/// Time limit for the writers of all maps together to reply.
const ANSWER_WITHIN: Duration = Duration::from_secs(1);

/// The data about a map's producers.
#[derive(Debug, Default)]
struct OfMap {
    /// The last time at which each producer sent data, over all its labels, in nanoseconds since 1970.
    last_contacts: BTreeMap<String, i64>,
    /// The reply to the last request, if it has not come yet.
    pending: Option<oneshot::Receiver<Vec<KnownProducer>>>,
}

/// Finds silent producers.
#[derive(Debug)]
pub(crate) struct SilentProducers {
    max: usize,
    // The maps have a lock, because two requests may read the metrics at once; the second waits for the replies to the
    // first.
    maps: Mutex<BTreeMap<MapId, OfMap>>,
}

/// A value of a label, as Prometheus reads it.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

/// The series of the producers that are silent for longest: map, producer, and its last time.
fn series(mut contacts: Vec<(String, String, i64)>, now_nanos: i64, max: usize) -> String {
    contacts.retain(|(_, _, at)| *at >= now_nanos.saturating_sub(CONTACT_WITHIN_NANOS));
    contacts.sort_by(|a, b| (a.2, &a.0, &a.1).cmp(&(b.2, &b.0, &b.1)));
    contacts.truncate(max);
    if contacts.is_empty() {
        return String::new();
    }
    let mut text = format!("# HELP {PRODUCER_SILENT} {}\n# TYPE {PRODUCER_SILENT} gauge\n", meaning(PRODUCER_SILENT));
    for (map, producer, at) in contacts {
        let secs = now_nanos.saturating_sub(at).max(0) as f64 / 1e9;
        let (map, producer) = (escaped(&map), escaped(&producer));
        // Writing to a text cannot fail.
        let _ = writeln!(text, "{PRODUCER_SILENT}{{map=\"{map}\",producer=\"{producer}\"}} {secs}");
    }
    text + "\n"
}

impl SilentProducers {
    /// Reports at most `max` producers; with 0, none.
    pub(crate) fn new(max: usize) -> Self {
        Self { max, maps: Mutex::default() }
    }

    /// The metrics, in the text form of Prometheus.
    pub(crate) async fn metrics(&self, catalog: &Catalog) -> String {
        if self.max == 0 {
            return String::new();
        }
        let mut maps = self.maps.lock().await;
        let open = catalog.all();
        maps.retain(|id, _| open.values().any(|handle| handle.id == *id));
        for handle in open.values().filter(|handle| matches!(handle.opening(), OpenProgress::Open)) {
            let of_map = maps.entry(handle.id).or_default();
            if of_map.pending.is_none() {
                let (reply, answer) = oneshot::channel();
                of_map.pending = handle.send(Command::ListProducers(reply)).then_some(answer);
            }
        }
        let deadline = Instant::now() + ANSWER_WITHIN;
        for of_map in maps.values_mut() {
            let Some(answer) = &mut of_map.pending else { continue };
            let Ok(answer) = tokio::time::timeout_at(deadline, answer).await else { continue };
            of_map.pending = None;
            let Ok(known) = answer else { continue };
            of_map.last_contacts.clear();
            for mark in known.into_iter().map(|known| known.mark).filter(|mark| !mark.is_forgotten) {
                let at = mark.received_nanos;
                let last = of_map.last_contacts.entry(mark.key.producer().to_owned()).or_insert(at);
                *last = at.max(*last);
            }
        }
        let mut contacts = Vec::new();
        for handle in open.values() {
            let of_map = maps.get(&handle.id).into_iter().flat_map(|of_map| &of_map.last_contacts);
            contacts.extend(of_map.map(|(producer, at)| (handle.spec.name.as_str().to_owned(), producer.clone(), *at)));
        }
        series(contacts, catalog.context().clock.now_nanos(), self.max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: i64 = 3600 * 1_000_000_000;

    #[test]
    fn the_most_silent_of_the_recent_producers_are_listed() {
        let now = 1_000 * HOUR;
        let contact = |producer: &str, hours: i64| ("lab".to_owned(), producer.to_owned(), now - hours * HOUR);
        let all = vec![contact("left", 169), contact("robot-1", 0), contact("robot-2", 30), contact("a\"\\b", 2)];
        let text = series(all.clone(), now, 2);
        let lines: Vec<&str> = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).collect();
        assert_eq!(
            lines,
            [
                "tidemap_producer_silent_seconds{map=\"lab\",producer=\"robot-2\"} 108000",
                "tidemap_producer_silent_seconds{map=\"lab\",producer=\"a\\\"\\\\b\"} 7200",
            ]
        );
        assert!(series(all, now, 10).contains("robot-1\"} 0\n"));
        assert_eq!(series(vec![contact("left", 200)], now, 10), "");
    }
}

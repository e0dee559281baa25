//! The members of a cluster, as one daemon sees them: it reports itself, and looks at the reports of others.
//!
//! Invariant: whether a member is alive is judged by this daemon's own clock and by changes of the report, never by
//! times that others write.

use std::{collections::BTreeMap, time::Duration};

use tokio::{
    sync::watch,
    time::{Instant, sleep},
};

use crate::{
    assignment::Candidate,
    engine::{Bucket, Engine, EngineError},
    member::MemberReport,
};

/// How often a member reports itself.
pub const REPORT_EVERY: Duration = Duration::from_millis(750);
/// A member whose report has not changed for so long counts as gone.
pub const GONE_AFTER: Duration = Duration::from_secs(5);

/// A member, as this daemon sees it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Member {
    /// What it says of itself.
    pub report: MemberReport,
    /// Whether its report has changed lately, or is new to this daemon.
    pub is_alive: bool,
    /// Time since its report changed, or since this daemon saw it first.
    pub unchanged_for: Duration,
}

/// All members by name.
pub type Members = BTreeMap<String, Member>;

/// Those that may hold maps.
#[must_use]
pub fn candidates(members: &Members) -> Vec<Candidate> {
    let usable = |(_, member): &(&String, &Member)| member.is_alive && !member.report.draining;
    let candidate =
        |(name, member): (&String, &Member)| Candidate { name: name.clone(), capacity: member.report.capacity };
    members.iter().filter(usable).map(candidate).collect()
}

/// Judges which members are alive.
#[derive(Debug, Default)]
struct Judgement {
    seen: BTreeMap<String, (u64, u64, Instant)>,
}

impl Judgement {
    fn judge(&mut self, reports: Vec<(String, MemberReport)>, now: Instant) -> Members {
        let judged = reports.into_iter().map(|(name, report)| {
            let sign = (report.boot, report.counter);
            let seen = self.seen.entry(name.clone()).or_insert((sign.0, sign.1, now));
            if (seen.0, seen.1) != sign {
                *seen = (sign.0, sign.1, now);
            }
            let unchanged_for = now.saturating_duration_since(seen.2);
            (name, Member { report, is_alive: unchanged_for < GONE_AFTER, unchanged_for })
        });
        judged.collect()
    }
}

/// Reports this daemon and looks at the others, for ever. `report` is asked for each report; `sender` gets the members,
/// or why they could not be read.
pub async fn run<E: Engine>(
    engine: E,
    name: String,
    mut report: impl FnMut(u64) -> MemberReport + Send,
    sender: watch::Sender<Result<Members, EngineError>>,
) {
    let mut judgement = Judgement::default();
    for counter in 0.. {
        let reported = engine.set(Bucket::Members, &name, report(counter).encode()).await;
        let members = match reported {
            Ok(_) => engine.list(Bucket::Members).await,
            Err(error) => Err(error),
        };
        let members = members.map(|entries| {
            let read =
                |(name, entry): (String, crate::engine::KeyEntry)| Some((name, MemberReport::decode(&entry.value)?));
            judgement.judge(entries.into_iter().filter_map(read).collect(), Instant::now())
        });
        // The one before is of no use.
        drop(sender.send_replace(members));
        sleep(REPORT_EVERY).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_member_that_reports_nothing_new_is_gone() {
        let mut judgement = Judgement::default();
        let report = |counter| MemberReport { counter, capacity: 1, ..MemberReport::default() };
        let start = Instant::now();
        let both = |a, b| vec![("a".to_owned(), report(a)), ("b".to_owned(), report(b))];
        assert_eq!(candidates(&judgement.judge(both(1, 1), start)).len(), 2);
        let later = judgement.judge(both(2, 1), start + GONE_AFTER);
        assert!(later["a"].is_alive && !later["b"].is_alive);
        assert_eq!(["a", "b"].map(|name| later[name].unchanged_for), [Duration::ZERO, GONE_AFTER]);
        // A restart begins to count anew.
        let boot = MemberReport { boot: 9, ..report(1) };
        let back = judgement.judge(vec![("b".to_owned(), boot)], start + GONE_AFTER);
        assert!(back["b"].is_alive);
    }
}

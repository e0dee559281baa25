//! The members of a cluster, as one daemon sees them. The daemon publishes its own report and reads the reports of the
//! others.
//!
//! Invariant: a daemon judges by its own clock and by changes of the report whether a member is alive, never by times
//! that others write.

use std::{collections::BTreeMap, time::Duration};

use tokio::{
    sync::watch,
    time::{Instant, sleep},
};

use crate::{
    assignment::Candidate,
    engine::{Bucket, Engine, EngineError, KeyEntry},
    member::MemberReport,
};

/// Interval at which a member publishes its report.
pub const REPORT_EVERY: Duration = Duration::from_millis(750);
/// A member whose report has not changed for this time counts as gone.
pub const GONE_AFTER: Duration = Duration::from_secs(5);
/// If a daemon sees foreign reports under its name before it has published this number of reports, it is the newer of
/// the two daemons.
const FIRST_REPORTS: u64 = 8;
/// Number of foreign reports that are needed: a single one may come from this daemon itself, sent before its restart.
const FOREIGN_REPORTS: u32 = 2;

/// A member, as this daemon sees it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Member {
    /// The report of the member.
    pub report: MemberReport,
    /// Whether the member's report has changed lately, or is new to this daemon.
    pub is_alive: bool,
    /// Time since the member's report changed, or since this daemon saw it first.
    pub unchanged_for: Duration,
}

/// All members by name.
pub type Members = BTreeMap<String, Member>;

/// The members as this daemon sees them.
#[derive(Clone, Debug)]
pub struct MembersView {
    /// The members as they were read last.
    pub members: Members,
    /// The reason why the members cannot be read now.
    pub trouble: Option<EngineError>,
}

impl Default for MembersView {
    /// The view before the first read.
    fn default() -> MembersView {
        let trouble = EngineError::Unavailable("the members have not been read yet".to_owned());
        MembersView { members: Members::new(), trouble: Some(trouble) }
    }
}

/// Another daemon reports itself under the name of this one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("another running daemon is member {0:?} of the cluster: give each daemon a name of its own (cluster.member)")]
pub struct NameTaken(pub String);

/// The members that may hold maps.
#[must_use]
pub fn candidates(members: &Members) -> Vec<Candidate> {
    let usable = |(_, member): &(&String, &Member)| member.is_alive && !member.report.draining;
    let candidate =
        |(name, member): (&String, &Member)| Candidate { name: name.clone(), capacity: member.report.capacity };
    members.iter().filter(usable).map(candidate).collect()
}

/// The last record of a map that the checkpoints of two members cover, or of one member where only one holds a map
/// (`replicas` is 1); 0: none. A member that is gone covers nothing, and may come back without its disk.
#[must_use]
pub fn covered(members: &Members, uid: u64, replicas: usize) -> u64 {
    let alive = members.values().filter(|member| member.is_alive);
    let mut covers: Vec<u64> = alive.filter_map(|member| member.report.covers.get(&uid).copied()).collect();
    covers.sort_unstable_by(|a, b| b.cmp(a));
    let needed = replicas.min(2);
    needed.checked_sub(1).and_then(|at| covers.get(at)).copied().unwrap_or(0)
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

/// The report of a member that the engine has; `None`: there is no report, or it cannot be read.
///
/// # Errors
/// [`EngineError`].
pub async fn last_report<E: Engine>(engine: &E, name: &str) -> Result<Option<MemberReport>, EngineError> {
    let entry = engine.get(Bucket::Members, name).await?;
    Ok(entry.and_then(|entry| MemberReport::decode(&entry.value)))
}

/// The result of an exchange of reports.
struct Exchange {
    /// The reports of all members before the new report.
    reports: Vec<(String, MemberReport)>,
    /// Whether another daemon has reported itself under the name since the last report.
    has_foreign: bool,
    /// Revision of the new report.
    revision: u64,
}

/// Returns the reports of all members as they were, and publishes the report of this daemon, whose last report has the
/// revision `last`.
async fn exchange<E: Engine>(
    engine: &E,
    name: &str,
    report: &MemberReport,
    last: Option<u64>,
) -> Result<Exchange, EngineError> {
    let entries = engine.list(Bucket::Members).await?;
    let revision = engine.set(Bucket::Members, name, report.encode()).await?;
    // A server that lags, or whose disk was set back, returns a report that this daemon published before its start.
    // Such a report has an older revision.
    let is_newer = |revision: u64| last.is_some_and(|last| revision > last);
    let read = |(name, entry): (String, KeyEntry)| Some((name, entry.revision, MemberReport::decode(&entry.value)?));
    let read: Vec<(String, u64, MemberReport)> = entries.into_iter().filter_map(read).collect();
    let is_foreign = |(member, revision, found): &(String, u64, MemberReport)| {
        member == name && found.boot != report.boot && is_newer(*revision)
    };
    let has_foreign = read.iter().any(is_foreign);
    let reports = read.into_iter().map(|(name, _, report)| (name, report)).collect();
    Ok(Exchange { reports, has_foreign, revision })
}

/// Publishes the reports of this daemon and reads those of the others. `report` makes each report; `sender` receives
/// the view of the members. Returns only where this daemon has started under the name of another one that runs.
pub async fn run<E: Engine>(
    engine: E,
    name: String,
    mut report: impl FnMut(u64) -> MemberReport + Send,
    sender: watch::Sender<MembersView>,
) -> NameTaken {
    let mut judgement = Judgement::default();
    let (mut foreign, mut last) = (0, None);
    for counter in 0.. {
        let own = report(counter);
        match exchange(&engine, &name, &own, last).await {
            Ok(Exchange { mut reports, has_foreign, revision }) => {
                if has_foreign {
                    foreign += 1;
                    tracing::error!(member = name, "another daemon is a member of this name");
                }
                last = Some(revision);
                reports.retain(|(member, _)| *member != name);
                reports.push((name.clone(), own));
                let members = judgement.judge(reports, Instant::now());
                sender.send_replace(MembersView { members, trouble: None });
            }
            Err(error) => {
                // While nothing can be read, this daemon cannot see whether the other members report anything new.
                judgement = Judgement::default();
                sender.send_modify(|view| view.trouble = Some(error));
            }
        }
        if foreign >= FOREIGN_REPORTS && counter < FIRST_REPORTS {
            break;
        }
        sleep(REPORT_EVERY).await;
    }
    NameTaken(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::{EngineFaults, Simulation};

    #[test]
    fn what_two_members_cover_that_are_alive_is_covered() {
        let member = |name: &str, cover: u64, is_alive| {
            let map = |position| BTreeMap::from([(7, position)]);
            let report = MemberReport { logs: map(100), covers: map(cover), ..MemberReport::default() };
            (name.to_owned(), Member { report, is_alive, ..Member::default() })
        };
        let both = |members: &[(String, Member)]| covered(&members.iter().cloned().collect(), 7, 3);
        let (a, b, c) = (member("a", 90, true), member("b", 50, true), member("c", 70, true));
        assert_eq!(both(&[]), 0);
        assert_eq!(both(std::slice::from_ref(&a)), 0, "nobody else holds it yet");
        assert_eq!(covered(&[a.clone()].into(), 7, 1), 90, "nobody else is to hold it");
        assert_eq!(both(&[a.clone(), b.clone(), c.clone()]), 70);
        let (gone, new) = (member("c", 70, false), member("d", 0, true));
        assert_eq!(both(&[a.clone(), b, gone.clone()]), 50);
        assert_eq!(both(&[a.clone(), gone]), 0, "only one that is alive covers anything");
        assert_eq!(both(&[a, new]), 0);
    }

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
        // A restart begins the count anew.
        let boot = MemberReport { boot: 9, ..report(1) };
        let back = judgement.judge(vec![("b".to_owned(), boot)], start + GONE_AFTER);
        assert!(back["b"].is_alive);
    }

    #[tokio::test(start_paused = true)]
    async fn a_daemon_that_starts_under_the_name_of_another_one_is_the_one_that_ends() {
        let simulation = Simulation::new(1, EngineFaults::none());
        simulation.client("a").create_buckets(3).await.expect("made");
        let start = |boot| {
            let (engine, view) = (simulation.client(&format!("{boot}")), watch::Sender::default());
            let report = move |counter| MemberReport { boot, counter, ..MemberReport::default() };
            tokio::spawn(run(engine, "north".to_owned(), report, view))
        };
        let first = start(1);
        sleep(REPORT_EVERY * 20).await;
        let second = start(2);
        sleep(REPORT_EVERY * 20).await;
        assert_eq!(second.await.expect("ended"), NameTaken("north".to_owned()));
        assert!(!first.is_finished());
        // The first one ends, and another one starts in its place.
        first.abort();
        let third = start(3);
        sleep(REPORT_EVERY * 20).await;
        assert!(!third.is_finished());
    }

    #[tokio::test(start_paused = true)]
    async fn what_a_member_has_reported_before_its_start_is_not_another_daemon() {
        let simulation = Simulation::new(1, EngineFaults::none());
        let engine = simulation.client("a");
        engine.create_buckets(3).await.expect("made");
        let report = |boot| MemberReport { boot, ..MemberReport::default() };
        let before = engine.set(Bucket::Members, "north", report(1).encode()).await.expect("set");
        for last in [None, Some(before), Some(before + 9)] {
            let found = exchange(&engine, "north", &report(1), last).await.expect("exchanged");
            assert!(!found.has_foreign && found.revision > before);
        }
        let found = exchange(&engine, "north", &report(2), Some(before + 9)).await.expect("exchanged");
        assert!(!found.has_foreign, "it is older");
        let found = exchange(&engine, "north", &report(1), Some(before)).await.expect("exchanged");
        assert!(found.has_foreign, "another one has reported since");
    }

    #[tokio::test(start_paused = true)]
    async fn members_are_known_while_the_engine_is_away_and_alive_when_it_is_back() {
        let simulation = Simulation::new(1, EngineFaults::none());
        let engine = simulation.client("a");
        engine.create_buckets(3).await.expect("made");
        engine.set(Bucket::Members, "south", MemberReport::default().encode()).await.expect("set");
        let view = watch::Sender::<MembersView>::default();
        let mut seen = view.subscribe();
        assert!(seen.borrow().trouble.is_some(), "nothing has been read");
        tokio::spawn(run(engine, "north".to_owned(), |counter| MemberReport { counter, ..Default::default() }, view));
        sleep(REPORT_EVERY * 2).await;
        simulation.cut_off("a");
        sleep(GONE_AFTER * 2).await;
        let away = seen.borrow_and_update().clone();
        assert!(away.trouble.is_some() && away.members["south"].is_alive, "{away:?}");
        simulation.join("a");
        sleep(REPORT_EVERY * 4).await;
        let back = seen.borrow_and_update().clone();
        assert!(back.trouble.is_none() && back.members["south"].is_alive, "{back:?}");
    }
}

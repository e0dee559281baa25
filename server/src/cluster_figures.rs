//! The metrics of the cluster in `/metrics`, from the current data of this daemon.
//!
//! Invariant: no request goes to the engine or to another daemon, and the metrics contain no name of a map or a member.
//! A daemon alone has the same metrics, with the values of a cluster without members, so that alerts find every series.

use std::time::Duration;

use tidemap_cluster::{
    membership::MembersView,
    replica::{ReplicaRole, ReplicaStatus},
};
use tidemap_ingest::{catalog::Catalog, cluster::Cluster};
use tokio::time::Instant;

/// A value of a metric, with a label or without.
pub(crate) type Figure = (&'static str, Option<(&'static str, &'static str)>, f64);

/// The data of this daemon about the maps of its cluster.
#[derive(Debug, Default)]
struct MapFigures {
    /// Number of the maps that this daemon does not hold.
    others: usize,
    /// The states of the replicas of this daemon.
    held: Vec<ReplicaStatus>,
}

/// The figures of the maps that this daemon holds.
fn of_maps(MapFigures { others, held }: &MapFigures, now: Instant) -> [Figure; 6] {
    let lag = held.iter().map(|status| status.shared_position.saturating_sub(status.position)).max();
    let age =
        |status: &ReplicaStatus| status.last_contact.map_or(Duration::MAX, |time| now.saturating_duration_since(time));
    let age = match held.iter().map(age).max() {
        None => 0.0,
        Some(Duration::MAX) => f64::INFINITY,
        Some(age) => age.as_secs_f64(),
    };
    let written = held.iter().filter(|status| status.role == ReplicaRole::Writing).count();
    [
        ("tidemap_cluster_maps", None, (others + held.len()) as f64),
        ("tidemap_cluster_maps_written", None, written as f64),
        ("tidemap_cluster_maps_followed", None, (held.len() - written) as f64),
        ("tidemap_cluster_replicas_in_trouble", None, held.iter().filter(|one| one.trouble.is_some()).count() as f64),
        ("tidemap_cluster_lag_records", None, lag.unwrap_or_default() as f64),
        ("tidemap_cluster_heard_age_seconds", None, age),
    ]
}

/// The figures of members.
fn of_members(view: &MembersView) -> [Figure; 3] {
    let alive = view.members.values().filter(|member| member.is_alive).count();
    let state = |state, count: usize| ("tidemap_cluster_members", Some(("state", state)), count as f64);
    let trouble = f64::from(u8::from(view.trouble.is_some()));
    [
        state("alive", alive),
        state("gone", view.members.len() - alive),
        ("tidemap_cluster_engine_unavailable", None, trouble),
    ]
}

/// The forks that are set aside on this daemon's disk.
fn of_forks(catalog: &Catalog) -> [Figure; 2] {
    let (mut of_one, mut of_more) = (0_u32, 0_u32);
    for handle in catalog.all().values().filter(|handle| handle.shared_uid.is_some()) {
        // `tidemap cluster status` reports the folder of forks that cannot be read.
        for fork in catalog.context().store.forks(handle.id).unwrap_or_default() {
            if fork.groups > 1 { of_more += 1 } else { of_one += 1 }
        }
    }
    let groups = |groups, count| ("tidemap_cluster_forks", Some(("groups", groups)), f64::from(count));
    [groups("1", of_one), groups("more", of_more)]
}

/// All figures. Forks are read from the disk.
pub(crate) fn figures(catalog: &Catalog) -> Vec<Figure> {
    let cluster = catalog.context().cluster.as_ref();
    let alone = MembersView { trouble: None, ..MembersView::default() };
    let known = |cluster: &Cluster| {
        let maps = MapFigures { others: cluster.known_elsewhere(), held: cluster.replica_statuses() };
        (maps, cluster.members_view())
    };
    let (maps, view) = cluster.map_or_else(|| (MapFigures::default(), alone), known);
    let of_maps = of_maps(&maps, Instant::now());
    of_maps.into_iter().chain(of_members(&view)).chain(of_forks(catalog)).collect()
}

#[cfg(test)]
mod tests {
    use tidemap_cluster::{engine::EngineError, member::MemberReport, membership::Member};

    use super::*;

    fn value(figures: &[Figure], name: &str, label: Option<&str>) -> f64 {
        let is_it = |figure: &&Figure| figure.0 == name && figure.1.map(|(_, value)| value) == label;
        figures.iter().find(is_it).expect(name).2
    }

    #[test]
    fn the_replica_that_is_furthest_behind_is_reported_and_one_without_contact_is_infinitely_old() {
        let now = Instant::now();
        let status = |role, position, last_contact| ReplicaStatus {
            role,
            position,
            shared_position: 10,
            last_contact,
            ..ReplicaStatus::default()
        };
        let old = now.checked_sub(Duration::from_secs(7));
        let mut maps = MapFigures { others: 2, held: vec![status(ReplicaRole::Writing, 10, Some(now))] };
        maps.held.push(status(ReplicaRole::Following, 4, old));
        let figures = of_maps(&maps, now);
        let of_maps_now = |name| value(&figures, name, None);
        assert_eq!(of_maps_now("tidemap_cluster_maps"), 4.0);
        assert_eq!(of_maps_now("tidemap_cluster_maps_written"), 1.0);
        assert_eq!(of_maps_now("tidemap_cluster_maps_followed"), 1.0);
        assert_eq!(of_maps_now("tidemap_cluster_lag_records"), 6.0);
        assert_eq!(of_maps_now("tidemap_cluster_heard_age_seconds"), 7.0);
        maps.held.push(ReplicaStatus { trouble: Some("no room".to_owned()), ..ReplicaStatus::default() });
        let figures = of_maps(&maps, now);
        assert_eq!(value(&figures, "tidemap_cluster_heard_age_seconds", None), f64::INFINITY);
        assert_eq!(value(&figures, "tidemap_cluster_replicas_in_trouble", None), 1.0);
    }

    #[test]
    fn members_that_are_gone_and_an_engine_that_is_silent_are_reported() {
        let member = |is_alive| Member { report: MemberReport::default(), is_alive, unchanged_for: Duration::ZERO };
        let mut view = MembersView { trouble: None, ..MembersView::default() };
        view.members.insert("east".to_owned(), member(true));
        view.members.insert("west".to_owned(), member(false));
        let figures = of_members(&view);
        assert_eq!(value(&figures, "tidemap_cluster_members", Some("alive")), 1.0);
        assert_eq!(value(&figures, "tidemap_cluster_members", Some("gone")), 1.0);
        assert_eq!(value(&figures, "tidemap_cluster_engine_unavailable", None), 0.0);
        view.trouble = Some(EngineError::Unavailable("no connection".to_owned()));
        assert_eq!(value(&of_members(&view), "tidemap_cluster_engine_unavailable", None), 1.0);
    }
}

//! Tests the jobs of updates, and the times of the running one.

use tidemap_map::live_map::PendingLimits;

use super::*;
use crate::jobs::{Jobs, Phase};

fn updates(jobs: &Arc<Jobs>) -> Updates {
    let limits = PendingLimits { observations: 1, changes: 1 };
    Updates::new(UpdateSchedule::new(name(), Arc::clone(jobs), limits, true))
}

fn name() -> MapName {
    MapName::new("office").expect("valid")
}

#[test]
fn a_job_ends_when_its_generation_is_public() {
    let jobs = Arc::new(Jobs::default());
    let (mut updates, job) = (updates(&jobs), jobs.create(name(), UpdateCause::Request, 0));
    updates.begin(&job, Some(10), 20);
    updates.end(&job, 1, 20);
    assert!(!job.has_ended());
    updates.published();
    assert_eq!(job.status().published, Some((1, 20)));
    assert!(updates.running.is_none() && !updates.has_times(0, 100));
}

#[test]
fn the_running_update_has_the_observations_before_its_cut() {
    let jobs = Arc::new(Jobs::default());
    let (mut updates, job) = (updates(&jobs), jobs.create(name(), UpdateCause::Request, 0));
    assert!(!updates.has_times(0, 100));
    updates.begin(&job, Some(10), 20);
    assert!(updates.has_times(0, 11) && updates.has_times(19, 30));
    assert!(!updates.has_times(0, 10) && !updates.has_times(20, 30));
    updates.fail(&job, "a defect".to_owned());
    assert!(matches!(job.status().phase, Phase::Failed(_, reason) if reason == "a defect"));
    assert!(updates.has_times(10, 11), "it has not published them");
}

#[test]
fn updates_wait_after_the_log_did_not_accept_one() {
    let jobs = Arc::new(Jobs::default());
    let (mut updates, now) = (updates(&jobs), Instant::now());
    assert!(updates.may_start(now));
    updates.not_started(UpdateCause::Midnight, now);
    assert!(!updates.may_start(now) && updates.may_start(now + UPDATE_RETRY));
}

//! `tidemap job`.
//!
//! Invariant: watching a job does not affect it; the job continues in the daemon if the watch ends.

use std::process::ExitCode;

use clap::Subcommand;
use tidemap_client::{
    Client,
    updates::{Job, JobState},
};

use super::Session;
use crate::progress::{Bar, status_line};
use tidemap_formats::table::Cell;

#[derive(Debug, Subcommand)]
pub(crate) enum JobCommand {
    /// Lists running and recently ended jobs, newest first
    List,
    /// Waits until a job has ended
    Watch {
        /// The job's number
        id: u64,
    },
}

const COLUMNS: [&str; 11] = [
    "id",
    "map",
    "state",
    "cause",
    "states_done",
    "states_total",
    "observations",
    "created",
    "elapsed_secs",
    "updated_until",
    "error",
];

pub(crate) async fn run(session: &Session, command: &JobCommand) -> anyhow::Result<ExitCode> {
    let jobs = match command {
        JobCommand::List => session.client.jobs().await?,
        JobCommand::Watch { id } => vec![watch(&session.client, *id).await?],
    };
    let failed = matches!(command, JobCommand::Watch { .. }) && jobs.iter().any(|job| job.state == JobState::Failed);
    jobs.iter().filter(|_| failed).for_each(|job| status_line(&format!("error: {}", failure(job))));
    session.print(&COLUMNS, jobs.into_iter().map(cells))?;
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Watches a job until it ends.
pub async fn watch(client: &Client, id: u64) -> anyhow::Result<Job> {
    let mut updates = client.watch_job(id).await?;
    let bar = Bar::count("states updated");
    let mut last = None;
    while let Some(job) = updates.next().await? {
        bar.set_of(job.states_done, job.states_total);
        let ended = job.has_ended();
        last = Some(job);
        if ended {
            break;
        }
    }
    bar.clear();
    at_end(id, last)
}

/// The last state of a job, if the job has ended; a daemon that stops ends its watches early.
fn at_end(id: u64, last: Option<Job>) -> anyhow::Result<Job> {
    last.filter(Job::has_ended)
        .ok_or_else(|| anyhow::anyhow!("the daemon ended the watch of job {id} before the job ended"))
}

/// The error of a failed job.
pub fn failure(job: &Job) -> String {
    let of_map = if job.map.is_empty() { String::new() } else { format!(" of map {:?}", job.map) };
    format!("job {}{of_map} failed: {}", job.id, job.error)
}

fn cells(job: Job) -> Vec<Cell> {
    vec![
        job.id.into(),
        Cell::Text(job.map),
        job.state.name().into(),
        job.cause.name().into(),
        job.states_done.into(),
        job.states_total.into(),
        job.observations.into(),
        Cell::time(job.created_nanos),
        Cell::Secs(job.elapsed_nanos),
        Cell::time(job.update.cut_nanos),
        Cell::Text(if job.save_error.is_empty() { job.error } else { format!("not saved yet: {}", job.save_error) }),
    ]
}

#[cfg(test)]
mod tests {
    use tidemap_client::{maps::UpdateSummary, updates::JobCause};

    use super::*;

    fn job(state: JobState) -> Job {
        Job {
            id: 7,
            map: "office".to_owned(),
            state,
            cause: JobCause::Request,
            states_done: 0,
            states_total: 1,
            observations: 0,
            created_nanos: None,
            elapsed_nanos: 0,
            error: "no room".to_owned(),
            save_error: String::new(),
            update: UpdateSummary::default(),
        }
    }

    #[test]
    fn a_failure_names_the_map_if_the_job_is_one_of_a_map() {
        assert_eq!(failure(&job(JobState::Failed)), "job 7 of map \"office\" failed: no room");
        let of_daemon = Job { map: String::new(), ..job(JobState::Failed) };
        assert_eq!(failure(&of_daemon), "job 7 failed: no room");
    }

    #[test]
    fn a_watch_that_ends_before_its_job_is_no_success() {
        for last in [None, Some(job(JobState::Waiting)), Some(job(JobState::Running))] {
            let text = at_end(7, last).map_err(|error| error.to_string());
            assert_eq!(text, Err("the daemon ended the watch of job 7 before the job ended".to_owned()));
        }
        for state in [JobState::Done, JobState::Failed] {
            assert_eq!(at_end(7, Some(job(state))).ok(), Some(job(state)));
        }
    }
}

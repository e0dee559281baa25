//! Updates and erasures, their jobs, and counters.
//!
//! Invariant: a failed job is a value, not an error: the request for it succeeded.

use tidemap_proto::{
    convert::{
        query::selector_from_wire,
        time::{instant, span, timestamp},
    },
    v1::{self, maintenance_service_client::MaintenanceServiceClient},
};
use tonic::Streaming;

use crate::{
    connection::{Client, Connection, REPLY_BYTES_MAX},
    error::Error,
    maps::UpdateSummary,
    queries::ModelSelector,
};

/// A backup that was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BackupMade {
    /// Number of maps in it.
    pub maps: u64,
    /// Number of files that were copied.
    pub copied_files: u64,
    /// Bytes of these files.
    pub copied_bytes: u64,
    /// Number of files that an earlier backup had already.
    pub kept_files: u64,
}

/// State of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobState {
    /// The job waits for another job of the same map.
    Waiting,
    /// The job is running.
    Running,
    /// The job ended successfully.
    Done,
    /// The job ended with an error.
    Failed,
    /// A state that this version does not know.
    Other,
}

impl JobState {
    /// Name, as on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Other => "other",
        }
    }
}

/// The cause of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobCause {
    /// A request.
    Request,
    /// The map's local midnight, by the daemon's clock.
    Midnight,
    /// The map's local midnight, in the time of imported data.
    DataTime,
    /// The number of pending observations exceeded the limit.
    PendingLimit,
    /// A request to erase something from the map.
    Erasure,
    /// The schedule of backups.
    Backup,
    /// A cause that this version does not know.
    Other,
}

impl JobCause {
    /// Name, as on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Midnight => "midnight",
            Self::DataTime => "data-time",
            Self::PendingLimit => "pending-limit",
            Self::Erasure => "erasure",
            Self::Backup => "backup",
            Self::Other => "other",
        }
    }
}

/// An update, an erasure or a scheduled backup, as a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Job {
    /// Id, unique while the daemon runs.
    pub id: u64,
    /// Name of the map; empty: all maps.
    pub map: String,
    /// State of the job.
    pub state: JobState,
    /// The cause of a job.
    pub cause: JobCause,
    /// Number of states processed so far.
    pub states_done: u64,
    /// Number of states that have observations to learn.
    pub states_total: u64,
    /// Number of observations learned, or erased of states that were not erased as a whole.
    pub observations: u64,
    /// The time of creation of the job.
    pub created_nanos: Option<i64>,
    /// Running time so far.
    pub elapsed_nanos: i64,
    /// Error message, if it failed.
    pub error: String,
    /// Why its generation is not saved yet, after a save has failed; the log has everything.
    pub save_error: String,
    /// The update that it published.
    pub update: UpdateSummary,
}

impl Job {
    /// Whether the job has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(self.state, JobState::Done | JobState::Failed)
    }
}

/// The data to erase: at least a state, a producer or an interval. Without a producer and an interval it is the whole
/// state.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Erasure {
    /// The state to erase; `None`: all states.
    pub state: Option<String>,
    /// The producer whose observations are erased; `None`: all producers.
    pub producer: Option<String>,
    /// With this label; `None`: with all labels.
    pub label: Option<String>,
    /// From this time on, nanoseconds UTC, at least 0.
    pub from_nanos: Option<i64>,
    /// Before this time, nanoseconds UTC.
    pub to_nanos: Option<i64>,
    /// Forgets also the sequence of the producer with the label, so that the same observations count when they are sent
    /// again. Needs both, and neither state nor interval.
    pub forget_sequence: bool,
}

/// The effect of an update on one state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateUpdate {
    /// Name of the state.
    pub state: String,
    /// Order before the update.
    pub order_before: u32,
    /// Order after the update.
    pub order: u32,
    /// Mean squared error of `order_before` on the scored observations.
    pub mean_squared_error_before: Option<f64>,
    /// Mean squared error of `order` on the same observations.
    pub mean_squared_error: Option<f64>,
    /// Number of observations learned.
    pub observations: u64,
    /// Number of scored observations.
    pub scored: u64,
    /// The model that predicts from now on.
    pub model: Option<ModelSelector>,
}

/// The HTTP port of a daemon, which serves its page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PagePort {
    /// Number of the port.
    pub port: u16,
    /// Whether the port accepts connections from the daemon's own machine alone.
    pub is_loopback: bool,
    /// Whether the port serves HTTPS.
    pub has_tls: bool,
    /// The address that it is bound to; empty: all addresses of the machine, or the loopback one.
    pub host: String,
}

/// One counter.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistic {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Unit; empty for a plain number.
    pub unit: String,
}

/// A producer that has sent observations to a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownProducer {
    /// Name of the producer.
    pub producer: String,
    /// The label of its sequence.
    pub label: String,
    /// Number of its observations that are durable or refused.
    pub durable_sequence: u64,
    /// Whether a stream of the producer is open.
    pub is_connected: bool,
    /// The time at which the daemon received the newest observation of the producer, nanoseconds UTC; `None` where a
    /// daemon does not report it.
    pub received_nanos: Option<i64>,
    /// Whether the producer has given its place up, and has sent nothing since.
    pub is_forgotten: bool,
}

/// A job that is being watched.
#[derive(Debug)]
pub struct JobWatch {
    client: Client,
    replies: Streaming<v1::WatchJobResponse>,
}

impl JobWatch {
    /// Returns the job now, then after each change; `None` after the job has ended.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn next(&mut self) -> Result<Option<Job>, Error> {
        match self.replies.message().await.map_err(|status| self.client.error(&status))? {
            Some(reply) => job_from_wire(reply.job).map(Some),
            None => Ok(None),
        }
    }
}

impl Client {
    fn maintenance_service(&self) -> MaintenanceServiceClient<Connection> {
        MaintenanceServiceClient::new(self.requests()).max_decoding_message_size(REPLY_BYTES_MAX)
    }

    /// Starts the update of a map: it learns every acknowledged observation, or those before `until_nanos`.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn run_update(&self, map: &str, until_nanos: Option<i64>) -> Result<Job, Error> {
        let request = v1::RunUpdateRequest { map: map.to_owned(), until: until_nanos.map(timestamp) };
        let response = self.maintenance_service().run_update(request).await.map_err(|status| self.error(&status))?;
        job_from_wire(response.into_inner().job)
    }

    /// One job.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the job is unknown or ended long ago.
    pub async fn job(&self, id: u64) -> Result<Job, Error> {
        let request = v1::GetJobRequest { id };
        let response = self.maintenance_service().get_job(request).await.map_err(|status| self.error(&status))?;
        job_from_wire(response.into_inner().job)
    }

    /// Running and recently ended jobs, newest first.
    ///
    /// # Errors
    /// [`Error`].
    pub async fn jobs(&self) -> Result<Vec<Job>, Error> {
        let mut jobs = Vec::new();
        let mut request = v1::ListJobsRequest { page_size: 1000, page_token: String::new() };
        loop {
            let response =
                self.maintenance_service().list_jobs(request.clone()).await.map_err(|status| self.error(&status))?;
            let page = response.into_inner();
            for job in page.jobs {
                jobs.push(job_from_wire(Some(job))?);
            }
            if page.next_page_token.is_empty() {
                return Ok(jobs);
            }
            request.page_token = page.next_page_token;
        }
    }

    /// The producers that have sent observations to a map, by name and label.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn producers(&self, map: &str) -> Result<Vec<KnownProducer>, Error> {
        let mut producers = Vec::new();
        let mut request =
            v1::ListProducersRequest { map: map.to_owned(), page_size: 10_000, page_token: String::new() };
        loop {
            let answer = self.maintenance_service().list_producers(request.clone()).await;
            let page = answer.map_err(|status| self.error(&status))?.into_inner();
            for known in page.producers {
                producers.push(KnownProducer {
                    producer: known.producer,
                    label: known.label,
                    durable_sequence: known.durable_sequence,
                    is_connected: known.is_connected,
                    received_nanos: instant(known.received_time),
                    is_forgotten: known.is_forgotten,
                });
            }
            if page.next_page_token.is_empty() {
                return Ok(producers);
            }
            request.page_token = page.next_page_token;
        }
    }

    /// Frees the places of a producer that will not come back, with one label or with all. Its observations stay, and
    /// keep their numbers. Returns the number of free places.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map has no such producer, and `FAILED_PRECONDITION` if it streams.
    pub async fn forget_producer(&self, map: &str, producer: &str, label: Option<&str>) -> Result<u64, Error> {
        let (map, producer) = (map.to_owned(), producer.to_owned());
        let request = v1::ForgetProducerRequest { map, producer, label: label.map(str::to_owned) };
        let answer = self.maintenance_service().forget_producer(request).await;
        Ok(answer.map_err(|status| self.error(&status))?.into_inner().forgotten)
    }

    /// Watches a job until it ends.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the job is unknown or ended long ago.
    pub async fn watch_job(&self, id: u64) -> Result<JobWatch, Error> {
        let request = v1::WatchJobRequest { id };
        let response = self.maintenance_service().watch_job(request).await.map_err(|status| self.error(&status))?;
        Ok(JobWatch { client: self.clone(), replies: response.into_inner() })
    }

    /// A page of the effect of an update on each state, and the token of the next page; the first page has the token
    /// "", and the last page returns `None`.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if a later update has replaced the report.
    pub async fn update_report(
        &self,
        job_id: u64,
        page_token: &str,
    ) -> Result<(Vec<StateUpdate>, Option<String>), Error> {
        let request = v1::GetUpdateReportRequest { job_id, page_size: 10_000, page_token: page_token.to_owned() };
        let answer = self.maintenance_service().get_update_report(request).await;
        let page = answer.map_err(|status| self.error(&status))?.into_inner();
        let states = page.states.into_iter().map(state_update_from_wire).collect();
        Ok((states, Some(page.next_page_token).filter(|token| !token.is_empty())))
    }

    /// Copies all maps to a folder on the daemon's machine, an absolute path; it is empty or holds an earlier backup of
    /// the same daemon, which is brought up to date.
    ///
    /// # Errors
    /// [`Error`]; the code is `FAILED_PRECONDITION` if the folder holds something else.
    pub async fn create_backup(&self, path: &str) -> Result<BackupMade, Error> {
        let request = v1::CreateBackupRequest { path: path.to_owned() };
        let answer = self.maintenance_service().create_backup(request).await;
        let v1::CreateBackupResponse { maps, copied_files, copied_bytes, kept_files } =
            answer.map_err(|status| self.error(&status))?.into_inner();
        Ok(BackupMade { maps, copied_files, copied_bytes, kept_files })
    }

    /// Starts to erase a state from a map. When the job is done, the map is as if the state had never been observed.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if there is no such map or state.
    pub async fn erase(&self, map: &str, state: &str) -> Result<Job, Error> {
        self.erase_part(map, Erasure { state: Some(state.to_owned()), ..Erasure::default() }).await
    }

    /// Starts to erase observations from a map. When the job is done, the map is as if they had never been observed.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if there is no such map, state or producer.
    pub async fn erase_part(&self, map: &str, what: Erasure) -> Result<Job, Error> {
        let request = v1::EraseRequest {
            map: map.to_owned(),
            state: what.state.unwrap_or_default(),
            producer: what.producer.unwrap_or_default(),
            label: what.label,
            from_time: what.from_nanos.map(timestamp),
            to_time: what.to_nanos.map(timestamp),
            forget_sequence: what.forget_sequence,
        };
        let answer = self.maintenance_service().erase(request).await;
        job_from_wire(answer.map_err(|status| self.error(&status))?.into_inner().job)
    }

    /// Counters of a map, or of the whole daemon if `map` is empty.
    ///
    /// # Errors
    /// [`Error`]; the code is `NOT_FOUND` if the map does not exist.
    pub async fn statistics(&self, map: &str) -> Result<Vec<Statistic>, Error> {
        let statistics = self.all_statistics(map).await?.statistics;
        let statistic = |s: v1::Statistic| Statistic { name: s.name, value: s.value, unit: s.unit };
        Ok(statistics.into_iter().map(statistic).collect())
    }

    /// The port on which the daemon serves its page, for a user who may query this map, or all maps (empty); `None`:
    /// the daemon is too old to report it.
    ///
    /// # Errors
    /// The daemon cannot be reached, or has no such map.
    pub async fn page_port(&self, map: &str) -> Result<Option<PagePort>, Error> {
        let page = self.all_statistics(map).await?.page;
        let port = |page: v1::PagePort| {
            let port = u16::try_from(page.port).map_err(|_| Error::Protocol("a port that is none"))?;
            Ok(PagePort { port, is_loopback: page.is_loopback, has_tls: page.has_tls, host: page.host })
        };
        page.map(port).transpose()
    }

    async fn all_statistics(&self, map: &str) -> Result<v1::GetStatisticsResponse, Error> {
        let request = v1::GetStatisticsRequest { map: map.to_owned() };
        let answer = self.maintenance_service().get_statistics(request).await;
        Ok(answer.map_err(|status| self.error(&status))?.into_inner())
    }
}

fn job_from_wire(job: Option<v1::Job>) -> Result<Job, Error> {
    let job = job.ok_or(Error::Protocol("no job in the answer"))?;
    let state = match job.state() {
        v1::JobState::Waiting => JobState::Waiting,
        v1::JobState::Running => JobState::Running,
        v1::JobState::Done => JobState::Done,
        v1::JobState::Failed => JobState::Failed,
        v1::JobState::Unspecified => JobState::Other,
    };
    let cause = match job.cause() {
        v1::JobCause::Request => JobCause::Request,
        v1::JobCause::Midnight => JobCause::Midnight,
        v1::JobCause::DataTime => JobCause::DataTime,
        v1::JobCause::PendingLimit => JobCause::PendingLimit,
        v1::JobCause::Erasure => JobCause::Erasure,
        v1::JobCause::Backup => JobCause::Backup,
        v1::JobCause::Unspecified => JobCause::Other,
    };
    Ok(Job {
        id: job.id,
        map: job.map,
        state,
        cause,
        states_done: job.states_done,
        states_total: job.states_total,
        observations: job.observations,
        created_nanos: instant(job.create_time),
        elapsed_nanos: span(job.elapsed).unwrap_or_default(),
        error: job.error,
        save_error: job.save_error,
        update: UpdateSummary::from_wire(job.update),
    })
}

fn state_update_from_wire(update: v1::StateUpdate) -> StateUpdate {
    StateUpdate {
        state: update.state,
        order_before: update.order_before,
        order: update.order,
        mean_squared_error_before: update.mean_squared_error_before,
        mean_squared_error: update.mean_squared_error,
        observations: update.observations,
        scored: update.scored,
        model: update.model.and_then(|model| selector_from_wire("model", Some(model)).ok()),
    }
}

//! `MaintenanceService`: updates as jobs, and counters.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use tidemap_base::{
    access::Caller,
    connections::{Peer, Remote},
    shares::{Share, Shares, client::Client},
};
use tidemap_ingest::{
    backups::{self, TargetError},
    catalog::{Catalog, CatalogError, erasure::states_of},
    jobs::{JobCause, Phase, UpdateJob},
    protocol::{Command, ForgetError, ForgetProducers, KnownProducer},
    statistics,
};
use tidemap_map::{erasure::RequestedPart, event::UpdateCause};
use tidemap_proto::{
    convert::{
        erasure::erasure_from_wire,
        map::{self, update_to_wire},
        page::page_from_wire,
        time::{duration, nanos_from_timestamp, timestamp},
        updates::{cells_update_to_wire, state_update_to_wire},
    },
    v1::{self, maintenance_service_server::MaintenanceService},
};
use tidemap_store::{BackupReport, Trouble};
use tokio::sync::{mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

use super::{RpcReply, status::RpcError};
use crate::{
    guard::current_caller,
    lookup::{find_map, find_state},
    update_worth,
};

/// Interval of the progress reports of a watched job.
const WATCH_INTERVAL: Duration = Duration::from_millis(100);

#[derive(Debug)]
pub(crate) struct Maintenance {
    pub catalog: Arc<Catalog>,
    /// The folder below which requests may make backups; empty: none is set.
    pub backup_dir: PathBuf,
    /// The address at which the daemon serves its page.
    pub page: PageAddress,
    /// The bounded resources that clients share.
    pub shares: Shares,
}

/// The address at which the daemon serves its page.
#[derive(Clone, Copy, Debug)]
pub struct PageAddress {
    /// The address of the port.
    pub address: SocketAddr,
    /// Whether the page is served over HTTPS.
    pub has_tls: bool,
}

fn job_to_wire(catalog: &Catalog, job: &UpdateJob) -> v1::Job {
    let status = job.status();
    let (state, elapsed, error) = match status.phase {
        Phase::Waiting => (v1::JobState::Waiting, Duration::ZERO, String::new()),
        Phase::Running(since) => (v1::JobState::Running, since.elapsed(), String::new()),
        Phase::Done(elapsed) => (v1::JobState::Done, elapsed, String::new()),
        Phase::Failed(elapsed, error) => (v1::JobState::Failed, elapsed, error),
    };
    let cause = match job.cause {
        JobCause::Update(UpdateCause::Request) => v1::JobCause::Request,
        JobCause::Update(UpdateCause::Midnight) => v1::JobCause::Midnight,
        JobCause::Update(UpdateCause::DataTime) => v1::JobCause::DataTime,
        JobCause::Update(UpdateCause::PendingLimit) => v1::JobCause::PendingLimit,
        JobCause::Erasure => v1::JobCause::Erasure,
        JobCause::Backup => v1::JobCause::Backup,
    };
    v1::Job {
        id: job.id,
        map: job.map_name().to_owned(),
        state: state.into(),
        cause: cause.into(),
        states_done: job.states_done.load(Ordering::Relaxed),
        states_total: status.states_total,
        observations: status.observations,
        create_time: Some(timestamp(job.created_nanos)),
        elapsed: Some(duration(i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))),
        error,
        update: status.published.map(|(generation, cut_nanos)| update_to_wire(generation, Some(cut_nanos))),
        save_error: save_error(catalog, job, status.published).unwrap_or_default(),
    }
}

/// The reason why the newest generation of a map is not saved, if the job has published that generation.
fn save_error(catalog: &Catalog, job: &UpdateJob, published: Option<(u64, i64)>) -> Option<String> {
    let (generation, _) = published?;
    let handle = catalog.get(job.map_name()).ok().filter(|handle| handle.view().generation() == generation)?;
    catalog.context().store.trouble().into_iter().find_map(|trouble| match trouble {
        Trouble::NotSaved { map, reason } if map == handle.id => Some(reason),
        _ => None,
    })
}

fn producer_to_wire(known: &KnownProducer) -> v1::ProducerInfo {
    map::producer_to_wire(&known.mark, known.is_connected)
}

fn backup_to_wire(report: BackupReport) -> v1::CreateBackupResponse {
    let BackupReport { maps, copied_files, copied_bytes, kept_files } = report;
    v1::CreateBackupResponse { maps, copied_files, copied_bytes, kept_files }
}

fn statistic_to_wire((name, value, unit): (&str, f64, &str)) -> v1::Statistic {
    v1::Statistic { name: name.to_owned(), value, unit: unit.to_owned() }
}

/// The port of the page. The host is empty if it is the one that the client knows.
fn page_to_wire(PageAddress { address, has_tls }: PageAddress) -> v1::PagePort {
    let (ip, is_loopback) = (address.ip(), address.ip().is_loopback());
    let host = if is_loopback || ip.is_unspecified() { String::new() } else { ip.to_string() };
    v1::PagePort { port: address.port().into(), is_loopback, has_tls, host }
}

/// Whether a caller may see a job: jobs of the caller's maps, and jobs of the whole daemon if the caller has all maps.
fn may_see(caller: &Caller, job: &UpdateJob) -> bool {
    job.map.as_ref().map_or_else(|| caller.covers_all(), |map| caller.covers(map.as_str()))
}

impl Maintenance {
    /// Checks that a backup may go to any folder that a caller names, because the operator has named none.
    fn check_any_folder(path: &str, peer: Option<Peer>) -> Result<(), RpcError> {
        // Without tokens, everybody who may connect from this machine may do everything anyway.
        let is_local = peer.is_some_and(Peer::is_of_this_machine);
        if !matches!(current_caller(), Caller::Anybody) || !is_local {
            return Err(RpcError::NoBackupFolder);
        }
        if !Path::new(path).is_absolute() {
            return Err(TargetError::Relative.into());
        }
        Ok(())
    }

    fn job(&self, id: u64) -> Result<Arc<UpdateJob>, RpcError> {
        let job = self.catalog.context().jobs.get(id);
        // A job of a map that the caller has no right to does not exist for the caller.
        job.filter(|job| may_see(&current_caller(), job)).ok_or(RpcError::UnknownJob(id))
    }
}

#[tonic::async_trait]
impl MaintenanceService for Maintenance {
    type WatchJobStream = ReceiverStream<Result<v1::WatchJobResponse, Status>>;

    async fn run_update(&self, request: Request<v1::RunUpdateRequest>) -> RpcReply<v1::RunUpdateResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let until_nanos = request.until.map(|until| nanos_from_timestamp("until", until)).transpose();
        let until_nanos = until_nanos.map_err(RpcError::from)?;
        if let Some(refused) = handle.role().not_writer(&handle.spec.name) {
            return Err(RpcError::from(refused).into());
        }
        let place = self.shares.take(Share::Updates, &Client::current(), 1).map_err(RpcError::from)?;
        let context = self.catalog.context();
        let job = context.jobs.create(handle.spec.name.clone(), UpdateCause::Request, context.clock.now_nanos());
        let mut status = job.watch();
        tidemap_base::task::spawn(async move {
            let _place = place;
            // An error means that the job is gone.
            let _ = status.wait_for(|status| status.phase.has_ended()).await;
        });
        let command = Command::Update { until_nanos, cause: UpdateCause::Request, job: Arc::clone(&job) };
        if !handle.send(command) {
            job.end(Err("the daemon is stopping".to_owned()));
            return Err(RpcError::Stopping.into());
        }
        Ok(Response::new(v1::RunUpdateResponse { job: Some(job_to_wire(&self.catalog, &job)) }))
    }

    async fn get_job(&self, request: Request<v1::GetJobRequest>) -> RpcReply<v1::GetJobResponse> {
        let job = self.job(request.get_ref().id)?;
        Ok(Response::new(v1::GetJobResponse { job: Some(job_to_wire(&self.catalog, &job)) }))
    }

    async fn list_jobs(&self, request: Request<v1::ListJobsRequest>) -> RpcReply<v1::ListJobsResponse> {
        let request = request.into_inner();
        let (mut jobs, caller) = (self.catalog.context().jobs.list(), current_caller());
        jobs.retain(|job| may_see(&caller, job));
        let page = page_from_wire(request.page_size, &request.page_token, 100, 1000).map_err(RpcError::from)?;
        let (range, next_page_token) = page.within(jobs.len());
        let jobs = jobs[range].iter().map(|job| job_to_wire(&self.catalog, job)).collect();
        Ok(Response::new(v1::ListJobsResponse { jobs, next_page_token }))
    }

    async fn watch_job(&self, request: Request<v1::WatchJobRequest>) -> RpcReply<Self::WatchJobStream> {
        let job = self.job(request.get_ref().id)?;
        let (replies, stream) = mpsc::channel(4);
        let catalog = Arc::clone(&self.catalog);
        tidemap_base::task::spawn(async move {
            let mut status = job.watch();
            let mut reported = None;
            loop {
                let ended = status.borrow_and_update().phase.has_ended();
                let wire = job_to_wire(&catalog, &job);
                let progress = (wire.state, wire.states_done);
                if reported.replace(progress) != Some(progress)
                    && replies.send(Ok(v1::WatchJobResponse { job: Some(wire) })).await.is_err()
                {
                    return;
                }
                if ended {
                    return;
                }
                // Either the phase changes or more states are done.
                let _ = tokio::time::timeout(WATCH_INTERVAL, status.changed()).await;
                if replies.is_closed() {
                    return;
                }
            }
        });
        Ok(Response::new(ReceiverStream::new(stream)))
    }

    async fn get_update_report(
        &self,
        request: Request<v1::GetUpdateReportRequest>,
    ) -> RpcReply<v1::GetUpdateReportResponse> {
        let request = request.into_inner();
        let job = self.job(request.job_id)?;
        let report = job.report().ok_or(RpcError::NoReport(job.id))?;
        let cells = report.cells.as_ref().filter(|cells| cells.changed_cells > 0).map(cells_update_to_wire);
        let rows = usize::from(cells.is_some()) + report.states.len();
        let page = page_from_wire(request.page_size, &request.page_token, 1000, 10_000).map_err(RpcError::from)?;
        let (range, next_page_token) = page.within(rows);
        let states = cells.into_iter().chain(report.states.iter().map(state_update_to_wire));
        let states = states.skip(range.start).take(range.len());
        Ok(Response::new(v1::GetUpdateReportResponse { states: states.collect(), next_page_token }))
    }

    async fn list_producers(&self, request: Request<v1::ListProducersRequest>) -> RpcReply<v1::ListProducersResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let (reply, known) = oneshot::channel();
        if !handle.send(Command::ListProducers(reply)) {
            return Err(RpcError::Stopping.into());
        }
        let known = known.await.map_err(|_| RpcError::Stopping)?;
        let page = page_from_wire(request.page_size, &request.page_token, 1000, 10_000).map_err(RpcError::from)?;
        let (range, next_page_token) = page.within(known.len());
        let producers = known[range].iter().map(producer_to_wire).collect();
        Ok(Response::new(v1::ListProducersResponse { producers, next_page_token }))
    }

    async fn forget_producer(
        &self,
        request: Request<v1::ForgetProducerRequest>,
    ) -> RpcReply<v1::ForgetProducerResponse> {
        let v1::ForgetProducerRequest { map, producer, label } = request.into_inner();
        let handle = find_map(&self.catalog, &map).await?;
        let (reply, answer) = oneshot::channel();
        let forget = Command::ForgetProducers(ForgetProducers { producer, label, reply });
        let answer = if handle.send(forget) { answer.await.ok() } else { None };
        let forgotten = answer.unwrap_or(Err(ForgetError::Closing)).map_err(RpcError::from)?;
        Ok(Response::new(v1::ForgetProducerResponse { forgotten }))
    }

    async fn create_backup(&self, request: Request<v1::CreateBackupRequest>) -> RpcReply<v1::CreateBackupResponse> {
        let peer = request.extensions().get::<Remote>().map(Remote::peer);
        let path = request.into_inner().path;
        let folder = Some(self.backup_dir.clone()).filter(|folder| !folder.as_os_str().is_empty());
        if folder.is_none() {
            Self::check_any_folder(&path, peer)?;
        }
        let store = Arc::clone(&self.catalog.context().store);
        let work = move || {
            let target = folder.map_or_else(|| Ok(PathBuf::from(&path)), |folder| backups::target(&folder, &path));
            Ok::<_, RpcError>(backups::make(&store, &target?)?)
        };
        let copied = tidemap_base::task::blocking(work).await.map_err(RpcError::from)?;
        Ok(Response::new(backup_to_wire(copied?)))
    }

    async fn erase(&self, request: Request<v1::EraseRequest>) -> RpcReply<v1::EraseResponse> {
        let request = request.into_inner();
        let handle = find_map(&self.catalog, &request.map).await?;
        let erasure = erasure_from_wire(&request).map_err(RpcError::from)?;
        if let Some(RequestedPart { producer: Some((producer, label)), .. }) = &erasure.part {
            self.catalog.producers_of(&handle, (producer, label.as_deref())).await.map_err(RpcError::from)?;
        }
        // The states are looked up again when the erasure begins: another erasure may have been first.
        if let Some(state) = &erasure.state
            && let Err(error) = states_of(&handle.view(), state)
        {
            return Err(match error {
                CatalogError::NoState { .. } => find_state(&handle.view(), state).err().unwrap_or(error.into()),
                error => error.into(),
            }
            .into());
        }
        let job = self.catalog.erase(&handle.spec.name, erasure, &current_caller());
        Ok(Response::new(v1::EraseResponse { job: Some(job_to_wire(&self.catalog, &job)) }))
    }

    async fn get_statistics(&self, request: Request<v1::GetStatisticsRequest>) -> RpcReply<v1::GetStatisticsResponse> {
        let name = request.into_inner().map;
        if name.is_empty() && !current_caller().covers_all() {
            return Err(RpcError::NeedsAllMaps.into());
        }
        let handle = if name.is_empty() { None } else { Some(find_map(&self.catalog, &name).await?) };
        let catalog = Arc::clone(&self.catalog);
        let worth = match &handle {
            Some(handle) => update_worth::of_map(handle).await,
            None => None,
        };
        // Sizes are read from the disk.
        let statistics = tidemap_base::task::blocking(move || match handle {
            Some(handle) => statistics::of_map(&catalog, &handle, worth),
            None => statistics::of_daemon(&catalog),
        });
        let statistics = statistics.await.map_err(|_| RpcError::Stopping)?;
        let statistics = statistics.into_iter().map(statistic_to_wire).collect();
        Ok(Response::new(v1::GetStatisticsResponse { statistics, page: Some(page_to_wire(self.page)) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_folder_of_backups_others_than_this_machine_make_none() {
        let check = |peer: &str, path| {
            Maintenance::check_any_folder(path, Some(Peer::Address(peer.parse().expect("an address"))))
        };
        for peer in ["127.0.0.1", "::1"] {
            assert!(check(peer, "/srv/backup").is_ok(), "{peer}");
            assert_eq!(check(peer, "backup").expect_err("relative").code_and_reason().1, "INVALID_FIELD");
        }
        assert!(Maintenance::check_any_folder("/srv/backup", Some(Peer::Local)).is_ok());
        let refused = check("10.0.0.7", "/srv/backup").expect_err("from elsewhere");
        assert!(
            refused.code_and_reason().1 == "BACKUP_FOLDER" && refused.message().contains("backup_dir"),
            "{refused}"
        );
        assert!(Maintenance::check_any_folder("/srv/backup", None).is_err(), "the origin is unknown");
    }
}

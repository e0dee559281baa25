//! `tidemap observe`.
//!
//! Invariant: a row's number in its file is its sequence number, so that a file can be sent any number of times, in any
//! number of pieces, and is learned once. What the daemon has is compared with the file before anything is sent.

pub mod feed;
pub mod kinds;
pub mod transfer;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::{
    maps::StateKind,
    observe::{Phase, Producer, ProducerError, ProducerOptions, Progress},
    updates::{Job, JobCause, JobState},
};
use tokio::{sync::watch, task::JoinHandle};

use self::{
    feed::{Feed, RefusalReport},
    kinds::Kinds,
    transfer::{Sendable, Transfer, TransferEnd},
};
use super::{Session, UsageError, job, producer_id, times};
use crate::progress::{Bar, status_line};
use tidemap_formats::{
    observation_file::{Layout, ObservationColumns},
    table::Cell,
};

#[derive(Debug, Args)]
pub struct ObserveArgs {
    /// Name of the map
    map: String,
    /// File with the columns time,state,value, or time,state,x,y and perhaps z of positions in metres; - is stdin
    file: PathBuf,
    /// Who observes [default: a name for this user and machine, made once and kept]
    #[arg(long, value_name = "ID")]
    producer: Option<String>,
    /// Which of the producer's files this is [default: its base name, or stdin]
    #[arg(long, value_name = "LABEL")]
    label: Option<String>,
    /// What the values of the file's states mean: probability, continuous or count; new states become that, and rows of
    /// states of another kind are refused; with columns x and y it is vector [default: what each state is; new ones are
    /// probabilities]
    #[arg(long, value_name = "KIND")]
    kind: Option<StateKind>,
    /// Runs the nightly update whenever the data passes the map's local midnight
    #[arg(long)]
    nightly: bool,
    /// How long to go on trying when the daemon cannot be reached
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = times::duration_or_none)]
    patience: i64,
}

/// A stream that ended a moment ago may hold its key until the daemon has noticed.
const KEY_PATIENCE: Duration = Duration::from_secs(3);
/// After Ctrl-C, what is under way gets this long to become durable.
pub(super) const LAST_FLUSH: Duration = Duration::from_secs(5);
/// Between two looks for nightly updates.
const NIGHT_PAUSE: Duration = Duration::from_millis(50);
pub(super) const INTERRUPTED: u8 = 130;

pub async fn run(session: &Session, args: ObserveArgs) -> anyhow::Result<ExitCode> {
    let shown = feed::shown(&args.file);
    let feed = feed::open::<ObservationColumns>(&args.file)?;
    let has_positions = feed.layout.has_positions();
    if let Some(kind) = args.kind.filter(|kind| (*kind == StateKind::Vector) != has_positions) {
        let columns = if has_positions { "positions, columns x and y" } else { "single values, column value" };
        return Err(UsageError(format!("--kind {} does not go with {shown}, which has {columns}", kind.name())).into());
    }
    send(session, options(&args)?, feed, &shown).await
}

/// Sends the rows of a file, tells what became of them, and waits for nightly updates where they were announced.
pub(super) async fn send<L: Layout<Row: Sendable>>(
    session: &Session,
    options: ProducerOptions,
    Feed { rows, total_bytes, .. }: Feed<L>,
    shown: &str,
) -> anyhow::Result<ExitCode> {
    let (producer, label) = (options.producer.clone(), options.label.clone());
    let (map, kind, is_nightly) = (options.map.clone(), options.kind, options.nightly);
    let bar = Bar::bytes(total_bytes);
    let mut transfer = {
        let (producer, notices) = opened(session, options, &bar).await?;
        let told = RefusalReport::new(bar.clone(), "is refused");
        let kinds = Kinds::new(session.client.clone(), map.clone(), kind);
        Transfer::new(producer, notices, rows, (told, kinds), bar.clone())
    };
    if transfer.sent_before() > 0 {
        let rows = transfer.sent_before();
        bar.status_line(&format!(
            "{producer} sent {rows} rows as {label} before; they are compared and not sent again"
        ));
    }
    let sent = async {
        match transfer.run().await {
            TransferEnd::Whole if is_nightly => {
                nights(session, &map, &bar).await.map_or_else(TransferEnd::Nights, |()| TransferEnd::Whole)
            }
            ended => ended,
        }
    };
    let ended = tokio::select! {
        ended = sent => ended,
        signal = tokio::signal::ctrl_c() => {
            signal.context("signals")?;
            TransferEnd::Interrupted
        }
    };
    if matches!(ended, TransferEnd::Interrupted) {
        bar.status_line("interrupted; waiting for what is under way");
        let _ = tokio::time::timeout(LAST_FLUSH, transfer.flush()).await;
    }
    bar.clear();
    let counts = transfer.counts();
    if !matches!(ended, TransferEnd::Differs(_)) {
        let mut table = session.table(&["read", "accepted", "duplicate", "refused"]);
        table.row([counts.read, counts.accepted, counts.duplicate, counts.refused].map(Cell::from).to_vec())?;
        table.finish()?;
    }
    transfer.told.conclude();
    match ended {
        TransferEnd::Whole if transfer.told.all_well() => Ok(ExitCode::SUCCESS),
        TransferEnd::Whole => Ok(ExitCode::FAILURE),
        TransferEnd::Interrupted => Ok(ExitCode::from(INTERRUPTED)),
        TransferEnd::Unreadable(error) => Err(error.context(shown.to_owned())),
        TransferEnd::Nights(error) => Err(error.context("everything was sent, but the nightly updates failed")),
        TransferEnd::Stopped(error) => {
            let durable = counts.accepted + counts.duplicate + counts.refused;
            status_line(&format!(
                "{durable} of the {} rows read are durable; the same command again sends the rest",
                counts.read
            ));
            Err(error.into())
        }
        TransferEnd::Differs(how) => {
            anyhow::bail!(
                "{shown} differs from what {producer} sent as {label}: {how}; nothing was sent. Another file \
                           needs another --label"
            )
        }
    }
}

/// Who sends, from the options of a command; says so where that was not said.
pub(super) fn usual_options(producer: Option<&str>, label: &str, map: &str) -> anyhow::Result<ProducerOptions> {
    if let Some(producer) = producer {
        return Ok(ProducerOptions::new(producer, label, map));
    }
    let producer = producer_id::usual()?;
    status_line(&format!("observing as producer {producer}, label {label}"));
    Ok(ProducerOptions::new(&producer, label, map))
}

fn options(args: &ObserveArgs) -> anyhow::Result<ProducerOptions> {
    let label = args.label.clone().unwrap_or_else(|| base_name(&args.file));
    let patience = Duration::from_nanos(args.patience.unsigned_abs());
    let usual = usual_options(args.producer.as_deref(), &label, &args.map)?;
    Ok(ProducerOptions { nightly: args.nightly, kind: args.kind, patience, ..usual })
}

/// The usual label of a file.
pub(super) fn base_name(file: &Path) -> String {
    match file.file_name() {
        Some(name) if name != "-" => name.to_string_lossy().into_owned(),
        _ => "stdin".to_owned(),
    }
}

/// Opens the stream; says so where that takes a while.
pub(super) async fn opened(
    session: &Session,
    options: ProducerOptions,
    bar: &Bar,
) -> Result<(Producer, JoinHandle<()>), ProducerError> {
    let patience = options.patience;
    let mut producer = Producer::start(&session.client, ProducerOptions { key_patience: KEY_PATIENCE, ..options });
    let notices = tokio::spawn(say(producer.watch(), bar.clone(), patience));
    match producer.opened().await {
        Ok(_) => Ok((producer, notices)),
        Err(error) => {
            notices.abort();
            bar.clear();
            Err(error)
        }
    }
}

/// Waits for the updates of the days that the data closed, so that whoever asks next is answered from them.
pub(super) async fn nights(session: &Session, map: &str, bar: &Bar) -> anyhow::Result<()> {
    bar.clear();
    // An update is lined up just after the acknowledgement that makes it due: look twice.
    let mut quiet = 0;
    while quiet < 2 {
        let jobs = session.client.jobs().await?;
        let night = |job: &&Job| job.map == map && job.cause == JobCause::DataTime && !job.has_ended();
        // The oldest first: they run one after the other.
        if let Some(job) = jobs.iter().rev().find(night) {
            quiet = 0;
            let ended = job::watched(&session.client, job.id).await?;
            anyhow::ensure!(ended.state == JobState::Done, job::failure(&ended));
        } else {
            quiet += 1;
            tokio::time::sleep(NIGHT_PAUSE).await;
        }
    }
    Ok(())
}

/// Says on stderr when the daemon cannot be reached, once per outage, and when it can again.
async fn say(mut progress: watch::Receiver<Progress>, bar: Bar, patience: Duration) {
    let mut waiting = false;
    while progress.changed().await.is_ok() {
        let phase = progress.borrow_and_update().phase.clone();
        match phase {
            Phase::Waiting(error) if !waiting => {
                waiting = true;
                bar.status_line(&format!("{error}; trying again for up to {} s", patience.as_secs()));
            }
            Phase::Connected if waiting => {
                waiting = false;
                bar.status_line("connected again");
            }
            _ => {}
        }
    }
}

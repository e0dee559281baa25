//! `tidemap observe`, and the common parts of all commands that send files.
//!
//! Invariant: a row's number in its file is its sequence number. A file can be sent any number of times, in any number
//! of pieces, and is learned once. The rows that the daemon has are compared with the file before anything is sent.

mod advice;
pub(crate) mod feed;
mod kind_patterns;
pub(crate) mod kinds;
mod next_steps;
mod opening;
pub(crate) mod refused;
mod reporting;
pub(crate) mod transfer;

use std::{
    collections::HashSet,
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};

use anyhow::Context as _;
use clap::Args;
use tidemap_client::{
    maps::{RowKind, StateKind},
    observe::{Phase, Producer, ProducerError, ProducerOptions, Progress},
    updates::{Erasure, Job, JobCause, JobState},
};
use tokio::{sync::watch, task::JoinHandle};

pub(super) use self::next_steps::FileWords;
use self::{
    feed::{Feed, RefusalReport},
    kind_patterns::KindPatterns,
    kinds::Kinds,
    next_steps::NextSteps,
    refused::RefusedRows,
    transfer::{RowCounts, RowTransfer, Sendable, Transfer, TransferEnd},
};
use super::{
    Session, erase, job,
    predict::names,
    producer_id,
    rows::{FileArgs, ReportArgs},
    shell_word::quoted,
    state::KindArg,
    times, usage,
};
use crate::progress::{Bar, status_line};
use tidemap_formats::{
    observation_file::{Layout, ObservationColumns},
    table::Cell,
};

#[derive(Debug, Args)]
pub(crate) struct ObserveArgs {
    /// Name of the map
    map: String,
    /// File with the columns time,state,value, or time,state,x,y and optionally z of positions in metres; - is stdin
    file: PathBuf,
    #[command(flatten)]
    sender: SenderArgs,
    #[command(flatten)]
    reports: ReportArgs,
    #[command(flatten)]
    written: FileArgs,
    /// Kind of the file's states: probability, continuous, count or angle (radians); new states get it, and rows of
    /// states of another kind are refused; a file with columns x and y has kind vector; with categorical, values are
    /// labels of states that exist [default: each state keeps its kind; new states are probabilities]
    #[arg(long, value_name = "KIND")]
    kind: Option<KindArg>,
    /// Kinds of some states of the file, by patterns of their names, such as
    /// 'temperature.*=continuous,visits-?=count'; the first that fits decides, and other states are as without this
    #[arg(long, value_name = "PATTERN=KIND,…", conflicts_with = "kind")]
    kinds: Option<KindPatterns>,
    /// Writes the refused rows to this new file, to be corrected there and sent
    #[arg(long, value_name = "FILE")]
    refused: Option<PathBuf>,
    /// Withdraws what this producer has sent with this label before, as if it had never been observed, and sends the
    /// file anew; for a corrected file (needs the role admin)
    #[arg(long)]
    replace: bool,
}

/// Who sends a file, and how.
#[derive(Debug, Args)]
pub(crate) struct SenderArgs {
    /// Name of the producer [default: a name for this user and machine, generated once and kept]
    #[arg(long, value_name = "ID")]
    producer: Option<String>,
    /// Label of the file among the producer's files [default: the base name of the first file, or stdin]
    #[arg(long, value_name = "LABEL")]
    label: Option<String>,
    /// Runs the nightly update whenever the data passes the map's local midnight
    #[arg(long)]
    nightly: bool,
    /// Time to keep trying when the daemon cannot be reached
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = times::duration_or_none)]
    patience: i64,
}

impl SenderArgs {
    /// The options of the stream; reports the default producer on stderr.
    pub(super) fn options(&self, map: &str, default_label: &str) -> anyhow::Result<ProducerOptions> {
        let label = self.label.as_deref().unwrap_or(default_label);
        let producer = match &self.producer {
            Some(producer) => producer.clone(),
            None => {
                let producer = producer_id::of_user()?;
                status_line(&format!("observing as producer {producer}, label {label}"));
                producer
            }
        };
        let patience = Duration::from_nanos(self.patience.unsigned_abs());
        Ok(ProducerOptions { nightly: self.nightly, patience, ..ProducerOptions::new(&producer, label, map) })
    }
}

/// The daemon may hold the key of a stream that has just ended for this long.
const KEY_PATIENCE: Duration = Duration::from_secs(3);
/// The time limit for the last flush after Ctrl-C.
const LAST_FLUSH: Duration = Duration::from_secs(5);
/// Pause between two checks for nightly updates.
const NIGHT_PAUSE: Duration = Duration::from_millis(50);
pub(super) const INTERRUPTED: u8 = 130;

pub(crate) async fn run(session: &Session, args: ObserveArgs) -> anyhow::Result<ExitCode> {
    let shown = feed::display_name(&args.file);
    let refused = args.refused.as_deref().map(|target| RefusedRows::new(&args.file, target)).transpose()?;
    let stated = args.reports.stated()?;
    let mut rules = args.written.rules(session, &args.map, args.reports.kind()).await?;
    rules.labelled = match (&args.kinds, args.kind) {
        (Some(kinds), _) => kinds.labelled(),
        (None, Some(KindArg::Categorical)) => vec![(vec!['*'], true)],
        (None, _) => Vec::new(),
    };
    let rules = rules;
    let feed = feed::open::<ObservationColumns>(&args.file, &rules)?;
    let has_positions = feed.layout.has_positions();
    if let Some(kind) = args.kind.filter(|kind| (*kind == KindArg::Vector) != has_positions) {
        let columns = if has_positions { "positions, columns x and y" } else { "single values, column value" };
        return Err(usage(format!("--kind {} does not go with {shown}, which has {columns}", kind.name())));
    }
    let options = args.sender.options(&args.map, &base_name(&args.file))?;
    let mut kind = args.kind.and_then(KindArg::single);
    if args.reports.kind() == RowKind::Events && args.kinds.is_none() {
        kind = kind.or(Some(StateKind::Count.into()));
    }
    if let (Some(KindArg::Categorical), Some(stated)) = (args.kind, stated) {
        return Err(usage(format!("--kind categorical does not go with --{}", stated.kind().name())));
    }
    if let (Some(kind), Some(stated)) = (kind, stated)
        && !kind.may_report(stated.for_new())
    {
        return Err(usage(format!("--kind {} does not go with --{}", kind.name(), stated.kind().name())));
    }
    let options = ProducerOptions { kind, reporting: stated, ..options };
    let words = words(&args);
    let steps = NextSteps::new(&options, "observe", &words, &shown);
    if let Some(stated) = stated {
        reporting::check(session, (&options.map, &args.file), &rules, stated, &steps).await?;
    }
    let plan = match &args.kinds {
        Some(_) if has_positions => {
            return Err(usage(format!("--kinds does not go with {shown}, which has positions")));
        }
        Some(kinds) => Some(kinds.plan(session, (&options.map, &args.file), &rules, stated, &steps).await?),
        None => None,
    };
    // First, so that a state that cannot be added does not leave the file withdrawn.
    if let Some(plan) = plan {
        plan.add(session, &options.map, stated).await?;
    }
    if args.replace {
        withdraw(session, &options).await?;
    }
    send(session, options, feed, FileSent { shown: &shown, command: "observe", words, refused }).await
}

/// The options that state how the file is read and what its rows are, each with a blank before it.
fn words(args: &ObserveArgs) -> FileWords {
    let (mut words, mut kinds) = (args.reports.words() + &args.written.words(), String::new());
    if let Some(kind) = args.kind {
        kinds += &format!(" --kind {}", kind.name());
    }
    if let Some(patterns) = &args.kinds {
        kinds += &format!(" --kinds {}", quoted(&patterns.to_string()));
    }
    if args.sender.nightly {
        words += " --nightly";
    }
    FileWords { words, kinds }
}

/// Erases the observations that the producer of the options has sent with their label.
async fn withdraw(session: &Session, options: &ProducerOptions) -> anyhow::Result<()> {
    let ProducerOptions { producer, label, map, .. } = options;
    let known = session.client.producers(map).await?;
    if !known.iter().any(|known| (&known.producer, &known.label) == (producer, label)) {
        status_line(&format!("{producer} has sent nothing as {label} before: there is nothing to withdraw"));
        return Ok(());
    }
    let what = Erasure {
        producer: Some(producer.clone()),
        label: Some(label.clone()),
        forget_sequence: true,
        ..Erasure::default()
    };
    let ended = erase::run_to_end(session, map, what).await?;
    let observations = if ended.observations == 1 { "observation" } else { "observations" };
    status_line(&format!("withdrawn: {} {observations} that {producer} sent as {label}", ended.observations));
    Ok(())
}

/// A file that a command sends.
pub(super) struct FileSent<'a> {
    /// The name of the file for messages.
    pub(super) shown: &'a str,
    /// Name of the command.
    pub(super) command: &'static str,
    /// The options that state how the file is read and what its rows are, each with a blank before it.
    pub(super) words: FileWords,
    /// The file for refused rows.
    pub(super) refused: Option<RefusedRows>,
}

/// Sends the rows of a file, prints the counts, and waits for nightly updates if the options announce them.
pub(super) async fn send<L: Layout<Item: Sendable>>(
    session: &Session,
    options: ProducerOptions,
    Feed { rows, total_bytes, .. }: Feed<L>,
    FileSent { shown, command, words, refused }: FileSent<'_>,
) -> anyhow::Result<ExitCode> {
    let bar = Bar::bytes(total_bytes);
    let (producer, notices) = open_stream(session, options.clone(), &bar).await?;
    let report = RefusalReport::new(bar.clone(), "row", "is refused").keeping(refused);
    let kinds = Kinds::new(session.client.clone(), options.map.clone(), options.kind);
    let mut transfer = RowTransfer::new(producer, notices, rows, (report, kinds), bar.clone());
    let end = run_transfer(session, &mut transfer, &options, &bar, "rows").await?;
    let counts = transfer.counts();
    if !matches!(end, TransferEnd::Differs(_)) {
        let mut columns = vec!["read", "accepted", "duplicate", "refused"];
        let mut cells = [counts.read, counts.accepted, counts.duplicate, counts.refused].map(Cell::from).to_vec();
        if options.reporting.is_some() || counts.mapped > 0 {
            columns.extend(["mapped", "without_value"]);
            cells.extend([counts.mapped, counts.without_value].map(Cell::from));
        }
        session.print(&columns, [cells])?;
    }
    let steps = NextSteps::new(&options, command, &words, shown);
    let rows_are = options.reporting.map_or(RowKind::Samples, |stated| stated.kind());
    transfer.advice(rows_are, &steps).iter().for_each(|line| status_line(line));
    transfer.report.conclude();
    let is_sent = !matches!(end, TransferEnd::Differs(_));
    print_advice(session, &transfer, counts, (&steps, is_sent), &options).await?;
    if let TransferEnd::Stopped(_) = end {
        let durable = counts.accepted + counts.duplicate + counts.refused;
        status_line(&format!(
            "{durable} of the {} rows read are durable; the same command again sends the rest",
            counts.read
        ));
    }
    let end = match end {
        TransferEnd::Unreadable(error) => TransferEnd::Unreadable(error.context(shown.to_owned())),
        end => end,
    };
    let another = if is_sent { String::new() } else { free_label(session, &options).await };
    exit_code(end, &transfer.report, &options, shown, &steps.differs(&another))
}

/// Prints advice about rows that were refused, or that were sent before and are gone.
async fn print_advice<T: Sendable>(
    session: &Session,
    transfer: &RowTransfer<T>,
    counts: RowCounts,
    (steps, is_sent): (&NextSteps<'_>, bool),
    options: &ProducerOptions,
) -> anyhow::Result<()> {
    if let Some(refused) = transfer.report.kept() {
        // A file that differs was not sent, and its faults give no information about the data that was sent.
        let advice = if is_sent { refused.write(steps.again())? } else { None };
        advice.iter().for_each(|advice| status_line(advice));
    } else if counts.refused > 0 {
        steps.refused().iter().for_each(|advice| status_line(advice));
    }
    if options.kind.is_none() && transfer.report.has_reason("not between 0 and 1") {
        status_line(&steps.no_probabilities());
    }
    if is_sent && !transfer.sent_before_states().is_empty() {
        let known: HashSet<String> = names::all(session, &options.map).await?.into_iter().collect();
        let absent: Vec<&String> = transfer.sent_before_states().iter().filter(|name| !known.contains(*name)).collect();
        if let Some((first, others)) = absent.split_first() {
            let more = match others.len() {
                0 => String::new(),
                1 => " and of one more state".to_owned(),
                count => format!(" and of {count} more states"),
            };
            status_line(&steps.absent(&format!("{first:?}{more}")));
        }
    }
    Ok(())
}

/// Runs a transfer until it ends or Ctrl-C, then waits for nightly updates if the options announce them.
pub(super) async fn run_transfer(
    session: &Session,
    transfer: &mut impl Transfer,
    options: &ProducerOptions,
    bar: &Bar,
    noun: &str,
) -> anyhow::Result<TransferEnd> {
    if transfer.sent_before() > 0 {
        let (sent, ProducerOptions { producer, label, .. }) = (transfer.sent_before(), options);
        bar.status_line(&format!(
            "{producer} sent {sent} {noun} as {label} before; they are compared and not sent again"
        ));
    }
    let sent = async {
        match transfer.run().await {
            TransferEnd::Whole if options.nightly => await_updates(session, &options.map, bar)
                .await
                .map_or_else(TransferEnd::Updates, |()| TransferEnd::Whole),
            end => end,
        }
    };
    let end = tokio::select! {
        end = sent => end,
        signal = tokio::signal::ctrl_c() => {
            signal.context("signals")?;
            TransferEnd::Interrupted
        }
    };
    if matches!(end, TransferEnd::Interrupted) {
        bar.status_line("interrupted; waiting for observations in flight");
        let _ = tokio::time::timeout(LAST_FLUSH, transfer.flush()).await;
    }
    bar.clear();
    report_future_times(session, &options.map).await;
    Ok(end)
}

/// Reports the observations of a map that wait because they are later than the daemon's clock. A daemon that is gone
/// causes other messages.
async fn report_future_times(session: &Session, map: &str) {
    let Ok(known) = session.client.map(map).await else { return };
    let scans = known.grid_summary.map_or(0, |summary| summary.ahead_scans);
    let some = [(known.ahead_observations, "observation"), (scans, "scan")].into_iter().filter(|(count, _)| *count > 0);
    let counted = some.map(|(count, noun)| format!("{count} {noun}{}", if count == 1 { "" } else { "s" }));
    let counted = counted.collect::<Vec<_>>().join(" and ");
    if !counted.is_empty() {
        status_line(&format!(
            "map {map:?} has {counted} with times ahead of the daemon's clock: updates learn them when their time has \
             come. If these times are wrong, check the clock of the robot, and the unit and the UTC offset of the \
             times sent"
        ));
    }
}

/// The exit status of a transfer, or its error.
pub(super) fn exit_code(
    end: TransferEnd,
    report: &RefusalReport,
    options: &ProducerOptions,
    shown: &str,
    what_to_do: &str,
) -> anyhow::Result<ExitCode> {
    match end {
        TransferEnd::Whole if report.is_clean() => Ok(ExitCode::SUCCESS),
        TransferEnd::Whole => Ok(ExitCode::FAILURE),
        TransferEnd::Interrupted => Ok(ExitCode::from(INTERRUPTED)),
        TransferEnd::Unreadable(error) => Err(error),
        TransferEnd::Updates(error) => Err(error.context("everything was sent, but the nightly updates failed")),
        TransferEnd::Stopped(error) => Err(error.into()),
        TransferEnd::Differs(how) => {
            let ProducerOptions { producer, label, .. } = options;
            anyhow::bail!(
                "{shown} differs from the data that {producer} sent as {label}: {how}; nothing was sent. {what_to_do}"
            )
        }
    }
}

/// A label that the producer of the options has not used, for another file that would have the label of the options by
/// default.
pub(super) async fn free_label(session: &Session, options: &ProducerOptions) -> String {
    // Without the list, the next one is a good guess.
    let known = session.client.producers(&options.map).await.unwrap_or_default();
    let used: HashSet<&str> =
        known.iter().filter(|known| known.producer == options.producer).map(|known| known.label.as_str()).collect();
    let mut label = other_label(&options.label);
    while used.contains(label.as_str()) {
        label = other_label(&label);
    }
    label
}

/// A label for another file that has this label by default.
fn other_label(label: &str) -> String {
    let (stem, ending) = label.rsplit_once('.').map_or((label, String::new()), |(stem, end)| (stem, format!(".{end}")));
    let numbered = stem.rsplit_once('-').and_then(|(name, number)| Some((name, number.parse::<u32>().ok()?)));
    match numbered {
        Some((name, number)) if number < u32::MAX => format!("{name}-{}{ending}", number + 1),
        _ => format!("{stem}-2{ending}"),
    }
}

/// The default label of a file.
pub(super) fn base_name(file: &Path) -> String {
    match file.file_name() {
        Some(name) if name != "-" => name.to_string_lossy().into_owned(),
        _ => "stdin".to_owned(),
    }
}

/// Opens the stream, and reports on stderr when the daemon cannot be reached.
pub(super) async fn open_stream(
    session: &Session,
    options: ProducerOptions,
    bar: &Bar,
) -> Result<(Producer, JoinHandle<()>), ProducerError> {
    let patience = options.patience;
    let mut producer = Producer::start(&session.client, ProducerOptions { key_patience: KEY_PATIENCE, ..options });
    let notices = tokio::spawn(report_outages(producer.watch(), bar.clone(), patience));
    match producer.opened().await {
        Ok(_) => Ok((producer, notices)),
        Err(error) => {
            notices.abort();
            bar.clear();
            Err(error)
        }
    }
}

/// Waits for the updates of the days that the data closed, so that later predictions come from the updated models.
async fn await_updates(session: &Session, map: &str, bar: &Bar) -> anyhow::Result<()> {
    bar.clear();
    // The daemon queues an update just after the acknowledgement that makes it due, so one empty list is not enough.
    let mut quiet = 0;
    while quiet < 2 {
        let jobs = session.client.jobs().await?;
        let is_nightly = |job: &&Job| job.map == map && job.cause == JobCause::DataTime && !job.has_ended();
        // Oldest first: the daemon runs them one after the other.
        if let Some(job) = jobs.iter().rev().find(is_nightly) {
            quiet = 0;
            let ended = job::watch(&session.client, job.id).await?;
            anyhow::ensure!(ended.state == JobState::Done, job::failure(&ended));
        } else {
            quiet += 1;
            tokio::time::sleep(NIGHT_PAUSE).await;
        }
    }
    Ok(())
}

/// Reports on stderr, once per outage, that the daemon cannot be reached, and that the connection is back; and that the
/// daemon came back with another data folder.
async fn report_outages(mut progress: watch::Receiver<Progress>, bar: Bar, patience: Duration) {
    let mut waiting = false;
    let mut store_changes = 0;
    while progress.changed().await.is_ok() {
        let seen = progress.borrow_and_update().clone();
        if seen.store_changes > store_changes {
            store_changes = seen.store_changes;
            bar.status_line(&format!(
                "the daemon has another data folder than before (store id {}): data that was acknowledged before may \
                 be missing. Was a backup restored, or is a disk not mounted?",
                seen.store_id
            ));
        }
        match seen.phase {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_label_is_proposed() {
        for (label, other) in
            [("log.csv", "log-2.csv"), ("log-2.csv", "log-3.csv"), ("stdin", "stdin-2"), ("robot-a", "robot-a-2")]
        {
            assert_eq!(other_label(label), other);
        }
    }
}

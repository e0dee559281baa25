//! `tidemap traverse`.
//!
//! Invariant: as for `tidemap observe`: a file can be sent any number of times and is learned once. A single report, which
//! has no file, is sent each time.

use std::{path::PathBuf, process::ExitCode, time::Duration};

use clap::Args;
use tidemap_client::observe::{ProducerOptions, Traversal};

use super::{Session, UsageError, observe, observe::feed, times};
use crate::progress::{Bar, status_line};
use tidemap_formats::{
    observation_file::traversals::{TraversalColumns, parse_success},
    table::Cell,
};

/// Label of reports without a file.
const LABEL: &str = "traverse";

#[derive(Debug, Args)]
pub struct TraverseArgs {
    /// Name of the map
    map: String,
    /// File with the columns from,to,start,end,success and perhaps action and reason; - is stdin
    #[arg(required_unless_present = "from", conflicts_with_all = ["from", "to", "action", "start", "end", "success", "reason"])]
    file: Option<PathBuf>,
    /// Without a file: name of the node where the edge begins
    #[arg(long, value_name = "NODE", requires_all = ["to", "start", "end", "success"])]
    from: Option<String>,
    /// Name of the node where it ends
    #[arg(long, value_name = "NODE", requires = "from")]
    to: Option<String>,
    /// By which action it was travelled [default: as usual]
    #[arg(long, value_name = "ACTION", requires = "from")]
    action: Option<String>,
    /// When the robot set out
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "from")]
    start: Option<i64>,
    /// When it arrived or gave up, within a day
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "from")]
    end: Option<i64>,
    /// Whether it arrived
    #[arg(long, value_name = "true|false", value_parser = parse_success, requires = "from")]
    success: Option<bool>,
    /// Why it did not, at most 200 characters
    #[arg(long, value_name = "TEXT", requires = "from")]
    reason: Option<String>,
    /// Who reports [default: a name for this user and machine, made once and kept]
    #[arg(long, value_name = "ID")]
    producer: Option<String>,
    /// Which of the producer's files this is [default: its base name, or stdin; traverse without a file]
    #[arg(long, value_name = "LABEL")]
    label: Option<String>,
    /// Runs the nightly update whenever the data passes the map's local midnight
    #[arg(long)]
    nightly: bool,
    /// How long to go on trying when the daemon cannot be reached
    #[arg(long, value_name = "DURATION", default_value = "60s", value_parser = times::duration_or_none)]
    patience: i64,
}

impl TraverseArgs {
    fn options(&self) -> anyhow::Result<ProducerOptions> {
        let usual = || self.file.as_deref().map_or_else(|| LABEL.to_owned(), observe::base_name);
        let label = self.label.clone().unwrap_or_else(usual);
        let patience = Duration::from_nanos(self.patience.unsigned_abs());
        let usual = observe::usual_options(self.producer.as_deref(), &label, &self.map)?;
        Ok(ProducerOptions { nightly: self.nightly, patience, ..usual })
    }

    /// The report that the options make. They are all there: the command line sees to that.
    fn report(&self) -> Traversal {
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        Traversal {
            from: text(&self.from),
            to: text(&self.to),
            action: text(&self.action),
            start_nanos: self.start.unwrap_or_default(),
            end_nanos: self.end.unwrap_or_default(),
            success: self.success.unwrap_or_default(),
            reason: text(&self.reason),
        }
    }
}

pub async fn run(session: &Session, args: &TraverseArgs) -> anyhow::Result<ExitCode> {
    if let Some(file) = &args.file {
        let feed = feed::open::<TraversalColumns>(file)?;
        return observe::send(session, args.options()?, feed, &feed::shown(file)).await;
    }
    let report = args.report();
    if let Some(wrong) = report.wrong() {
        return Err(UsageError(wrong).into());
    }
    let bar = Bar::bytes(None);
    let (mut producer, notices) = observe::opened(session, args.options()?, &bar).await?;
    producer.send_traversal(&report).await?;
    producer.close().await?;
    notices.abort();
    bar.clear();
    let refusals = producer.take_refusals();
    let refused = u64::from(!refusals.is_empty());
    let mut table = session.table(&["read", "accepted", "duplicate", "refused"]);
    table.row([1, 1 - refused, 0, refused].map(Cell::from).to_vec())?;
    table.finish()?;
    refusals.iter().for_each(|refusal| status_line(&format!("the report is refused: {}", refusal.detail)));
    Ok(if refusals.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

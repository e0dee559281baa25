//! `tidemap traverse`.
//!
//! Invariant: as for `tidemap observe`, a file can be sent any number of times and is learned once. A single report has
//! no file and is sent each time.

use std::{path::PathBuf, process::ExitCode};

use clap::Args;
use tidemap_client::observe::{ProducerOptions, TraversalReport};

use super::{
    Session,
    observe::{self, FileSent, FileWords, SenderArgs, feed, refused::RefusedRows},
    times, usage,
};
use crate::progress::{Bar, status_line};
use tidemap_formats::{
    observation_file::{
        RowRules,
        traversals::{TraversalColumns, parse_success},
    },
    table::Cell,
};

/// Default label of single reports.
const LABEL: &str = "traverse";

#[derive(Debug, Args)]
pub(crate) struct TraverseArgs {
    /// Name of the map
    map: String,
    /// File with the columns from,to,start,end,success and optionally action and reason; - is stdin
    #[arg(required_unless_present = "from", conflicts_with_all = ["from", "to", "action", "start", "end", "success", "reason"])]
    file: Option<PathBuf>,
    /// Without a file: name of the node where the edge begins
    #[arg(long, value_name = "NODE", requires_all = ["to", "start", "end", "success"])]
    from: Option<String>,
    /// Name of the node where it ends
    #[arg(long, value_name = "NODE", requires = "from")]
    to: Option<String>,
    /// Action of the robot on the edge [default: none]
    #[arg(long, value_name = "ACTION", requires = "from")]
    action: Option<String>,
    /// Time when the robot started
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "from")]
    start: Option<i64>,
    /// Time when it arrived or gave up, within a day
    #[arg(long, value_name = "TIME", value_parser = times::time, requires = "from")]
    end: Option<i64>,
    /// Whether the robot arrived
    #[arg(long, value_name = "true|false", value_parser = parse_success, requires = "from")]
    success: Option<bool>,
    /// Reason of a failure, at most 200 characters
    #[arg(long, value_name = "TEXT", requires = "from")]
    reason: Option<String>,
    /// Writes the refused rows to this new file, to be corrected there and sent
    #[arg(long, value_name = "FILE", requires = "file")]
    refused: Option<PathBuf>,
    #[command(flatten)]
    sender: SenderArgs,
}

impl TraverseArgs {
    fn options(&self) -> anyhow::Result<ProducerOptions> {
        let default_label = self.file.as_deref().map_or_else(|| LABEL.to_owned(), observe::base_name);
        self.sender.options(&self.map, &default_label)
    }

    /// The report from the options. The command line requires all these options.
    fn report(&self) -> TraversalReport {
        let text = |text: &Option<String>| text.clone().unwrap_or_default();
        TraversalReport {
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

pub(crate) async fn run(session: &Session, args: &TraverseArgs) -> anyhow::Result<ExitCode> {
    if let Some(file) = &args.file {
        let refused = args.refused.as_deref().map(|target| RefusedRows::new(file, target)).transpose()?;
        let feed = feed::open::<TraversalColumns>(file, &RowRules::default())?;
        let sent =
            FileSent { shown: &feed::display_name(file), command: "traverse", words: FileWords::default(), refused };
        return observe::send(session, args.options()?, feed, sent).await;
    }
    let report = args.report();
    if let Some(wrong) = report.wrong() {
        return Err(usage(wrong));
    }
    let bar = Bar::bytes(None);
    let (mut producer, notices) = observe::open_stream(session, args.options()?, &bar).await?;
    producer.send_traversal(&report).await?;
    producer.close().await?;
    notices.abort();
    bar.clear();
    let refusals = producer.take_refusals();
    let refused = u64::from(!refusals.is_empty());
    let cells = [1, 1 - refused, 0, refused].map(Cell::from).to_vec();
    session.print(&["read", "accepted", "duplicate", "refused"], [cells])?;
    refusals.iter().for_each(|refusal| status_line(&format!("the report is refused: {}", refusal.detail)));
    Ok(if refusals.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

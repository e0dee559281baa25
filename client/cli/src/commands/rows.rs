//! The kind of the rows of a file, and their form: the options of commands that read observations.
//!
//! Invariant: the options are checked before anything is sent.

use clap::Args;
use tidemap_client::maps::{RowKind, StatedReporting};
use tidemap_formats::observation_file::RowRules;
use tidemap_model::{Zone, time::NANOS_PER_SEC};

use super::{Session, shell_word::quoted, times, usage};

/// How a file is written.
#[derive(Debug, Args)]
pub(crate) struct FileArgs {
    /// Reads times without a time zone in the map's zone; where an hour exists twice, the order of the rows decides
    #[arg(long)]
    local: bool,
    /// Names of the file's columns, where they are not time, state and value: time=last_changed,state=entity_id
    #[arg(long, value_name = "COLUMN=NAME,…", value_parser = RowRules::parse_columns)]
    columns: Option<ColumnNames>,
    /// Meanings of words of the file, beside usual ones such as on, open and unavailable: ajar=1,jammed=none; none: the
    /// sensor has no value
    #[arg(long, value_name = "WORD=NUMBER,…")]
    values: Option<String>,
}

type ColumnNames = [Option<String>; 3];

/// The kind of rows in a file.
#[derive(Debug, Args)]
pub(crate) struct RowKindArgs {
    /// Rows are changes, as of a door contact: a value holds until the next row, or until one without a value such as
    /// unavailable
    #[arg(long, conflicts_with = "events")]
    changes: bool,
    /// Rows are events, as of a light barrier: they are counted, by the hour unless --hold-step is given
    #[arg(long)]
    events: bool,
}

/// How the states of a file are reported.
#[derive(Debug, Args)]
pub(crate) struct ReportArgs {
    #[command(flatten)]
    rows: RowKindArgs,
    /// With --changes or --events: the longest time for which a row is valid [default: 7d]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    hold_max: Option<i64>,
    /// With --changes or --events: the time between two readings that are learned [default: 5m, 1h for
    /// events, or --hold-max where that is shorter]
    #[arg(long, value_name = "DURATION", value_parser = times::duration)]
    hold_step: Option<i64>,
}

impl FileArgs {
    /// The options as they are given, each with a blank before it.
    pub(crate) fn words(&self) -> String {
        let mut words = if self.local { " --local".to_owned() } else { String::new() };
        if let Some(columns) = &self.columns {
            let named = ["time", "state", "value"].iter().zip(columns);
            let pairs = named.filter_map(|(column, name)| Some(format!("{column}={}", name.as_ref()?)));
            words += &format!(" --columns {}", quoted(&pairs.collect::<Vec<_>>().join(",")));
        }
        if let Some(values) = &self.values {
            words += &format!(" --values {}", quoted(values));
        }
        words
    }

    /// The rules of the file's rows.
    pub(crate) async fn rules(&self, session: &Session, map: &str, kind: RowKind) -> anyhow::Result<RowRules> {
        let zone = match self.local {
            true => Some(Zone::named(&session.client.map(map).await?.time_zone)?),
            false => None,
        };
        let words = self.values.as_deref().map(RowRules::parse_words).transpose();
        let words = words.map_err(|error| usage(format!("--values: {error}")))?.unwrap_or_default();
        Ok(RowRules { columns: self.columns.clone().unwrap_or_default(), words, zone, kind, labelled: Vec::new() })
    }
}

impl RowKindArgs {
    /// The kind of the rows.
    pub(crate) fn kind(&self) -> RowKind {
        match (self.changes, self.events) {
            (true, _) => RowKind::Changes,
            (_, true) => RowKind::Events,
            _ => RowKind::Samples,
        }
    }
}

impl ReportArgs {
    /// The options as they are given, each with a blank before it.
    pub(crate) fn words(&self) -> String {
        let kind = match self.kind() {
            RowKind::Samples => String::new(),
            kind => format!(" --{}", kind.name()),
        };
        // Whole seconds, as they are checked.
        let secs = |option: &str, nanos: Option<i64>| {
            nanos.map_or_else(String::new, |nanos| format!(" {option} {}s", nanos / NANOS_PER_SEC))
        };
        kind + &secs("--hold-max", self.hold_max) + &secs("--hold-step", self.hold_step)
    }

    /// The kind of the rows.
    pub(crate) fn kind(&self) -> RowKind {
        self.rows.kind()
    }

    /// The reporting that the options state for the states; `None`: nothing is stated.
    pub(crate) fn stated(&self) -> anyhow::Result<Option<StatedReporting>> {
        stated(self.kind(), self.hold_max, self.hold_step)
    }
}

/// The stated reporting of a state, from durations in nanoseconds; `None`: the state reports samples, which is the
/// default.
pub(crate) fn stated(
    kind: RowKind,
    hold_max: Option<i64>,
    hold_step: Option<i64>,
) -> anyhow::Result<Option<StatedReporting>> {
    if kind == RowKind::Samples && (hold_max, hold_step) == (None, None) {
        return Ok(None);
    }
    let secs = |option: &str, nanos: Option<i64>| {
        let whole = |nanos: i64| u32::try_from(nanos / NANOS_PER_SEC).ok().filter(|_| nanos % NANOS_PER_SEC == 0);
        let secs =
            nanos.map(|nanos| whole(nanos).ok_or_else(|| usage(format!("{option} takes whole seconds, up to 366d"))));
        secs.transpose()
    };
    let stated = StatedReporting::new(kind, secs("--hold-max", hold_max)?, secs("--hold-step", hold_step)?);
    stated.map(Some).map_err(|error| usage(error.to_string()))
}

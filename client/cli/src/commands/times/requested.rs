//! The times of a prediction: `--at`, `--date`, `--times`, or `--from` with `--to` and `--step`.
//!
//! Invariant: at least one time, in the order of the options. Times without a zone are read in the map's zone, and only
//! with `--local` or `--date`.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use tidemap_model::Zone;

use super::{When, duration, from_file, local_steps, named_day, steps, when};
use crate::commands::{Session, usage};

const HOUR_NANOS: i64 = 3_600_000_000_000;

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("when").required(true).multiple(true).args(["at", "times", "from", "date"]))]
pub(crate) struct RequestedTimesArgs {
    /// Times, separated by commas; with --date also clocks alone, such as 10:00
    #[arg(long, value_name = "TIME,…", value_parser = when, value_delimiter = ',')]
    at: Option<Vec<When>>,
    /// A whole day of the map's zone, hour by hour, or with --at these clocks of the day: today, tomorrow, yesterday or
    /// a date
    #[arg(long, value_name = "DAY")]
    date: Option<String>,
    /// Reads times without a time zone in the map's zone
    #[arg(long)]
    local: bool,
    /// File of times, one a line or in a column `time`; - is stdin
    #[arg(long, value_name = "FILE", conflicts_with_all = ["at", "date"])]
    times: Option<PathBuf>,
    /// First time
    #[arg(long, value_name = "TIME", value_parser = when, requires_all = ["to", "step"])]
    #[arg(conflicts_with_all = ["at", "date", "times"])]
    from: Option<When>,
    /// End of the times, not included
    #[arg(long, value_name = "TIME", value_parser = when, requires = "from")]
    to: Option<When>,
    /// Step between the times; with --date in hours of the map's clocks [default with --date: 1h]
    #[arg(long, value_name = "DURATION", value_parser = duration, conflicts_with_all = ["at", "times"])]
    step: Option<i64>,
}

impl RequestedTimesArgs {
    /// The requested times.
    pub(crate) async fn resolve(&self, session: &Session, map: &str) -> anyhow::Result<Vec<i64>> {
        let zone = match self.local || self.date.is_some() {
            true => Some(Zone::named(&session.client.map(map).await?.time_zone)?),
            false => None,
        };
        let local = zone.as_ref().filter(|_| self.local);
        let Self { at, date, times, from, to, step, .. } = self;
        if let (Some(date), Some(zone)) = (date, &zone) {
            let day = named_day(date, zone)?;
            return match at {
                Some(at) => Ok(at.iter().map(|when| when.resolve_on(day, local, zone)).collect::<Result<_, _>>()?),
                None => Ok(local_steps(day, zone, step.unwrap_or(HOUR_NANOS))?),
            };
        }
        Ok(match (at, times, from, to, step) {
            (Some(at), ..) => at.iter().map(|when| when.resolve(local)).collect::<Result<_, _>>()?,
            (None, Some(path), ..) => from_file(path)?,
            (None, None, Some(from), Some(to), Some(step)) => steps(from.resolve(local)?, to.resolve(local)?, *step)?,
            _ => return Err(usage("give the times with --at, --times, --date, or --from with --to and --step")),
        })
    }
}

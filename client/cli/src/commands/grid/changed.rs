//! `tidemap grid changed`.
//!
//! Invariant: a row is a cell whose change alarm rings, with the date that `model show` has for it.

use std::process::ExitCode;

use clap::Args;
use tidemap_formats::table::{Cell, Format};

use super::{
    grid_of,
    place::{self, AxisRange, Rectangle},
};
use crate::{commands::Session, progress::status_line};

#[derive(Debug, Args)]
pub(crate) struct GridChangedArgs {
    /// Name of the map
    map: String,
    /// Only cells in this rectangle, metres
    #[arg(long, value_name = "X0:X1,Y0:Y1", allow_hyphen_values = true)]
    region: Option<Rectangle>,
    /// Only cells between these heights, metres
    #[arg(long, value_name = "MIN:MAX", allow_hyphen_values = true)]
    z: Option<AxisRange>,
}

const COLUMNS: [&str; 10] = ["state", "x", "y", "z", "change_date", "mean", "last_value", "last_time", "n", "order"];

pub(crate) async fn run(session: &Session, args: GridChangedArgs) -> anyhow::Result<ExitCode> {
    let (grid, observed) = grid_of(session, &args.map).await?;
    let region = match (&args.region, &args.z) {
        (None, None) => None,
        // Nothing has changed yet, wherever.
        _ if observed == 0 => None,
        _ => Some(place::region_of(&session.client.map(&args.map).await?, args.region, args.z)?),
    };
    let mut alarms = session.client.cell_alarms(&args.map, region).await?;
    let mut table = session.table(&COLUMNS);
    let mut count = 0_u64;
    while let Some(cells) = alarms.next().await? {
        for alarm in cells {
            let index: [i32; 3] = alarm.cell.into();
            let [x, y, z] = std::array::from_fn(|axis| {
                // To a micrometre: the last digits of a product are rounding.
                let metres = grid.origin_m[axis] + (f64::from(index[axis]) + 0.5) * grid.resolution_m;
                Cell::from((metres * 1e6).round() / 1e6)
            });
            table.row(vec![
                Cell::Text(alarm.cell.name()),
                x,
                y,
                z,
                Cell::Text(alarm.change_date),
                alarm.mean.into(),
                Cell::maybe(alarm.last.map(|(_, value)| value)),
                Cell::time(alarm.last.map(|(nanos, _)| nanos)),
                alarm.learned_observations.into(),
                alarm.order.into(),
            ])?;
            count += 1;
        }
    }
    table.finish()?;
    if session.format == Format::Table {
        let part = if region.is_some() { " in this part" } else { "" };
        let routines = match count {
            0 => "the routine of no cell seems".to_owned(),
            1 => "the routine of 1 cell seems".to_owned(),
            _ => format!("the routines of {count} cells seem"),
        };
        let since = if count == 0 { "" } else { ": predictions have been worse since about that date" };
        status_line(&format!("{routines} to have changed{part}{since}"));
    }
    Ok(ExitCode::SUCCESS)
}

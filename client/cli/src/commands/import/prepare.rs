//! The map of an import: as it is, or created.
//!
//! Invariant: a map is created once, with a grid if the recording has scans, clouds or grids. Observations that a map
//! cannot take are reported before anything is sent.

use tidemap_client::maps::{GridSpec, Map, NewMap, OrderCriterion, StateKind, StateShape};
use tidemap_model::{RowKind, StatedReporting};
use tidemap_recordings::{
    convert::CellSize,
    mapping::{Reports, StateRule, ValueKind, ValueRule},
};
use tonic::Code;

use super::{ImportArgs, Planned};
use crate::{
    commands::{Session, map::grid_spec::GridArg, map::with_grid, predict::names, usage},
    progress::status_line,
};

/// Times before this come from a simulation or a clock that is not set: 1990, nanoseconds since 1970.
const REAL_FROM_NANOS: i64 = 631_152_000 * 1_000_000_000;
/// Edge of a cell of a new map, metres.
const RESOLUTION_M: f64 = 0.1;

/// The data of the map that an import needs.
pub(super) struct Prepared {
    /// The grid; absent if the map has none.
    pub(super) grid: Option<GridSpec>,
    pub(super) states: NewStates,
}

impl Prepared {
    /// Finds the map, or creates it.
    pub(super) async fn map(session: &Session, args: &ImportArgs, planned: &Planned) -> anyhow::Result<Self> {
        let map = match session.client.map(&args.map).await {
            Ok(map) => {
                if args.grid.is_some() || args.time_zone.is_some() {
                    return Err(usage(format!(
                        "map {:?} exists: --grid and --time-zone are for a new map; leave them out",
                        args.map
                    )));
                }
                report_conflicts(&map, planned);
                map
            }
            Err(error) if error.code() == Some(Code::NotFound) => create(session, args, planned).await?,
            Err(error) => return Err(error.into()),
        };
        let known = names::states(session, &args.map).await?.into_iter().map(|state| state.name).collect();
        let client = session.client.clone();
        Ok(Self { grid: map.grid, states: NewStates { client, map: args.map.clone(), known } })
    }

    /// The cells in which points of clouds are merged.
    pub(super) fn cells(&self) -> Option<CellSize> {
        self.grid.as_ref().map(|grid| CellSize { resolution_m: grid.resolution_m, origin_m: grid.origin_m })
    }
}

fn has_grid_use(planned: &Planned) -> bool {
    planned.plan.topics.iter().any(|plan| plan.grid.is_some())
}

/// Reports the properties of an existing map that conflict with the recording.
fn report_conflicts(map: &Map, planned: &Planned) {
    match &map.grid {
        None if has_grid_use(planned) => status_line(&format!(
            "map {:?} has no grid, so scans, clouds and grids are refused: a new map gets one",
            map.name
        )),
        Some(grid) if planned.plan.frame.as_ref().is_some_and(|frame| *frame != grid.frame_id) => {
            let frame = planned.plan.frame.as_deref().unwrap_or_default();
            status_line(&format!(
                "the grid of map {:?} is in frame {:?}, and the recording is placed in {frame:?}: they must be the same \
                 place",
                map.name, grid.frame_id
            ));
        }
        _ => {}
    }
}

async fn create(session: &Session, args: &ImportArgs, planned: &Planned) -> anyhow::Result<Map> {
    let has_grid = has_grid_use(planned);
    let frame_id = planned.plan.frame.clone().unwrap_or_else(|| GridSpec::new(RESOLUTION_M).frame_id);
    let grid = match (&args.grid, has_grid) {
        (Some(GridArg(grid)), _) => Some(GridSpec { frame_id, ..grid.clone() }),
        (None, false) => None,
        (None, true) => {
            let is_flat = planned.plan.is_level(&planned.surveyed);
            // Grids alone keep their cells.
            let (resolution_m, [x, y]) = planned.plan.cells(&planned.surveyed).unwrap_or((RESOLUTION_M, [0.0; 2]));
            Some(GridSpec { is_flat, frame_id, origin_m: [x, y, 0.0], ..GridSpec::new(resolution_m) })
        }
    };
    let is_simulated = first_nanos(planned).is_some_and(|first| first < REAL_FROM_NANOS);
    let made = session
        .client
        .create_map(NewMap {
            name: args.map.clone(),
            time_zone: args.time_zone.clone(),
            periodicities: None,
            order_criterion: OrderCriterion::SquaredError,
            retention: None,
            grid,
            half_life_nanos: None,
            prior: None,
            models: None,
            has_real_clock: !is_simulated,
        })
        .await?;
    let made = with_grid(made, has_grid || args.grid.is_some())?;
    let cells = match &made.grid {
        None => "without a grid".to_owned(),
        Some(grid) if grid.is_flat => format!("with a flat grid of {} m", grid.resolution_m),
        Some(grid) => format!("with a grid of {} m", grid.resolution_m),
    };
    status_line(&format!("map {:?} is created {cells}, time zone {}", made.name, made.time_zone));
    if is_simulated {
        status_line(
            "its times begin before 1990, so it takes the times of a simulation; --times recorder takes those of \
                     the recorder",
        );
    }
    Ok(made)
}

/// The first time of the observations, by the chosen clock.
fn first_nanos(planned: &Planned) -> Option<i64> {
    let topics = planned.surveyed.topics.iter().zip(&planned.plan.topics);
    let observed = topics.filter(|(_, plan)| plan.is_observed());
    observed
        .filter_map(|(topic, _)| {
            let stamps = topic.stamps.filter(|stamps| stamps.first_nanos > 0 && !planned.by_recorder);
            stamps.or(topic.recorded).map(|span| span.first_nanos)
        })
        .min()
}

/// Adds states before their first observation, if they are to be of another kind than a probability that is sampled.
pub(super) struct NewStates {
    client: tidemap_client::Client,
    map: String,
    known: std::collections::HashSet<String>,
}

impl NewStates {
    /// Adds a state unless it is known.
    pub(super) async fn add(&mut self, state: &str, rule: &StateRule) -> anyhow::Result<()> {
        let is_usual = rule.kind == ValueKind::Probability && rule.reports == Reports::Samples;
        if is_usual || self.known.contains(state) {
            return Ok(());
        }
        self.known.insert(state.to_owned());
        let shape = match rule.kind {
            ValueKind::Probability => StateShape::from(StateKind::Probability),
            ValueKind::Continuous => StateKind::Continuous.into(),
            ValueKind::Count => StateKind::Count.into(),
            ValueKind::Angle => StateShape::Angle,
            ValueKind::Categorical => {
                let ValueRule::Table(table) = &rule.value else {
                    anyhow::bail!(
                        "state {state:?} is categorical and does not exist: give its labels as values: in the mapping, \
                         or add it with tidemap state add {} {state} --kind categorical --labels …",
                        self.map
                    );
                };
                let mut labels: Vec<String> = table.values().cloned().collect();
                labels.sort_unstable();
                labels.dedup();
                self.client.add_categorical(&self.map, state, &labels).await?;
                return Ok(());
            }
        };
        let reporting = match rule.reports {
            Reports::Samples => None,
            Reports::Changes => Some(RowKind::Changes),
            Reports::Events => Some(RowKind::Events),
        };
        let reporting = reporting.map(|kind| StatedReporting::new(kind, None, None)).transpose()?;
        self.client.add_state(&self.map, state, shape, None, reporting).await?;
        Ok(())
    }
}

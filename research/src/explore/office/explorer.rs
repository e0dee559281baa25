//! An explorer: its map, its observations and its tours.
//!
//! If the prediction leaves too little information for a full tour, the explorer makes a round: it visits the cells
//! that it has not seen since the round started, and starts the next round when it has seen all. Spatial-only
//! exploration, whose last map is certain of all cells that it has seen, does little else once the office is known.
//! Invariant: an observation enters the map unchanged, with the time at which it was made.

use std::{
    collections::HashMap,
    sync::{Arc, atomic::AtomicU64},
};

use tidemap_grid::{
    index::{CellIndex, TILE_CELLS, TileIndex},
    log_head::{LogHead, StreamScan, StreamTiles},
    mask::{Mask, TileMasks},
    scan::{ScanSource, Scans},
};
use tidemap_map::{
    event::{Envelope, Event, SequenceSpan, UpdateCause},
    ids::{NewProducer, ProducerId},
    live_map::LiveMap,
    name::ProducerKey,
    reachability::Reachability,
    view::MapView,
};
use tidemap_model::{
    StopSignal,
    selector::{Blend, ModelKind, ModelSelector},
};
use tidemap_plan::{
    predicted::{PredictOptions, PredictedGrid},
    tour::{START_TOLERANCE_M, Tour, TourQuestion, TourStep, plan_tour},
    travel::TravelGrid,
    view::ViewScorer,
};

use super::{
    OfficeError,
    space::{Space, Truth},
};

/// Maximum number of tiles of a map.
const TILES_MAX: usize = 1 << 20;
/// Distance from 0.5 of the probability of cells not seen in this round: almost unknown, on the side of the last value.
const UNSURE: f32 = 0.01;

/// The method by which an explorer predicts and schedules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExplorerKind {
    /// By the last map, at regular times.
    Spatial,
    /// By the spatio-temporal model, in the slots with the most expected information.
    Temporal,
    /// The schedule of [`Temporal`](Self::Temporal), with predictions blended with the last observation.
    TemporalPersistence,
}

impl ExplorerKind {
    /// All kinds, the baseline first.
    pub const ALL: [ExplorerKind; 3] =
        [ExplorerKind::Spatial, ExplorerKind::Temporal, ExplorerKind::TemporalPersistence];

    /// The name of the explorer in results.
    pub fn name(self) -> &'static str {
        match self {
            ExplorerKind::Spatial => "spatial",
            ExplorerKind::Temporal => "spatio-temporal",
            ExplorerKind::TemporalPersistence => "spatio-temporal+persistence",
        }
    }

    fn selector(self) -> ModelSelector {
        let (kind, blend) = match self {
            ExplorerKind::Spatial => (ModelKind::Latest, Blend::None),
            ExplorerKind::Temporal => (ModelKind::Auto, Blend::None),
            ExplorerKind::TemporalPersistence => (ModelKind::Auto, Blend::Persistence),
        };
        ModelSelector { kind, order: None, blend }
    }
}

/// The last observation of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LastValue {
    Never,
    Free,
    Occupied,
}

/// The result of a tour.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Findings {
    /// Number of observations.
    pub scans: u64,
    /// Number of changed cells.
    pub changes: u64,
    /// Number of cells seen for the first time.
    pub discovered: u64,
}

/// An explorer with its map.
pub(super) struct Explorer {
    /// The method by which the explorer predicts and schedules.
    pub kind: ExplorerKind,
    map: LiveMap,
    view: MapView,
    front: LogHead,
    source: StreamTiles,
    /// The tiles of the explorer's stream: the slot of each tile, and the last content that it showed of it.
    slots: HashMap<TileIndex, u32>,
    shown: Vec<TileMasks>,
    scans: u64,
    reachability: Reachability,
    last: Vec<LastValue>,
    /// Whether each cell was seen since the round started.
    round: Vec<bool>,
    scorer: ViewScorer,
}

impl Explorer {
    /// An explorer with an untrained map.
    pub(super) fn new(kind: ExplorerKind, space: &Space) -> Result<Self, OfficeError> {
        let mut map = LiveMap::new(Arc::clone(space.spec()));
        let grid = map.grid().ok_or_else(|| OfficeError::setting("the map has no grid"))?;
        let front = LogHead::new(grid);
        let view = map.publish();
        Ok(Self {
            kind,
            map,
            view,
            front,
            source: StreamTiles::default(),
            slots: HashMap::new(),
            shown: Vec::new(),
            scans: 0,
            reachability: Reachability::default(),
            last: vec![LastValue::Never; space.cells()],
            round: vec![false; space.cells()],
            scorer: ViewScorer::new(&space.fan),
        })
    }

    /// Whether the explorer has seen the cell with this number.
    pub(super) fn has_seen(&self, cell: usize) -> bool {
        self.last[cell] != LastValue::Never
    }

    /// The prediction of the explorer for all cells at a time, nanoseconds UTC.
    pub(super) fn predict(&self, utc_nanos: i64) -> Result<PredictedGrid, OfficeError> {
        self.predict_by(self.kind, utc_nanos)
    }

    fn predict_by(&self, kind: ExplorerKind, utc_nanos: i64) -> Result<PredictedGrid, OfficeError> {
        let options = PredictOptions { selector: kind.selector(), ..PredictOptions::default() };
        Ok(PredictedGrid::new(&self.view, utc_nanos, &options, StopSignal::NEVER)?)
    }

    /// The best tour at a time, planned on the prediction for that time.
    pub(super) fn best_tour(&self, space: &Space, utc_nanos: i64) -> Result<Tour, OfficeError> {
        Ok(plan_tour(&self.predict(utc_nanos)?, &self.reachability, &space.question, StopSignal::NEVER)?)
    }

    /// Goes on a tour that starts at a time, planned by the prediction of `kind` for `middle_nanos`.
    pub(super) fn tour(
        &mut self,
        space: &Space,
        kind: ExplorerKind,
        start_nanos: i64,
        middle_nanos: i64,
    ) -> Result<Findings, OfficeError> {
        let mut findings = Findings::default();
        if self.scans == 0 {
            // No goal can be planned on an empty map, so the first observation is made at the charger.
            let charger = self.charger(space)?;
            self.observe(space, &space.truth(start_nanos)?, charger, start_nanos, &mut findings)?;
        }
        let steps = self.plan(space, kind, middle_nanos)?;
        let truth = space.truth(start_nanos)?;
        let travel = TravelGrid::new(&truth.grid, &space.question.travel).map_err(OfficeError::setting)?;
        let [x_m, y_m] = space.question.start_m;
        let Some((start, _)) = travel.nearest(x_m, y_m, START_TOLERANCE_M) else { return Ok(findings) };
        let paths = travel.distances(start);
        for (index, step) in steps.iter().enumerate() {
            let [x_m, y_m] = step.at_m;
            // Two minutes for each goal (RA-L, section III.E).
            let at_nanos = start_nanos + (index as i64 + 1) * 120_000_000_000;
            let is_reachable = travel.column_at(x_m, y_m).is_some_and(|column| paths.to(column).is_some());
            let cell = space.lattice().cell_at([x_m, y_m, space.question.sensor.height_m]);
            let truth = space.truth(at_nanos)?;
            let goal = cell.filter(|&cell| is_reachable && !truth.scene.is_occupied(cell));
            // Goals lie within the grid, so that they can be reported.
            let reported = self.reachability.report(x_m, y_m, goal.is_some(), at_nanos);
            reported.map_err(OfficeError::setting)?;
            if let Some(goal) = goal {
                self.observe(space, &truth, goal, at_nanos, &mut findings)?;
            }
        }
        self.view = self.map.publish();
        Ok(findings)
    }

    fn charger(&self, space: &Space) -> Result<CellIndex, OfficeError> {
        let [x_m, y_m] = space.question.start_m;
        let cell = space.lattice().cell_at([x_m, y_m, space.question.sensor.height_m]);
        cell.ok_or_else(|| OfficeError::setting("the charger lies outside the office"))
    }

    /// Goals for a time: by its prediction, then cells not seen in this round.
    fn plan(&mut self, space: &Space, kind: ExplorerKind, utc_nanos: i64) -> Result<Vec<TourStep>, OfficeError> {
        self.view = self.map.publish();
        let expected = self.predict_by(kind, utc_nanos)?;
        let mut steps = plan_tour(&expected, &self.reachability, &space.question, StopSignal::NEVER)?.steps;
        for _ in 0..2 {
            let goals = space.question.goals.saturating_sub(steps.len());
            if goals == 0 {
                break;
            }
            let unsure = self.unseen_this_round(space);
            let more =
                plan_tour(&unsure, &self.reachability, &TourQuestion { goals, ..space.question }, StopSignal::NEVER)?
                    .steps;
            if more.len() < goals {
                self.round.fill(false);
            }
            steps.extend(more);
        }
        Ok(steps)
    }

    /// The last map, almost unknown where a cell was not seen since the round started.
    fn unseen_this_round(&self, space: &Space) -> PredictedGrid {
        PredictedGrid::from_fn(Arc::clone(space.lattice()), |cell| {
            let number = space.number(cell);
            let (is_occupied, is_seen) = match self.last[number] {
                LastValue::Never => return None,
                LastValue::Free => (false, self.round[number]),
                LastValue::Occupied => (true, self.round[number]),
            };
            Some(match (is_occupied, is_seen) {
                (false, true) => 0.0,
                (false, false) => 0.5 - UNSURE,
                (true, false) => 0.5 + UNSURE,
                (true, true) => 1.0,
            })
        })
    }

    /// Observes the cells visible from a cell, and adds them to the map.
    fn observe(
        &mut self,
        space: &Space,
        truth: &Truth,
        from: CellIndex,
        utc_nanos: i64,
        findings: &mut Findings,
    ) -> Result<(), OfficeError> {
        let mut tiles: HashMap<TileIndex, (Mask, Mask)> = HashMap::new();
        for cell in self.scorer.cells(&truth.scene, &space.fan, from) {
            let number = space.number(cell);
            let now = if truth.is_occupied(number) { LastValue::Occupied } else { LastValue::Free };
            let before = std::mem::replace(&mut self.last[number], now);
            findings.discovered += u64::from(before == LastValue::Never);
            findings.changes += u64::from(before != LastValue::Never && before != now);
            self.round[number] = true;
            let (tile, place) = cell.tile();
            let (observed, occupied) = tiles.entry(tile).or_insert((Mask::EMPTY, Mask::EMPTY));
            observed.insert(place);
            if now == LastValue::Occupied {
                occupied.insert(place);
            }
        }
        findings.scans += 1;
        let mut tiles: Vec<(TileIndex, TileMasks)> = tiles
            .into_iter()
            .map(|(tile, (observed, occupied))| (tile, TileMasks::clipped(observed, occupied)))
            .collect();
        tiles.sort_unstable_by_key(|&(tile, _)| tile);
        self.add_scan(utc_nanos, &tiles)
    }

    /// Adds an observation to the map as a scan.
    fn add_scan(&mut self, utc_nanos: i64, tiles: &[(TileIndex, TileMasks)]) -> Result<(), OfficeError> {
        let mut sent: Vec<(u32, TileMasks)> = Vec::with_capacity(tiles.len());
        for &(tile, masks) in tiles {
            let slot = *self.slots.entry(tile).or_insert_with(|| {
                self.source.push(tile);
                self.shown.push(TileMasks::default());
                self.shown.len() as u32 - 1
            });
            sent.push((slot, masks));
        }
        sent.sort_unstable_by_key(|&(slot, _)| slot);
        let seen: Arc<[u32]> = sent.iter().map(|&(slot, _)| slot).collect();
        let (mut observed_flips, mut occupied_flips) = (Vec::new(), Vec::new());
        for (slot, masks) in sent {
            let shown = std::mem::replace(&mut self.shown[slot as usize], masks);
            let at = |cell: u16| slot * TILE_CELLS as u32 + u32::from(cell);
            observed_flips.extend((shown.observed() ^ masks.observed()).cells().map(at));
            occupied_flips.extend((shown.occupied() ^ masks.occupied()).cells().map(at));
        }
        let scan = StreamScan { utc_nanos, source: ScanSource::Cells, seen, observed_flips, occupied_flips };
        let grid = self.map.grid().ok_or_else(|| OfficeError::setting("the map has no grid"))?;
        let taken = self.front.take(grid, 1, &mut self.source, &scan, 0, TILES_MAX);
        let taken = taken.map_err(|_| OfficeError::setting("the office has too many tiles"))?;
        let new_producer = (self.scans == 0)
            .then(|| ProducerKey::new("robot", "").map(NewProducer::from))
            .transpose()
            .map_err(OfficeError::setting)?;
        self.scans += 1;
        let envelope = Envelope {
            producer: ProducerId(0),
            new_producer,
            incarnation: 1,
            span: SequenceSpan { first: self.scans, last: self.scans, content_crc: 0 },
            received_nanos: utc_nanos,
            refused: Vec::new(),
        };
        let scans = Scans { new_tiles: taken.new_tiles, scans: vec![taken.scan], ..Scans::default() };
        self.map.apply(self.map.position() + 1, &Event::Scans(envelope, scans))?;
        Ok(())
    }

    /// Learns all observations before a midnight.
    pub(super) fn midnight(&mut self, utc_nanos: i64) -> Result<(), OfficeError> {
        let start = self.map.plan_update(Some(utc_nanos), utc_nanos, UpdateCause::Midnight);
        if let Some(work) = self.map.apply(self.map.position() + 1, &Event::UpdateStart(start))? {
            self.map.finish_update(work.run(&AtomicU64::new(0))?);
        }
        self.view = self.map.publish();
        Ok(())
    }
}

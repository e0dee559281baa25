//! An explorer: its map, what it saw, and where it goes.
//!
//! Where the prediction leaves too little to learn for a full tour, the explorer goes round: it looks again at what it
//! has not seen since this round began, and begins the next round when all is seen. Spatial-only exploration, whose
//! last map is certain of all that it has seen, does little else once the office is known. Invariant: a cell is told to
//! the map as it was seen, at the time at which it was seen.

use std::{
    collections::HashMap,
    sync::{Arc, atomic::AtomicU64},
};

use tidemap_map::{
    event::{Event, UpdateCause},
    grid::{
        front::{Front, SentScan, StreamTiles},
        index::{CellIndex, TILE_CELLS, TileIndex},
        mask::{Mask, TileMasks},
        scan::Scans,
    },
    ids::{NewProducer, ProducerId},
    live_map::LiveMap,
    name::ProducerKey,
    reachability::Reachability,
    selector::{ModelKind, ModelSelector},
    view::MapView,
};
use tidemap_plan::{
    predicted::{PredictOptions, PredictedGrid},
    tour::{Tour, TourQuestion, TourStep, plan_tour},
    travel::TravelGrid,
    view::ViewScorer,
};

use super::{
    OfficeError,
    space::{Space, Truth},
};

/// Tiles of a map.
const TILES_MAX: usize = 1 << 20;
/// What a round takes a cell for that it has not seen: as unsure as can be, on the side of what was seen last.
const UNSURE: f32 = 0.01;

/// How an explorer expects, and when it goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExplorerKind {
    /// By the last map, at even distances of time.
    Spatial,
    /// By the spatio-temporal model, when much is to be learned.
    Temporal,
    /// The same, drawn towards what was seen last.
    TemporalPersistence,
}

impl ExplorerKind {
    /// All of them.
    pub const ALL: [ExplorerKind; 3] =
        [ExplorerKind::Spatial, ExplorerKind::Temporal, ExplorerKind::TemporalPersistence];

    /// As people write it.
    pub fn name(self) -> &'static str {
        match self {
            ExplorerKind::Spatial => "spatial",
            ExplorerKind::Temporal => "spatio-temporal",
            ExplorerKind::TemporalPersistence => "spatio-temporal+persistence",
        }
    }

    fn selector(self) -> ModelSelector {
        let (kind, persistence) = match self {
            ExplorerKind::Spatial => (ModelKind::Latest, false),
            ExplorerKind::Temporal => (ModelKind::Auto, false),
            ExplorerKind::TemporalPersistence => (ModelKind::Auto, true),
        };
        ModelSelector { kind, order: None, persistence }
    }
}

/// How a cell was seen last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Last {
    Never,
    Free,
    Occupied,
}

/// What an explorer learned on a tour.
#[derive(Clone, Copy, Debug, Default)]
pub struct Findings {
    /// Goals from which it looked.
    pub looks: u64,
    /// Cells that had changed.
    pub changes: u64,
    /// Cells never seen before.
    pub discovered: u64,
}

/// An explorer.
pub struct Explorer {
    /// What it goes by.
    pub kind: ExplorerKind,
    map: LiveMap,
    view: MapView,
    front: Front,
    source: StreamTiles,
    /// Its stream's tiles: slot of each, and what it showed of it.
    slots: HashMap<TileIndex, u32>,
    shown: Vec<TileMasks>,
    scans: u64,
    reachability: Reachability,
    last: Vec<Last>,
    /// By cell, whether it was seen since the round began.
    round: Vec<bool>,
    looker: ViewScorer,
}

impl Explorer {
    /// One that knows nothing.
    pub fn new(kind: ExplorerKind, space: &Space) -> Result<Self, OfficeError> {
        let mut map = LiveMap::new(Arc::clone(space.spec()));
        let grid = map.grid().ok_or_else(|| OfficeError::Setting("the map has no grid".to_owned()))?;
        let front = Front::new(grid);
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
            last: vec![Last::Never; space.cells()],
            round: vec![false; space.cells()],
            looker: ViewScorer::new(&space.fan),
        })
    }

    /// Whether it has seen a cell, by its number.
    pub fn has_seen(&self, cell: usize) -> bool {
        self.last[cell] != Last::Never
    }

    /// What it expects of all cells at a time, nanoseconds UTC.
    pub fn predict(&self, utc_nanos: i64) -> Result<PredictedGrid, OfficeError> {
        self.predict_by(self.kind, utc_nanos)
    }

    fn predict_by(&self, kind: ExplorerKind, utc_nanos: i64) -> Result<PredictedGrid, OfficeError> {
        let options = PredictOptions { selector: kind.selector(), ..PredictOptions::default() };
        Ok(PredictedGrid::new(&self.view, utc_nanos, &options)?)
    }

    /// The tour that promises most at a time, on what is expected of that time.
    pub fn promise(&self, space: &Space, utc_nanos: i64) -> Result<Tour, OfficeError> {
        Ok(plan_tour(&self.predict(utc_nanos)?, &self.reachability, &space.question)?)
    }

    /// Goes on a tour that begins at a time; `kind` is what is planned by, `middle_nanos` the time that is predicted.
    pub fn tour(
        &mut self,
        space: &Space,
        kind: ExplorerKind,
        start_nanos: i64,
        middle_nanos: i64,
    ) -> Result<Findings, OfficeError> {
        let mut findings = Findings::default();
        if self.scans == 0 {
            // Nobody can be sent anywhere before anything is known: a look from the charger.
            let charger = self.charger(space)?;
            self.look(space, &space.truth(start_nanos)?, charger, start_nanos, &mut findings)?;
        }
        let steps = self.plan(space, kind, middle_nanos)?;
        let truth = space.truth(start_nanos)?;
        let setting = |error: &dyn std::fmt::Display| OfficeError::Setting(error.to_string());
        let travel = TravelGrid::new(&truth.grid, &space.question.travel).map_err(|error| setting(&error))?;
        let [x_m, y_m] = space.question.start_m;
        let Some((start, _)) = travel.nearest(x_m, y_m, space.question.start_tolerance_m) else { return Ok(findings) };
        let ways = travel.distances(start);
        for (index, step) in steps.iter().enumerate() {
            // Two minutes for each goal (RA-L, section III.E).
            let at_nanos = start_nanos + (index as i64 + 1) * 120_000_000_000;
            let is_way = travel.column_at(step.x_m, step.y_m).is_some_and(|column| ways.to(column).is_some());
            let cell = space.lattice().cell_at([step.x_m, step.y_m, space.question.sensor.height_m]);
            let truth = space.truth(at_nanos)?;
            let goal = cell.filter(|&cell| is_way && !truth.scene.is_occupied(cell));
            // Goals lie within the grid, so that they can be reported.
            let reported = self.reachability.report(step.x_m, step.y_m, goal.is_some(), at_nanos);
            reported.map_err(|error| setting(&error))?;
            if let Some(goal) = goal {
                self.look(space, &truth, goal, at_nanos, &mut findings)?;
            }
        }
        self.view = self.map.publish();
        Ok(findings)
    }

    fn charger(&self, space: &Space) -> Result<CellIndex, OfficeError> {
        let [x_m, y_m] = space.question.start_m;
        let cell = space.lattice().cell_at([x_m, y_m, space.question.sensor.height_m]);
        cell.ok_or_else(|| OfficeError::Setting("the charger lies outside the office".to_owned()))
    }

    /// Goals for a time: by what is expected of it, then by going round.
    fn plan(&mut self, space: &Space, kind: ExplorerKind, utc_nanos: i64) -> Result<Vec<TourStep>, OfficeError> {
        self.view = self.map.publish();
        let expected = self.predict_by(kind, utc_nanos)?;
        let mut steps = plan_tour(&expected, &self.reachability, &space.question)?.steps;
        for _ in 0..2 {
            let goals = space.question.goals.saturating_sub(steps.len());
            if goals == 0 {
                break;
            }
            let unsure = self.unseen_this_round(space);
            let more = plan_tour(&unsure, &self.reachability, &TourQuestion { goals, ..space.question })?.steps;
            if more.len() < goals {
                self.round.fill(false);
            }
            steps.extend(more);
        }
        Ok(steps)
    }

    /// The last map, unsure of what was not seen since the round began.
    fn unseen_this_round(&self, space: &Space) -> PredictedGrid {
        PredictedGrid::from_fn(Arc::clone(space.lattice()), |cell| {
            let number = space.number(cell);
            let (is_occupied, is_seen) = match self.last[number] {
                Last::Never => return None,
                Last::Free => (false, self.round[number]),
                Last::Occupied => (true, self.round[number]),
            };
            Some(match (is_occupied, is_seen) {
                (false, true) => 0.0,
                (false, false) => 0.5 - UNSURE,
                (true, false) => 0.5 + UNSURE,
                (true, true) => 1.0,
            })
        })
    }

    /// Looks around from a cell, and tells the map.
    fn look(
        &mut self,
        space: &Space,
        truth: &Truth,
        from: CellIndex,
        utc_nanos: i64,
        findings: &mut Findings,
    ) -> Result<(), OfficeError> {
        let mut tiles: HashMap<TileIndex, (Mask, Mask)> = HashMap::new();
        for cell in self.looker.cells(&truth.scene, &space.fan, from) {
            let number = space.number(cell);
            let now = if truth.is_occupied(number) { Last::Occupied } else { Last::Free };
            let before = std::mem::replace(&mut self.last[number], now);
            findings.discovered += u64::from(before == Last::Never);
            findings.changes += u64::from(before != Last::Never && before != now);
            self.round[number] = true;
            let (tile, place) = cell.tile();
            let (observed, occupied) = tiles.entry(tile).or_insert((Mask::EMPTY, Mask::EMPTY));
            observed.insert(place);
            if now == Last::Occupied {
                occupied.insert(place);
            }
        }
        findings.looks += 1;
        let mut tiles: Vec<(TileIndex, TileMasks)> = tiles
            .into_iter()
            .map(|(tile, (observed, occupied))| (tile, TileMasks::clipped(observed, occupied)))
            .collect();
        tiles.sort_unstable_by_key(|&(tile, _)| tile);
        self.tell(utc_nanos, &tiles)
    }

    /// Tells the map what a look showed.
    fn tell(&mut self, utc_nanos: i64, tiles: &[(TileIndex, TileMasks)]) -> Result<(), OfficeError> {
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
        let scan = SentScan { utc_nanos, seen, observed_flips, occupied_flips };
        let setting = |why: &str| OfficeError::Setting(why.to_owned());
        let grid = self.map.grid().ok_or_else(|| setting("the map has no grid"))?;
        let taken = self.front.take(grid, 1, &mut self.source, &scan, 0, TILES_MAX);
        let taken = taken.map_err(|_| setting("the office has too many tiles"))?;
        let new_producer = (self.scans == 0)
            .then(|| ProducerKey::new("robot", "").map(NewProducer::from))
            .transpose()
            .map_err(|error| setting(&error.to_string()))?;
        self.scans += 1;
        let scans = Scans {
            producer: ProducerId(0),
            new_producer,
            incarnation: 1,
            first_sequence: self.scans,
            last_sequence: self.scans,
            content_crc: 0,
            received_nanos: utc_nanos,
            new_tiles: taken.new_tiles,
            scans: vec![taken.scan],
            refused: Vec::new(),
        };
        self.map.apply(self.map.position() + 1, &Event::Scans(scans))?;
        Ok(())
    }

    /// Folds in what was seen before a midnight.
    pub fn midnight(&mut self, utc_nanos: i64) -> Result<(), OfficeError> {
        let start = self.map.plan_update(Some(utc_nanos), utc_nanos, UpdateCause::Midnight);
        if let Some(work) = self.map.apply(self.map.position() + 1, &Event::UpdateStart(start))? {
            self.map.finish_update(work.run(&AtomicU64::new(0))?);
        }
        self.view = self.map.publish();
        Ok(())
    }
}

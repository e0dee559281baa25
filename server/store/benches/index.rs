//! The index at 100,000 dense states and at 213,000 cells, of which 15,000 change: bytes, and seconds to write and
//! read.
//!
//! Seconds of a save are those of checkpoint and index together. A save of what is there already writes the checkpoint
//! alone, so that the difference is the index.

use std::{fs, path::Path, sync::Arc, time::Instant};

use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_grid::{
    index::TileIndex,
    live_tile::LiveTile,
    mask::Mask,
    snapshot::GridSnapshot,
    spec::GridSpec,
    tile::{CellModel, Group, ModelSlot, SumsSlot, TileModel, TileSums},
};
use tidemap_map::{
    event::StateKind,
    name::{MapName, StateName},
    snapshot::{MapSnapshot, StateSnapshot},
    spec::MapSpec,
};
use tidemap_model::{
    Component, OrderErrors, OrderWatch, Periodicities, Persistence, PersistenceParts, PhasorSum, Recent, Sample,
    SpectralModel, StateModel,
};
use tidemap_store::{IndexContents, Store, StoreOptions};

const STATES: usize = 100_000;
const TILES: i32 = 417;
const CHANGING: u16 = 36;
const START_NANOS: i64 = 1_700_006_400_000_000_000;
const HALF_HOUR_NANOS: i64 = 1_800_000_000_000;

fn spec(grid: Option<GridSpec>) -> MapSpec {
    MapSpec {
        periodicities: Periodicities::harmonics(604_800_000_000_000, 168).expect("valid"),
        grid,
        ..MapSpec::new(MapName::new("bench").expect("valid"))
    }
}

fn snapshot(states: Vec<StateSnapshot>, grid: Option<GridSnapshot>) -> MapSnapshot {
    MapSnapshot {
        position: 0,
        replay_from: 1,
        generation: 1,
        cut_nanos: START_NANOS,
        newest_nanos: START_NANOS,
        producers: Vec::new(),
        states,
        site: Arc::default(),
        grid,
        history: Vec::new(),
    }
}

/// States with 48 readings a day on 14 days.
fn states(spec: &MapSpec, seed: u64) -> Vec<StateSnapshot> {
    let mut random = SmallRng::seed_from_u64(seed);
    let models: Vec<Arc<StateModel>> = (0..200)
        .map(|_| {
            let sample = |slot: i64| Sample {
                utc_nanos: START_NANOS + slot * HALF_HOUR_NANOS,
                offset_secs: 0,
                value: f64::from(u8::from(random.random_bool(if (16..36).contains(&(slot % 48)) { 0.8 } else { 0.1 }))),
            };
            let mut model = StateModel::new(&spec.periodicities);
            model.update(&spec.periodicities, spec.update_rules(), (0..14 * 48).map(sample).collect());
            Arc::new(model)
        })
        .collect();
    let parts = PersistenceParts { pairs: 671, change_rate_sum: 0.25, last: Some((START_NANOS, 1.0)) };
    let persistence = Persistence::from_parts(parts).expect("valid");
    let state = |id: usize| StateSnapshot {
        name: StateName::new(&format!("door {id}")).expect("valid"),
        kind: StateKind::Probability,
        observations: 672,
        persistence,
        recent: Recent::default(),
        newest_row: None,
        model: Arc::clone(&models[id % models.len()]),
    };
    (0..STATES).map(state).collect()
}

fn grid(spec: &MapSpec, seed: u64) -> GridSnapshot {
    let mut random = SmallRng::seed_from_u64(seed);
    let mut sum = || {
        let numbers: Vec<f64> = (0..2 * spec.periodicities.len()).map(|_| random.random()).collect();
        PhasorSum::from_slice(&spec.periodicities, &numbers).expect("valid")
    };
    let (mut models, mut sums) = (Vec::new(), Vec::new());
    for _ in 0..TILES {
        let cells = (0..CHANGING).map(|_| sum()).collect();
        let (times, watches) = (vec![Arc::default()], vec![OrderWatch::default(); CHANGING as usize]);
        sums.push(TileSums { groups: vec![Arc::new(sum())], cells, times, watches, ..TileSums::default() });
    }
    for _ in 0..TILES {
        let group = Group {
            cells: Mask([u64::MAX; 8]),
            observations: 17_200,
            first_nanos: 1,
            last_nanos: START_NANOS,
            ..Group::default()
        };
        let mut cell = |cell: u16| {
            let component =
                |periodicity| Component { periodicity, gamma_re: random.random(), gamma_im: random.random() };
            let components = (0..15).map(component).collect();
            CellModel {
                cell: cell * 7,
                occupied: 8_600,
                spectral: SpectralModel::from_parts(0.5, 17_200, components).expect("valid"),
                order: 2,
                errors: OrderErrors::default(),
                alarm_day: None,
            }
        };
        let cells = (0..CHANGING).map(&mut cell).collect();
        models.push(TileModel { groups: vec![group], always_occupied: Mask::EMPTY, cells, sensors: None });
    }
    let tile = |number: i32| Arc::new(LiveTile::new(TileIndex { x: number % 20, y: number / 20, z: 0 }));
    GridSnapshot {
        tiles: (0..TILES).map(tile).collect(),
        models: models.into_iter().map(|model| ModelSlot::Resident(Arc::new(model))).collect(),
        sums: sums.into_iter().map(|sums| SumsSlot::Resident(Arc::new(sums))).collect(),
        last_seen: Arc::default(),
        days: Vec::new(),
        future: Vec::new(),
        scans: 17_200,
        cell_observations: 17_200 * 213_504,
        shown: tidemap_grid::index::CellBox::default(),
        received_nanos: None,
    }
}

fn peak() -> String {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or("unknown").trim().to_owned()
}

fn measure(what: &str, directory: &Path, spec: &MapSpec, saves: [MapSnapshot; 2]) {
    let options = || StoreOptions { new_store_id: "00".repeat(16), ..StoreOptions::default() };
    let store = Store::open(directory, options()).expect("opens");
    let map = store.create_map(spec).expect("creates");
    drop(store.open_map(map, spec).expect("opens"));
    let save = |what_save: &str, snapshot: &MapSnapshot| {
        let start = Instant::now();
        store.save(map, snapshot).expect("saves");
        println!("{what}: {what_save}: {:.3} s", start.elapsed().as_secs_f64());
    };
    println!("{what}: peak before {}", peak());
    save("first save", &saves[0]);
    println!("{what}: peak after the first save {}", peak());
    for _ in 0..3 {
        save("save of another generation", &saves[1]);
        save("the same again", &saves[1]);
        save("save of another generation", &saves[0]);
        save("the same again", &saves[0]);
    }
    println!("{what}: peak after all saves {}", peak());
    drop((saves, store));
    let start = Instant::now();
    let store = Store::open(directory, options()).expect("opens");
    let opened = start.elapsed().as_secs_f64();
    let published = store.published(map, spec).expect("whole");
    println!("{what}: store opened after {opened:.3} s, rows read after {:.3} s", start.elapsed().as_secs_f64());
    drop((published, store));
    let contents = IndexContents::open(directory, 64 << 20).expect("opens");
    println!("{what}: {:?}, {} bytes on the disk", contents.maps[0].2, contents.disk_bytes);
}

fn main() {
    let directory = tempfile::tempdir().expect("temporary directory");
    let of_grid = spec(Some(GridSpec::new(0.1)));
    let saves = [1, 2].map(|seed| snapshot(Vec::new(), Some(grid(&of_grid, seed))));
    measure("213,504 cells, 15,012 change", &directory.path().join("grid"), &of_grid, saves);
    let of_states = spec(None);
    let saves = [1, 2].map(|seed| snapshot(states(&of_states, seed), None));
    measure("100,000 states", &directory.path().join("states"), &of_states, saves);
}

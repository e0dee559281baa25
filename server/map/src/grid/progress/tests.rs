//! An update that is cut off anywhere and run again gives what it would have given, and does nothing twice.

use std::{
    collections::{HashMap, HashSet},
    sync::Mutex,
};

use proptest::prelude::*;

use super::*;
use crate::{
    event::{Event, UpdateCause},
    grid::{
        index::TileIndex,
        scan::{CellRef, LoggedScan, Scans},
        tests::world::{HOUR, World, spec},
        update::GridOutcome,
    },
    ids::ProducerId,
    live_map::LiveMap,
    name::ProducerKey,
    snapshot::MapSnapshot,
    update::UpdateWork,
};

/// A journal in memory, of a process that ends after so many notes.
#[derive(Default)]
struct Journal {
    /// What earlier runs have left.
    before: Vec<Vec<DoneTile>>,
    kept: Mutex<Vec<Vec<DoneTile>>>,
    end: usize,
}

impl Journal {
    fn after(before: Vec<Vec<DoneTile>>, end: usize) -> Journal {
        Journal { before, kept: Mutex::default(), end }
    }

    fn into_notes(self) -> Vec<Vec<DoneTile>> {
        let mut notes = self.before;
        notes.extend(self.kept.into_inner().expect("not poisoned"));
        notes
    }
}

fn owned(note: &TileNote<'_>) -> DoneTile {
    let TileNote { tile, through, model, sums, outcome } = *note;
    DoneTile { tile, through, model: model.clone(), sums: sums.clone(), outcome: *outcome }
}

impl UpdateJournal for Journal {
    fn resume(&self) -> Vec<DoneTile> {
        let mut newest = HashMap::new();
        for tile in self.before.iter().flatten() {
            // A sum that comes back from a file is another one in memory, shared by those that come back with it.
            newest.insert(tile.tile, tile.clone());
        }
        let mut copies: HashMap<usize, Arc<PhasorSum>> = HashMap::new();
        let mut tiles: Vec<DoneTile> = newest.into_values().collect();
        for sum in tiles.iter_mut().flat_map(|tile| tile.sums.shared_mut()) {
            let copy = copies.entry(Arc::as_ptr(sum) as usize).or_insert_with(|| Arc::new(PhasorSum::clone(sum)));
            *sum = Arc::clone(copy);
        }
        tiles
    }

    fn note(&self, tiles: &[TileNote<'_>]) {
        let mut kept = self.kept.lock().expect("not poisoned");
        if kept.len() < self.end {
            kept.push(tiles.iter().map(owned).collect());
        }
    }
}

/// A map that has learned something, and its next update.
fn prepared(seed: u64, scans: usize) -> (World, UpdateWork) {
    let mut world = World::new(seed);
    let sent = world.draw_scans(scans);
    world.send_all(&sent[..scans / 3], 3);
    world.settle();
    world.send_all(&sent[scans / 3..], 3);
    let work = world.take_work();
    (world, work)
}

/// What an update gives, run with a journal.
fn run(seed: u64, scans: usize, journal: &Journal) -> (MapSnapshot, GridOutcome) {
    let (mut world, work) = prepared(seed, scans);
    let (progress, states) = (AtomicU64::new(0), work.states());
    let result = work.run_noting(&progress, journal, 0).expect("in memory");
    assert_eq!(progress.into_inner(), states, "seed {seed}");
    let outcome = *result.grid_outcome().expect("a grid");
    (world.map.finish_update(result), outcome)
}

/// How many different sums the groups of all tiles have.
fn sums(snapshot: &MapSnapshot) -> usize {
    let slots = snapshot.grid.iter().flat_map(|grid| &grid.sums);
    let sums: Vec<Arc<TileSums>> = slots.map(|slot| slot.get().expect("in memory")).collect();
    sums.iter().flat_map(|sums| sums.shared()).map(Arc::as_ptr).collect::<HashSet<_>>().len()
}

/// The days that were folded into each tile, in the order of the notes.
fn days(notes: &[Vec<DoneTile>]) -> HashMap<TileId, Vec<LocalDay>> {
    let mut days: HashMap<TileId, Vec<LocalDay>> = HashMap::new();
    for tile in notes.iter().flatten() {
        days.entry(tile.tile).or_default().push(tile.through);
    }
    days
}

fn config() -> ProptestConfig {
    let usual = ProptestConfig::default();
    ProptestConfig { cases: usual.cases / 16, max_shrink_iters: 100, ..usual }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn an_update_that_is_cut_off_anywhere_goes_on_as_if_it_had_not_been(seed in any::<u64>(), scans in 6_usize..36) {
        let (mut world, work) = prepared(seed, scans);
        let result = work.run(&AtomicU64::new(0)).expect("in memory");
        let outcome = *result.grid_outcome().expect("a grid");
        let expected = world.map.finish_update(result);
        let whole = Journal::after(Vec::new(), usize::MAX);
        prop_assert_eq!(&run(seed, scans, &whole), &(expected.clone(), outcome));
        let whole = whole.into_notes();
        for first in 0..=whole.len() {
            let mut notes = Vec::new();
            // Cut off a second time on the way from there to the end.
            for end in [first, (whole.len() - first) / 2, usize::MAX] {
                let journal = Journal::after(notes, end);
                let (found, of_found) = run(seed, scans, &journal);
                prop_assert_eq!(&found, &expected, "cut off after {} notes", first);
                prop_assert_eq!(of_found, outcome, "cut off after {} notes", first);
                prop_assert!(sums(&found) <= sums(&expected), "cut off after {} notes", first);
                notes = journal.into_notes();
            }
            prop_assert_eq!(days(&notes), days(&whole), "each day of each tile is done once");
        }
    }
}

/// Scans of one day of a fixed sensor that sees all cells of some tiles, and some of them change.
fn fixed_day(day: i64, tiles: u32) -> Event {
    let scan = |number: i64| LoggedScan {
        utc_nanos: (24 * day + number) * HOUR,
        offset_secs: 0,
        seen: Some((0..tiles).map(TileId).collect()),
        observed_flips: if (day, number) == (0, 0) { (0..tiles * 512).map(CellRef).collect() } else { Vec::new() },
        occupied_flips: (0..tiles).map(|tile| CellRef(tile * 512 + u32::try_from(number).expect("small"))).collect(),
    };
    let new_tiles = (0..i32::try_from(tiles).expect("few")).map(|x| TileIndex { x, y: 0, z: 0 });
    Event::Scans(Scans {
        producer: ProducerId(0),
        new_producer: (day == 0).then(|| ProducerKey::new("camera", "").expect("valid").into()),
        incarnation: 1,
        first_sequence: day.cast_unsigned() * 8 + 1,
        last_sequence: day.cast_unsigned() * 8 + 8,
        content_crc: 0,
        received_nanos: 24 * (day + 1) * HOUR,
        new_tiles: if day == 0 { new_tiles.collect() } else { Vec::new() },
        scans: (0..8).map(scan).collect(),
        refused: Vec::new(),
    })
}

#[test]
fn tiles_seen_alike_share_their_sums_across_batches() {
    let mut map = LiveMap::new(Arc::new(spec(&mut 1)));
    for day in 0..3 {
        map.apply(map.position() + 1, &fixed_day(day, 12)).expect("consistent");
        let start = map.plan_update(None, 24 * (day + 1) * HOUR, UpdateCause::Request);
        let work = map.apply(map.position() + 1, &Event::UpdateStart(start)).expect("consistent").expect("an update");
        let journal = Journal::after(Vec::new(), usize::MAX);
        let snapshot = map.finish_update(work.run_noting(&AtomicU64::new(0), &journal, 0).expect("in memory"));
        assert!(journal.into_notes().len() > 2, "one batch");
        assert_eq!((snapshot.grid.as_ref().map(|grid| grid.sums.len()), sums(&snapshot)), (Some(12), 1), "day {day}");
    }
}

#[test]
fn nothing_is_noted_before_there_is_enough_to_lose() {
    let note = |min_work| {
        let journal = Journal::after(Vec::new(), usize::MAX);
        let notes = Notes::new(Some(&journal), min_work);
        let mut tiles = vec![(TileId(3), BusyTile::default())];
        for day in 0..4 {
            notes.take(LocalDay(day), 50_000, &mut tiles);
        }
        days(&journal.into_notes()).remove(&TileId(3)).unwrap_or_default()
    };
    assert_eq!(note(0), [0, 1, 2, 3].map(LocalDay), "everything");
    assert_eq!(note(150_000), [2, 3].map(LocalDay), "a tile without cells counts as one");
    assert_eq!(note(200_001), []);
}

#[test]
fn a_tile_is_noted_when_that_saves_more_than_it_costs() {
    let mut account = Account { unnoted: 999, ..Account::default() };
    assert!(!account.is_due(500));
    account.unnoted = 1000;
    assert!(account.is_due(500));
    account.noted = 8008;
    assert!(!account.is_due(500), "not an eighth of what was noted before");
    account.unnoted = 1001;
    assert!(account.is_due(500));
}

#[test]
fn equal_sums_become_one() {
    let sum = |number: f64| {
        let periodicities = tidemap_model::Periodicities::list(vec![HOUR]).expect("valid");
        Arc::new(PhasorSum::from_slice(&periodicities, &[number, 1.0]).expect("finite"))
    };
    let (one, other) = (sum(2.0), sum(3.0));
    let tile = |groups: [&Arc<PhasorSum>; 2]| TileSums { groups: groups.map(Arc::clone).into(), ..TileSums::default() };
    let (copy, of_other) = (sum(2.0), sum(3.0));
    let unchanged = tile([&one, &one]);
    let mut tiles = [tile([&copy, &other]), tile([&of_other, &one]), tile([&of_other, &copy])];
    let before = tiles.clone();
    share_alike(std::iter::once(&unchanged), tiles.iter_mut());
    assert_eq!(tiles, before);
    let addresses: HashSet<_> = tiles.iter().flat_map(|tile| &tile.groups).map(Arc::as_ptr).collect();
    assert_eq!(addresses, HashSet::from([Arc::as_ptr(&one), Arc::as_ptr(&other)]));
}

#[test]
fn updates_of_other_scans_are_told_apart() {
    let (mut one, mut other) = (World::new(5), World::new(5));
    let mut sent = one.draw_scans(9);
    one.send_all(&sent, 3);
    sent[4].utc_nanos += 1;
    other.send_all(&sent, 3);
    let (one, other) = (one.take_work().identity(), other.take_work().identity());
    assert_eq!(UpdateIdentity { content: 0, ..one }, UpdateIdentity { content: 0, ..other });
    assert_ne!(one.content, other.content);
}

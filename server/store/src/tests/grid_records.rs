//! The records of a grid one by one: exact, and safe for any content.

use proptest::prelude::*;
use prost::Message;
use rand::{SeedableRng as _, rngs::SmallRng, seq::SliceRandom as _};
use tidemap_grid::{
    day::{Bit, DayTile, Flip},
    index::TileIndex,
    mask::{Mask, TileMasks},
    tile::TileSums,
};
use tidemap_layout as layout;
use tidemap_map::history::origins::Origins;
use tidemap_model::Sample;

use super::grid_example::{day, learned, live_tile, masks, piece, spec};
use crate::record::{
    day as day_record, history, tile,
    tile_model::{self, EncodedSums},
};

/// The decoded message after one byte has changed; `None` if it is not a message any more.
fn changed<M: Message + Default>(message: &M, at: prop::sample::Index, byte: u8) -> Option<M> {
    let mut bytes = message.encode_to_vec();
    let at = at.index(bytes.len().max(1));
    *bytes.get_mut(at)? = byte;
    M::decode(&bytes[..]).ok()
}

proptest! {
    #[test]
    fn live_tiles_come_back(seed in any::<u64>(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let live = live_tile(TileIndex { x: -5, y: 77, z: 1 }, &mut SmallRng::seed_from_u64(seed));
        let message = tile::encode(&live, true).expect("valid");
        prop_assert_eq!(tile::decode(&message), Ok(live));
        if let Some(Ok(found)) = changed(&message, at, byte).map(|message| tile::decode(&message)) {
            prop_assert!(tile::encode(&found, true).is_ok());
        }
    }

    #[test]
    fn models_and_sums_come_back(seed in any::<u64>(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let periodicities = spec("office").periodicities;
        let (model, sums) = learned(&spec("office"), &mut SmallRng::seed_from_u64(seed), &[], 9);
        let message = tile_model::encode(&model);
        prop_assert_eq!(tile_model::decode(&message, &periodicities), Ok(model));
        let _ = changed(&message, at, byte).map(|message| tile_model::decode(&message, &periodicities));
        let shared: Vec<u32> = (0..sums.shared().count() as u32).collect();
        let mut bytes = Vec::new();
        tile_model::encode_sums(&shared, &sums, &mut bytes).expect("valid");
        let found = EncodedSums::new(&bytes, &periodicities).expect("valid");
        prop_assert_eq!((&found.shared, found.cells(&periodicities)), (&shared, sums.cells.len()));
        let mut again = Vec::new();
        found.encode_again(&shared, &periodicities, &mut again);
        prop_assert_eq!(&again, &bytes);
        let untimed = TileSums { times: Vec::new(), ..sums.clone() };
        prop_assert!(tile_model::encode_sums(&shared, &untimed, &mut Vec::new()).is_err());
        prop_assert_eq!(found.decode(sums.shared().cloned().collect(), &periodicities), Ok(sums));
        let at = at.index(bytes.len());
        bytes[at] = byte;
        if let Ok(found) = EncodedSums::new(&bytes, &periodicities) {
            prop_assert!(found.decode(Vec::new(), &periodicities).is_ok());
        }
        prop_assert!(EncodedSums::new(&bytes[..at], &periodicities).is_err());
    }

    #[test]
    fn days_come_back(seed in any::<u64>(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let kept = day(19_000, 6, &mut SmallRng::seed_from_u64(seed));
        let message = day_record::encode(&kept, 6).expect("valid");
        let found = day_record::decode(&message, 6, |_| true).expect("valid");
        prop_assert_eq!((found.day, &found.scans, &found.presence), (kept.day, &kept.scans, &kept.presence));
        prop_assert_eq!(found.tiles().len(), 0);
        if let Some(Ok(found)) = changed(&message, at, byte).map(|message| day_record::decode(&message, 6, |_| true)) {
            prop_assert!(day_record::encode(&found, 6).is_ok());
        }
        let scans = kept.scans.len() as u32;
        for (_, tile) in kept.tiles() {
            let message = day_record::encode_tile(tile).expect("valid");
            prop_assert!(message.last.is_none() && message.flips_in_order.is_empty());
            prop_assert_eq!(day_record::decode_tile(&message, scans), Ok(tile.clone()));
            if let Some(Ok(found)) = changed(&message, at, byte).map(|message| day_record::decode_tile(&message, scans)) {
                prop_assert!(day_record::encode_tile(&found).is_ok());
            }
        }
    }

    #[test]
    fn flips_in_any_order_and_any_last_masks_come_back(seed in any::<u64>()) {
        let mut random = SmallRng::seed_from_u64(seed);
        for (_, tile) in day(19_000, 6, &mut random).tiles() {
            let mut tile = tile.clone();
            tile.last = masks(&mut random);
            tile.flips.shuffle(&mut random);
            tile.flips.sort_by_key(|flip| flip.scan);
            tile.flips.extend_from_within(tile.flips.len().saturating_sub(1)..);
            let message = day_record::encode_tile(&tile).expect("valid");
            prop_assert_eq!(day_record::decode_tile(&message, 60), Ok(tile));
        }
    }

    #[test]
    fn samples_and_small_models_come_back(seed in any::<u64>(), at in any::<prop::sample::Index>(), byte in any::<u8>()) {
        let piece = piece(1, 19_000, &mut SmallRng::seed_from_u64(seed));
        for ((state, samples), origins) in piece.states.iter().zip(&piece.origins) {
            let message = history::encode_samples(*state, samples, origins).expect("valid");
            prop_assert_eq!(history::decode_samples(&message), Ok(samples.clone()));
            prop_assert_eq!(history::decode_origins(&message), Ok(origins.clone()));
            let _ = changed(&message, at, byte).map(|message| history::decode_samples(&message));
            let _ = changed(&message, at, byte).map(|message| history::decode_origins(&message));
            let at = at.index(samples.len());
            let mut parts = origins.part(0, at);
            parts.extend(&origins.part(at, samples.len() - at));
            prop_assert_eq!(&parts, origins);
            prop_assert!(history::encode_samples(*state, samples, &origins.part(1, at)).is_err());
        }
        for (_, models) in &piece.days[0].models {
            let mut bytes = history::encode_models(models).expect("valid");
            prop_assert_eq!(history::decode_models(&bytes), Ok(models.clone()));
            let at = at.index(bytes.len());
            bytes[at] = byte;
            let _ = history::decode_models(&bytes);
            let _ = history::decode_models(&bytes[..at]);
        }
    }
}

#[test]
fn counts_that_nothing_stands_behind_are_refused() {
    let longest = vec![0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x01];
    let tile = |flips: &[u8], in_order: &[u8]| {
        let message = layout::grid::DayTileScans {
            flips: flips.to_vec(),
            flips_in_order: in_order.to_vec(),
            ..layout::grid::DayTileScans::default()
        };
        day_record::decode_tile(&message, 10)
    };
    assert!(tile(&[0, 0, 9], &[]).is_ok());
    assert!(tile(&[0, 0, 10], &[]).is_err(), "a scan that there is not");
    assert!(tile(&[&[0][..], &longest, &[0]].concat(), &[]).is_err(), "more flips than bytes");
    assert!(tile(&[&longest[..], &[0, 0]].concat(), &[]).is_err(), "a cell beyond the tile");
    assert!(tile(&[1, 0, 3], &[]).is_err(), "occupied, never observed");
    assert!(tile(&[], &[9, 0]).is_ok());
    assert!(tile(&[], &[0, 0x80, 0x08]).is_err(), "a cell beyond the tile");
    let day = |scans, presence: &[u8]| {
        let offset_counts = vec![scans];
        let message = layout::grid::Day {
            scans,
            offset_counts,
            offset_secs: vec![0],
            times: vec![0],
            presence: presence.to_vec(),
            ..layout::grid::Day::default()
        };
        day_record::decode(&message, 5, |_| true)
    };
    assert!(day(7, &[7, 1, 0, 4]).is_ok());
    assert!(day(7, &[7, 1, 0, 5]).is_err(), "a tile that there is not");
    assert!(day(7, &[6, 1, 0, 4]).is_err(), "a scan that saw nothing");
    assert!(day(7, &[0, 0, 7, 0]).is_err(), "a run of nothing");
    assert!(day(u32::MAX, &[0xFF, 0xFF, 0xFF, 0xFF, 0x0F, 0]).is_err(), "more scans than there may be");
    let models =
        layout::history::StateSamples { count: u32::MAX, times: vec![0], values: vec![0], ..Default::default() };
    assert!(history::decode_samples(&models).is_err());
    assert!(
        history::encode_samples(
            tidemap_map::ids::StateId(0),
            &[Sample { utc_nanos: -1, offset_secs: 0, value: 0.0 }],
            &Origins::default()
        )
        .is_err(),
        "nobody observed it"
    );
    let origins = |run_counts: &[u32], steps: usize| {
        let (run_counts, run_steps) = (run_counts.to_vec(), vec![1; steps]);
        let run_producers = vec![0; run_counts.len()];
        let message =
            layout::history::StateSamples { count: 5, run_counts, run_producers, run_steps, ..Default::default() };
        history::decode_origins(&message)
    };
    assert!(origins(&[3, 2], 2).is_ok());
    assert!(origins(&[], 0).is_err(), "nobody observed them");
    assert!(origins(&[3, 2], 1).is_err(), "runs without a number");
    assert!(origins(&[u32::MAX, 6], 2).is_err(), "more than there are");
}

#[test]
fn a_flip_that_comes_twice_is_kept_twice() {
    let mut observed = Mask::EMPTY;
    observed.insert(3);
    let first = TileMasks::new(observed, Mask::EMPTY).expect("valid");
    let flips = vec![Flip::new(1, 3, Bit::Occupied); 2];
    let tile = DayTile { first, flips, last: first };
    let message = day_record::encode_tile(&tile).expect("valid");
    assert_eq!(day_record::decode_tile(&message, 2), Ok(tile));
}

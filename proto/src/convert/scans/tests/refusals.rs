//! An error refuses a scan, or ends the stream, and its text contains the value.

use super::*;

#[track_caller]
fn refused(decoder: &mut ScanDecoder, content: Content, reason: RefusalReason, word: &str) {
    let scans = all(decoder, message(9, &[], vec![content])).expect("a refusal is no error");
    let refusal = scans[0].refusal.as_ref().unwrap_or_else(|| panic!("{word} is accepted"));
    assert_eq!(refusal.reason, reason, "{}", refusal.detail);
    assert!(refusal.detail.contains(word), "{}", refusal.detail);
    assert!(refusal.detail.chars().count() <= 200);
    assert!(scans[0].content.is_none());
}

#[test]
fn a_malformed_scan_changes_nothing() {
    let mut decoder = decoder(&spec(false));
    let tiles = [0, 0, 0, 1, 0, 0, 2, 0, 0];
    let first = all(&mut decoder, message(1, &tiles, vec![flips(&[0, 2], &[1, 2, 600], &[2])])).expect("fine");
    let tile = |scan: v1::TileScan| Content::Tiles(scan);
    let bytes = |cells: &[u16]| mask(cells).to_bytes().to_vec();
    let raw = |observed: &[u32]| {
        let observed_flips = observed.to_vec();
        tile(v1::TileScan { observed_flips, ..v1::TileScan::default() })
    };
    let masked = |masked: &[u32], observed: Vec<u8>, occupied: Vec<u8>| {
        tile(v1::TileScan { masked: masked.to_vec(), observed, occupied, ..v1::TileScan::default() })
    };
    for (content, word) in [
        (flips(&[0, 2, 5], &[], &[]), "3 entries"),
        (flips(&[0, 4], &[], &[]), "beyond the stream's 3 tiles"),
        (flips(&[u32::MAX, 4], &[], &[]), "4294967295"),
        (flips(&[0, 0], &[], &[]), "run of 0"),
        (flips(&[1, 1], &[1], &[]), "slot 0 has changed and is not seen"),
        (flips(&[], &[1025], &[]), "slot 2 has changed"),
        (flips(&[], &[4000], &[]), "slot 7"),
        (raw(&[5, 0]), "cell 5 is named twice"),
        (raw(&[5, u32::MAX]), "4294967295 after cell 5"),
        (flips(&[], &[], &[77]), "place 77 of slot 0 is occupied but not observed"),
        (flips(&[], &[2], &[]), "place 2 of slot 0 is occupied but not observed"),
        (masked(&[0], bytes(&[]), vec![0; 63]), "63 bytes for 1 tiles"),
        (masked(&[0], vec![0; 128], bytes(&[])), "observed: 128 bytes"),
        (masked(&[0], bytes(&[1]), bytes(&[8])), "place 8"),
        (masked(&[1, 0], vec![0; 128], vec![0; 128]), "slot 0 after slot 1"),
        (masked(&[2], bytes(&[]), bytes(&[])), "slot 2"),
        (masked(&[], vec![0; 64], Vec::new()), "64 bytes for 0 tiles"),
    ] {
        refused(&mut decoder, content, RefusalReason::Scan, word);
    }
    let scans = all(&mut decoder, message(2, &[], vec![flips(&[], &[], &[])])).expect("fine");
    assert_eq!(scans[0].digest, first[0].digest);
    assert!(scans[0].refusal.is_none());
    let nothing = all(&mut decoder, v1::ScanBatch { scans: vec![v1::Scan::default()], ..message(3, &[], vec![]) });
    assert!(nothing.is_err(), "a time is missing");
}

#[test]
fn flips_of_what_a_malformed_scan_named_need_masks_first() {
    let mut decoder = decoder(&spec(false));
    let tiles = [0, 0, 0, 1, 0, 0, 2, 0, 0];
    all(&mut decoder, message(1, &tiles, vec![flips(&[0, 3], &[1, 600, 1100], &[])])).expect("fine");
    let masked = |slot: u32| {
        let (observed, occupied) = (mask(&[1, 2]).to_bytes().to_vec(), vec![0; 64]);
        Content::Tiles(v1::TileScan { masked: vec![slot], observed, occupied, ..v1::TileScan::default() })
    };
    let taken = |decoder: &mut ScanDecoder, tiles: &[i32], content: Content| {
        let scans = all(decoder, message(2, tiles, vec![content])).expect("fine");
        assert_eq!(scans[0].refusal, None);
    };
    refused(&mut decoder, flips(&[], &[], &[77, 600]), RefusalReason::Scan, "place 77");
    for _ in 0..2 {
        refused(&mut decoder, flips(&[], &[3], &[]), RefusalReason::Scan, "slot 0: a malformed scan named it");
    }
    taken(&mut decoder, &[], flips(&[], &[1101], &[]));
    // Slot 2 is named by what is refused for slot 1.
    refused(&mut decoder, flips(&[], &[601, 1102], &[]), RefusalReason::Scan, "slot 1: ");
    refused(&mut decoder, flips(&[], &[1102], &[]), RefusalReason::Scan, "slot 2: ");
    for slot in 0..3 {
        taken(&mut decoder, &[], masked(slot));
        taken(&mut decoder, &[], flips(&[], &[slot * 512 + 9], &[]));
    }
    // The slots of this scan are not known.
    let garbled = v1::TileScan { observed_flips: vec![5, u32::MAX], ..v1::TileScan::default() };
    refused(&mut decoder, Content::Tiles(garbled), RefusalReason::Scan, "beyond any cell");
    refused(&mut decoder, flips(&[], &[1030], &[]), RefusalReason::Scan, "send the slot's masks whole");
    taken(&mut decoder, &[3, 0, 0], flips(&[0, 4], &[], &[]));
    refused(&mut decoder, flips(&[], &[1540], &[]), RefusalReason::Scan, "slot 3: ");
    taken(&mut decoder, &[], masked(3));
    taken(&mut decoder, &[], flips(&[], &[1540], &[]));
}

#[test]
fn a_flat_grid_has_one_layer() {
    let mut decoder = decoder(&spec(true));
    let tile = message(1, &[0, 0, 0], vec![flips(&[0, 1], &[63], &[])]);
    assert!(all(&mut decoder, tile).expect("fine")[0].refusal.is_none());
    refused(&mut decoder, flips(&[], &[64], &[]), RefusalReason::Scan, "place 64");
    let full = v1::TileScan { masked: vec![0], occupied: vec![0; 64], ..v1::TileScan::default() };
    let scans = all(&mut decoder, message(2, &[], vec![Content::Tiles(full)])).expect("fine");
    assert_eq!(sent(&scans[0]).observed_flips.len(), 63);
    let error = decoder.begin(sent_message(message(3, &[0, 0, 1], vec![flips(&[], &[], &[])]))).expect_err("z");
    assert!(error.to_string().contains("scans.new_tiles[0]: tile 0, 0, 1"), "{error}");
}

#[test]
fn what_makes_the_table_ambiguous_ends_the_stream() {
    let mut decoder = decoder(&spec(false));
    let scan = || vec![flips(&[0, 1], &[1], &[])];
    all(&mut decoder, message(1, &[5, 5, 5], scan())).expect("fine");
    for (tiles, word) in [
        (vec![1, 2], "2 entries"),
        (vec![1, 2, 3, 5, 5, 5], "new_tiles[3]: tile 5, 5, 5"),
        (vec![1, 2, 3, 1, 2, 3], "already"),
        (vec![0, 1 << 20, 0], "1048576"),
        (vec![0; 3 * 1000], "1001 is more than the 1000 that setting max_scan_tiles"),
    ] {
        let error = decoder.begin(sent_message(message(2, &tiles, scan()))).expect_err(word).to_string();
        assert!(error.contains(word), "{error}");
    }
    let mut wrong = |change: fn(&mut v1::ScanBatch)| {
        let mut message = message(2, &[], scan());
        change(&mut message);
        all(&mut decoder, message).expect_err("malformed").to_string()
    };
    assert!(wrong(|m| m.scans.clear()).contains("scans.scans"));
    assert!(wrong(|m| m.time_deltas.push(1)).contains("scans.time_deltas: 2 entries for 1 scans"));
    assert!(wrong(|m| m.time_unit_nanos = 1 << 63).contains("scans.time_unit_nanos"));
    assert!(wrong(|m| m.scans = vec![v1::Scan::default(); 65]).contains("max_batch_scans"));
    let cloud = v1::PointCloud { xyz_m: vec![0.0; 303], ..v1::PointCloud::default() };
    let error = all(&mut decoder, message(2, &[], vec![Content::Cloud(cloud)])).expect_err("101 points");
    assert!(error.to_string().contains("points of one scan: 101 is more than the 100"), "{error}");
}

#[test]
fn times_before_1970_are_refused_and_what_they_show_is_remembered() {
    let mut decoder = decoder(&spec(false));
    let mut early = message(1, &[0, 0, 0], vec![flips(&[0, 1], &[1], &[]), flips(&[], &[], &[])]);
    early.first_time_nanos = -1_000_000_000;
    let scans = all(&mut decoder, early).expect("fine");
    assert_eq!(scans[0].refusal.as_ref().map(|refusal| refusal.reason), Some(RefusalReason::Time));
    assert_eq!(sent(&scans[0]).observed_flips, [1]);
    assert_eq!((scans[1].utc_nanos, &scans[1].refusal), (0, &None));
}

#[test]
fn a_map_without_a_grid_takes_no_scan_and_knows_its_digest() {
    let (mut none, mut some) = (ScanDecoder::new(None, LIMITS), decoder(&spec(false)));
    let sent = || message(1, &[0, 0, 0], vec![flips(&[0, 1], &[1], &[1]), Content::Cloud(v1::PointCloud::default())]);
    let (without, with) = (all(&mut none, sent()).expect("fine"), all(&mut some, sent()).expect("fine"));
    for (without, with) in without.iter().zip(&with) {
        assert_eq!(without.refusal.as_ref().map(|refusal| refusal.reason), Some(RefusalReason::NoGrid));
        assert_eq!((without.digest, &without.content), (with.digest, &None));
    }
}

#[test]
fn of_readings_for_a_map_without_a_grid_only_the_digest_is_kept() {
    let (mut none, mut some) = (ScanDecoder::new(None, LIMITS), decoder(&spec(false)));
    let part = |count: usize, continues| {
        let pose = Some(v1::Pose { x_m: 3.0, qw: 1.0, ..v1::Pose::default() });
        let cloud = v1::PointCloud { pose, xyz_m: vec![1.5; 3 * count], ..v1::PointCloud::default() };
        v1::ScanBatch { continues, ..message(1, &[], vec![Content::Cloud(cloud)]) }
    };
    for decoder in [&mut none, &mut some] {
        all(decoder, part(60, true)).expect("fine");
    }
    assert_eq!((none.held_bytes(), some.held_bytes()), (0, 720));
    let (without, with) = (all(&mut none, part(40, false)), all(&mut some, part(40, false)));
    assert_eq!(without.expect("fine")[0].digest, with.expect("fine")[0].digest);
    all(&mut none, part(60, true)).expect("fine");
    let error = all(&mut none, part(41, false)).expect_err("101 points").to_string();
    assert!(error.contains("points of one scan: 101 is more than the 100"), "{error}");
}

#[test]
fn parts_of_a_scan_are_put_together() {
    let mut decoder = decoder(&spec(false));
    let part = |xyz: &[f32], continues| {
        let cloud = v1::PointCloud { xyz_m: xyz.to_vec(), ..v1::PointCloud::default() };
        v1::ScanBatch { continues, ..message(4, &[], vec![Content::Cloud(cloud)]) }
    };
    assert!(all(&mut decoder, part(&[1.0, 2.0], true)).expect("fine").is_empty());
    assert_eq!(decoder.open_sequence(), Some(4));
    assert!(all(&mut decoder, part(&[], true)).expect("fine").is_empty());
    let scans = all(&mut decoder, part(&[3.0], false)).expect("fine");
    let whole = v1::PointCloud { xyz_m: vec![1.0, 2.0, 3.0], ..v1::PointCloud::default() };
    assert_eq!((scans[0].sequence, scans[0].digest), (4, points_digest(&whole)));
    let Some(ScanContent::Readings(readings)) = &scans[0].content else { panic!("readings") };
    assert_eq!(readings.rays, Rays::Points(vec![1.0, 2.0, 3.0]));
    for (change, word) in [
        ((|m| m.first_sequence = 5) as fn(&mut v1::ScanBatch), "scans.first_sequence: 5"),
        (|m| m.first_time_nanos += 1, "scans.first_time_nanos"),
        (|m| m.scans[0].content = None, "one kind"),
        (|m| m.scans[0].content = Some(flips(&[], &[], &[])), "one kind"),
    ] {
        let mut decoder = self::decoder(&spec(false));
        all(&mut decoder, part(&[1.0], true)).expect("fine");
        let mut next = part(&[1.0], false);
        change(&mut next);
        let error = all(&mut decoder, next).expect_err(word).to_string();
        assert!(error.contains(word), "{error}");
    }
    let mut decoder = self::decoder(&spec(false));
    let long = v1::TileScan { observed_flips: vec![1; 200_000], ..v1::TileScan::default() };
    let piece = || v1::ScanBatch { continues: true, ..message(1, &[], vec![Content::Tiles(long.clone())]) };
    assert!(all(&mut decoder, piece()).is_ok());
    assert!(all(&mut decoder, piece()).expect_err("too long").to_string().contains("max_scan_tiles"));
}

#[test]
fn readings_are_checked() {
    let mut decoder = decoder(&spec(false));
    let cloud = |change: fn(&mut v1::PointCloud)| {
        let mut cloud = v1::PointCloud { xyz_m: vec![1.0, 0.0, 0.0], ..v1::PointCloud::default() };
        change(&mut cloud);
        Content::Cloud(cloud)
    };
    let ranges = |change: fn(&mut v1::RangeScan)| {
        let mut scan = v1::RangeScan { ranges_m: vec![1.0], max_range_m: 5.0, ..v1::RangeScan::default() };
        change(&mut scan);
        Content::Ranges(scan)
    };
    for (content, reason, word) in [
        (cloud(|c| c.frame_id = "odom".to_owned()), RefusalReason::Frame, "\"odom\""),
        (cloud(|c| c.pose = Some(v1::Pose { qw: 2.0, ..v1::Pose::default() })), RefusalReason::Scan, "length 2.0000"),
        (cloud(|c| c.pose = Some(v1::Pose { x_m: f64::NAN, ..v1::Pose::default() })), RefusalReason::Scan, "NaN"),
        (cloud(|c| c.xyz_m.push(1.0)), RefusalReason::Scan, "4 entries"),
        (cloud(|c| c.xyz_m[1] = f32::NAN), RefusalReason::Empty, "none of the 1 points"),
        (cloud(|c| c.xyz_m.clear()), RefusalReason::Empty, "none of the 0 points"),
        (cloud(|c| c.min_range_m = -1.0), RefusalReason::Scan, "min_range_m -1"),
        (cloud(|c| c.max_range_m = f32::INFINITY), RefusalReason::Scan, "max_range_m inf"),
        (ranges(|s| s.max_range_m = 0.0), RefusalReason::Scan, "max_range_m 0"),
        (ranges(|s| s.free_range_m = -1.0), RefusalReason::Scan, "free_range_m -1"),
        (ranges(|s| s.trusted_range_m = f32::NAN), RefusalReason::Scan, "trusted_range_m NaN"),
        (ranges(|s| s.angle_min_rad = f32::NAN), RefusalReason::Scan, "angle_min_rad NaN"),
        (ranges(|s| s.ranges_m = vec![f32::NAN]), RefusalReason::Empty, "none of the 1 ranges"),
        (ranges(|s| s.frame_id = "map ".to_owned()), RefusalReason::Frame, "\"map \""),
    ] {
        refused(&mut decoder, content, reason, word);
    }
    let scans = all(&mut decoder, message(2, &[], vec![ranges(|s| s.frame_id = "map".to_owned())])).expect("fine");
    let Some(ScanContent::Readings(readings)) = &scans[0].content else { panic!("readings") };
    assert_eq!(readings.max_range_m, Some(5.0));
}

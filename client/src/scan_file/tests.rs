//! Files of scans, written and read back, whole and broken.

use super::*;
use crate::observe::{
    scan::{PointCloud, Scan as Given},
    tiles::{Mask, TileIndex, TileMasks, TileTable},
};
use tidemap_proto::v1::scan::Content;

type Tested = Result<(), Box<dyn std::error::Error>>;

fn header() -> ScanFileHeader {
    ScanFileHeader { resolution_m: 0.1, frame_id: "map".to_owned(), origin_m: vec![1.0, 2.0, 3.0] }
}

fn tiles(time: u64) -> Vec<(TileIndex, TileMasks)> {
    let masks = |x: u64| {
        let occupied = std::array::from_fn(|word| if (time / (x + 1)).is_multiple_of(5) { x << word } else { 0 });
        TileMasks::clipped(Mask::FULL, Mask(occupied))
    };
    (0..9).filter(|x| !time.is_multiple_of(x + 2)).map(|x| (TileIndex { x: x as i32, y: 0, z: 0 }, masks(x))).collect()
}

fn file(scans: u64) -> Result<Vec<u8>, ScanWriteError> {
    let mut writer = ScanFileWriter::new(Vec::new(), &header())?;
    for time in 1..=scans {
        writer.scan(time as i64 * 5_000_000_000, Given::Tiles(tiles(time)))?;
    }
    let (bytes, length) = writer.finish()?;
    assert_eq!(bytes.len() as u64, length);
    Ok(bytes)
}

/// All scans up to the end or an error.
fn read(bytes: &[u8]) -> (Vec<FileScan>, Option<ScanFileError>) {
    let mut scans = Vec::new();
    let mut file = match ScanFile::new(bytes) {
        Ok(file) => file,
        Err(error) => return (scans, Some(error)),
    };
    loop {
        match file.next_scans() {
            Ok(Some(more)) => scans.extend(more),
            Ok(None) => return (scans, None),
            Err(error) => return (scans, Some(error)),
        }
    }
}

#[test]
fn what_is_written_is_read() -> Tested {
    let bytes = file(1000)?;
    assert_eq!(ScanFile::new(bytes.as_slice())?.header(), &header());
    let (scans, error) = read(&bytes);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(scans.len(), 1000);
    let mut table = TileTable::default();
    for (scan, number) in scans.into_iter().zip(1..) {
        assert_eq!((scan.number, scan.time_nanos), (number, number as i64 * 5_000_000_000));
        table.extend(&scan.new_tiles)?;
        let Some(Content::Tiles(content)) = scan.scan.content else { panic!("tiles") };
        table.apply(&content)?;
        let expected = tiles(number);
        let slots = table.picture().seen();
        let mut seen: Vec<_> = slots.map(|slot| (table.tiles()[slot as usize], table.picture().masks(slot))).collect();
        seen.sort_unstable_by_key(|(tile, _)| *tile);
        assert_eq!(seen, expected);
    }
    Ok(())
}

#[test]
fn a_scan_larger_than_a_batch_is_put_together() -> Tested {
    let mut writer = ScanFileWriter::new(Vec::new(), &header())?;
    let xyz_m: Vec<f32> = (0..300_000_u32).map(|i| i as f32).collect();
    writer.scan(7, Given::Cloud(PointCloud { xyz_m: xyz_m.clone(), ..PointCloud::default() }))?;
    writer.scan(8, Given::Tiles(tiles(1)))?;
    let (bytes, _) = writer.finish()?;
    let mut raw = ScanFile::new(bytes.as_slice())?;
    let mut batches = Vec::new();
    while let Some(batch) = raw.next_raw()? {
        assert!(batch.bytes.len() <= 512 << 10);
        batches.push(batch.offset);
    }
    assert!(batches.len() > 3, "{batches:?}");
    let (scans, error) = read(&bytes);
    assert!(error.is_none(), "{error:?}");
    let Some(Content::Cloud(cloud)) = &scans[0].scan.content else { panic!("a cloud") };
    assert_eq!((scans.len(), &cloud.xyz_m), (2, &xyz_m));
    let (_, error) = read(&bytes[..batches[1] as usize]);
    assert!(error.is_some_and(|error| error.to_string().contains("continues in a missing batch")));
    Ok(())
}

#[test]
fn a_file_that_is_cut_off_gives_its_whole_batches_and_the_place_of_the_cut() -> Tested {
    let bytes = file(600)?;
    let mut raw = ScanFile::new(bytes.as_slice())?;
    let mut starts = Vec::new();
    while let Some(batch) = raw.next_raw()? {
        starts.push(batch.offset);
    }
    for end in 0..bytes.len() {
        let (scans, error) = read(&bytes[..end]);
        let whole = starts.iter().filter(|&&start| start <= end as u64).count().saturating_sub(1);
        if starts.contains(&(end as u64)) {
            assert!(error.is_none(), "{end}");
        } else {
            let error = error.ok_or("an error")?.to_string();
            assert!(
                end < MAGIC.len() || error.contains("is truncated") || error.contains("ends before"),
                "{end}: {error}"
            );
            if end as u64 > starts[0] {
                assert!(error.starts_with(&format!("byte {}, after {} whole", starts[whole], scans.len())), "{error}");
            }
        }
        assert_eq!(scans.len(), whole * 256, "{end}");
    }
    Ok(())
}

#[test]
fn what_is_wrong_is_named() -> Tested {
    let wrong = |bytes: &[u8]| read(bytes).1.map(|error| error.to_string()).unwrap_or_default();
    assert!(
        wrong(b"time,state,value\n").contains("begins with \"time,state,value"),
        "{}",
        wrong(b"time,state,value\n")
    );
    let bad = ScanFileHeader { resolution_m: -1.0, ..header() };
    assert!(wrong(&ScanFileWriter::new(Vec::new(), &bad)?.finish()?.0).contains("resolution_m is -1"));
    let bad = ScanFileHeader { origin_m: vec![1.0], ..header() };
    assert!(wrong(&ScanFileWriter::new(Vec::new(), &bad)?.finish()?.0).contains("three finite numbers"));

    let start = || ScanFileWriter::new(Vec::new(), &header()).and_then(ScanFileWriter::finish).map(|(bytes, _)| bytes);
    let with = |batch: ScanBatch| start().map(|bytes| wrong(&[bytes, batch.encode_length_delimited_to_vec()].concat()));
    let scan = Scan { content: Some(Content::Cloud(tidemap_proto::v1::PointCloud::default())) };
    let good = ScanBatch { first_sequence: 1, time_deltas: vec![0], scans: vec![scan], ..ScanBatch::default() };
    assert_eq!(with(good.clone())?, "");
    assert!(with(ScanBatch { first_sequence: 2, ..good.clone() })?.contains("it must be 1"));
    assert!(with(ScanBatch { time_deltas: vec![], ..good.clone() })?.contains("1 scans with 0 times"));
    assert!(with(ScanBatch { first_time_nanos: -1, ..good })?.contains("time of scan 1"));
    let garbage = [start()?, vec![5, 255, 255, 255, 255, 255]].concat();
    assert!(wrong(&garbage).contains("not a valid message"), "{}", wrong(&garbage));
    let long = [start()?, vec![255, 255, 255, 255, 127]].concat();
    assert!(wrong(&long).contains("damaged"), "{}", wrong(&long));
    Ok(())
}

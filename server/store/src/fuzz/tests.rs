//! Sound files as inputs of the fuzz targets, so that these begin behind the checks of a file's form.

use std::{fs, path::Path};

use rand::{SeedableRng as _, rngs::SmallRng};
use tidemap_layout::{
    file::{FILE_HEADER_LENGTH, RECORD_HEADER_LENGTH, RecordHeader, TRAILER_LENGTH},
    log::{FRAME_HEADER_LENGTH, FrameHeader, SEGMENT_HEADER_LENGTH, unguard},
};

use super::*;
use crate::tests::{example, grid_example};

/// The records of a file as parts; those that are too long are left out.
fn as_parts(file: &[u8]) -> Vec<u8> {
    let mut rest = &file[FILE_HEADER_LENGTH..file.len() - TRAILER_LENGTH];
    let mut parts = Vec::new();
    while let Some(header) = RecordHeader::decode(rest) {
        let payload = &rest[RECORD_HEADER_LENGTH..RECORD_HEADER_LENGTH + header.payload_length as usize];
        push_part(&mut parts, header.kind as u8, payload);
        rest = &rest[RECORD_HEADER_LENGTH + payload.len()..];
    }
    parts
}

fn push_part(parts: &mut Vec<u8>, kind: u8, payload: &[u8]) {
    if let Ok(length) = u16::try_from(payload.len()) {
        parts.push(kind);
        parts.extend_from_slice(&length.to_le_bytes());
        parts.extend_from_slice(payload);
    }
}

fn frames_as_parts(segment: &[u8]) -> Vec<u8> {
    let mut rest = &segment[SEGMENT_HEADER_LENGTH..];
    let mut parts = Vec::new();
    while let Some(header) = FrameHeader::decode(rest) {
        let payload = unguard(&rest[FRAME_HEADER_LENGTH..header.frame_length()]).expect("guarded");
        let kind = [FrameKind::Observations, FrameKind::UpdateStart, FrameKind::Scans, FrameKind::AddState];
        let number = kind.iter().position(|kind| *kind == header.kind).unwrap_or(4);
        push_part(&mut parts, number as u8, &payload);
        rest = &rest[header.frame_length()..];
    }
    parts
}

/// Inputs by the name of their target.
fn all() -> Vec<(&'static str, Vec<u8>)> {
    let mut found = Vec::new();
    let mut add = |target, first: u8, rest: &[u8]| found.push((target, [&[first], rest].concat()));
    let disk = MemoryDisk::default();
    for (has_grid, states) in [(0, 1), (0, 6), (1, 0), (1, 3)] {
        let spec = map_spec(has_grid == 1).expect("valid");
        let folder = PathBuf::from("/c");
        let checkpoints = Checkpoints { disk: &disk, folder, map: MapId(MAP) };
        let snapshot = match has_grid {
            0 => example::snapshot(&spec, POSITION, states),
            _ => grid_example::snapshot(&spec, POSITION, states as u32),
        };
        checkpoints.list(&CheckpointList::default()).unwrap_or_else(|error| panic!("{error}"));
        checkpoints.save(&spec, &snapshot, 1).unwrap_or_else(|error| panic!("{error}"));
        let file = disk.bytes(&checkpoints.path(POSITION)).expect("written");
        add("checkpoint", has_grid, &as_parts(&file));
        add("checkpoint", has_grid | 2, &file);
        for (number, state) in (0..).zip(snapshot.states.iter().take(2)) {
            add("row", 8 * has_grid, &published::encode(number, state).encode_to_vec());
        }
        for producer in &snapshot.producers {
            add("row", 1, &snapshot::encode_producer(0, producer).encode_to_vec());
        }
        tables::rows(&snapshot.site).for_each(|row| add("row", 2, &row.encode_to_vec()));
        for live in snapshot.grid.iter().flat_map(|grid| &grid.tiles) {
            add("row", 3, &tile::encode(live, false).expect("encodable").encode_to_vec());
        }
        for model in snapshot.grid.iter().flat_map(|grid| &grid.models) {
            add("row", 12, &tile_model::encode(&model.get().expect("in memory")).encode_to_vec());
        }
        add("row", 5, &spec::encode(&spec).encode_to_vec());
    }
    let work = tempfile::tempdir().expect("a folder");
    for end in [4, 23] {
        let data = work.path().join(end.to_string());
        drop(example::fill(&data, end, &[], 1 << 20));
        let segment = fs::read(example::segment(&data)).expect("a segment");
        add("log", 0, &frames_as_parts(&segment));
        add("log", 1, &segment);
    }
    let mut random = SmallRng::seed_from_u64(1);
    let piece = grid_example::piece(POSITION, 19_000, &mut random);
    let history = History::at(Arc::new(disk.clone()), PathBuf::from("/h"), MapId(MAP));
    list_file::replace(&disk, &history.list_path(), &FileList::default()).expect("written");
    history.save(&map_spec(true).expect("valid"), &[Arc::new(piece)]).unwrap_or_else(|error| panic!("{error}"));
    for name in disk.list(Path::new("/h")).expect("listed") {
        let number = u8::from(name.contains("grid"));
        let file = disk.bytes(&Path::new("/h").join(name)).expect("written");
        add("history", number, &as_parts(&file));
        add("history", number | 2, &file);
    }
    add("list", 0, b"next 3\nmap 1 office\nmap 2 lab\n");
    add("list", 1, b"file 00000000000000000015.states.tmh 0 3600000000000 1a2b3c4d\n");
    add("list", 2, b"segment 1\n");
    add("list", 4, b"count 3\n");
    add("list", 5, b"first 101\ncheckpoint 120\n");
    add("list", 6, b"loss 5 maps/00000001/HISTORY it is missing\n");
    found
}

#[test]
fn sound_files_are_read_through_the_readers_of_the_fuzz_targets() {
    let read: BTreeMap<&str, fn(&[u8])> = BTreeMap::from([
        ("checkpoint", checkpoint as fn(&[u8])),
        ("history", history),
        ("log", log_segment),
        ("row", row),
        ("list", list),
    ]);
    let folder = std::env::var_os("TIDEMAP_FUZZ_SEEDS").map(PathBuf::from);
    for (number, (target, bytes)) in all().into_iter().enumerate() {
        read[target](&bytes);
        if let Some(folder) = &folder {
            fs::create_dir_all(folder.join(target)).expect("a folder");
            fs::write(folder.join(target).join(format!("sound-{number}")), bytes).expect("a file");
        }
    }
}

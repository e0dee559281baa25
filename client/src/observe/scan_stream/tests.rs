//! Scans over connections that break, to a daemon that forgets its table of tiles with each.

use std::collections::{HashMap, VecDeque};

use proptest::prelude::*;
use prost::Message as _;
use tidemap_grid::mask::Mask;
use tidemap_proto::{
    convert::{
        grid::grid_from_wire,
        scans::{ScanDecoder, ScanLimits, TileTable, join_part, scans_from_wire},
    },
    v1,
};

use super::*;
use crate::observe::{
    content::ContentCrc,
    scan::{PointCloud, Scan as Given},
    window::Window,
};

type Picture = Vec<(TileIndex, TileMasks)>;

/// The decoder of the daemon, and the cells that the daemon shows.
struct Daemon {
    pictures: Vec<Picture>,
    crc: ContentCrc,
    /// The decoder of this connection.
    decoder: ScanDecoder,
    /// Time and digest of decoded scans, until they are checked.
    decoded: Vec<(i64, u64)>,
    table: TileTable,
    unfinished: Option<v1::Scan>,
}

fn decoder() -> ScanDecoder {
    let grid = v1::Grid { resolution_m: 0.1, ..v1::Grid::default() };
    let spec = grid_from_wire(grid).expect("a grid");
    ScanDecoder::new(Some(&spec), ScanLimits { batch_scans: 256, points: 1 << 20, tiles: 1 << 16 })
}

impl Daemon {
    fn new() -> Self {
        let (crc, table) = (ContentCrc::default(), TileTable::default());
        Self { pictures: Vec::new(), crc, decoder: decoder(), decoded: Vec::new(), table, unfinished: None }
    }

    fn durable(&self) -> u64 {
        self.pictures.len() as u64
    }

    fn receive(&mut self, batch: ScanBatch) {
        assert!(batch.first_sequence <= self.durable() + 1, "a gap before {}", batch.first_sequence);
        let message = scans_from_wire(batch.clone()).expect("sequence numbers that make sense");
        self.decoder.begin(message).expect("a message that makes sense");
        while let Some(scan) = self.decoder.next_scan().expect("a message that makes sense") {
            assert_eq!(scan.refusal, None);
            if scan.sequence > self.durable() {
                assert!(scan.sequence == self.durable() + 1 + self.decoded.len() as u64);
                self.decoded.push((scan.utc_nanos, scan.digest));
            }
        }
        self.table.extend(&batch.new_tiles).expect("new tiles");
        let count = batch.scans.len();
        let mut time = batch.first_time_nanos;
        for (i, scan) in batch.scans.into_iter().enumerate() {
            time += batch.time_deltas[i] * i64::try_from(batch.time_unit_nanos).expect("a unit");
            let scan = match self.unfinished.take() {
                None => scan,
                Some(mut whole) => {
                    join_part(&mut whole.content, scan.content).expect("parts that fit");
                    whole
                }
            };
            if batch.continues && i + 1 == count {
                self.unfinished = Some(scan);
                return;
            }
            let Some(Content::Tiles(tiles)) = scan.content else { panic!("only tiles are sent here") };
            let digest = self.table.apply(&tiles).expect("a scan that makes sense");
            if batch.first_sequence + i as u64 > self.durable() {
                assert_eq!(self.decoded.remove(0), (time, digest));
                self.crc.add_scan(time, digest);
                let shown = self.table.picture();
                let seen = shown.seen().map(|slot| (self.table.tiles()[slot as usize], shown.masks(slot)));
                let mut picture: Picture = seen.collect();
                picture.sort_unstable_by_key(|(tile, _)| *tile);
                self.pictures.push(picture);
            }
        }
    }

    fn forget(&mut self) {
        (self.decoder, self.table, self.unfinished) = (decoder(), TileTable::default(), None);
    }
}

#[derive(Clone, Debug)]
enum Step {
    /// Tiles by x, with masks made from the bits.
    Push(Vec<(i32, u64)>),
    Send,
    Acknowledge,
    /// The given number of sent messages arrive; then the connection breaks and a new one is made.
    Break(usize),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let tile = (0..60_i32, prop_oneof![3 => 0..8_u64, 1 => any::<u64>()]);
    let step = prop_oneof![
        4 => proptest::collection::vec(tile, 1..60).prop_map(Step::Push),
        4 => Just(Step::Send),
        2 => Just(Step::Acknowledge),
        1 => (0..6_usize).prop_map(Step::Break),
    ];
    proptest::collection::vec(step, 1..80)
}

fn picture(tiles: &[(i32, u64)]) -> Picture {
    let masks = |bits: u64| {
        let observed: [u64; 8] = std::array::from_fn(|word| bits | 1 << word);
        TileMasks::clipped(Mask(observed), Mask(observed.map(|word| word & bits & 0x5555_5555_5555_5555)))
    };
    let by_place: HashMap<i32, u64> = tiles.iter().copied().collect();
    let mut picture: Picture =
        by_place.into_iter().map(|(x, bits)| (TileIndex { x, y: 0, z: -1 }, masks(bits))).collect();
    picture.sort_unstable_by_key(|(tile, _)| *tile);
    picture
}

fn taken(window: &mut Window, stream: &mut Option<ScanStream>, limits: ScanMessageLimits) -> Vec<ScanBatch> {
    let first_sequence = window.next_unsent();
    let mut waiting = window.scans_to_send(limits.scans, limits.bytes, u64::MAX).peekable();
    if waiting.peek().is_none() {
        return Vec::new();
    }
    let stream = stream.get_or_insert_with(|| ScanStream::new(window.base()));
    let (count, messages) = stream.pack(waiting, window.tiles(), first_sequence, limits);
    window.sent(count);
    messages
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]
    #[test]
    fn every_scan_arrives_once_and_whole(steps in steps(), scans in 1..5_usize, bytes in 4096..9000_usize) {
        let limits = ScanMessageLimits { scans, bytes };
        let mut window = Window::new(8, 0, 0);
        let mut daemon = Daemon::new();
        let (mut pushed, mut stream) = (Vec::new(), None);
        let mut under_way: VecDeque<ScanBatch> = VecDeque::new();
        for (time, step) in (0..).zip(steps) {
            match step {
                Step::Push(tiles) => if window.has_room() {
                    let picture = picture(&tiles);
                    pushed.push(picture.clone());
                    prop_assert_eq!(window.push_scan(time * 3, Given::Tiles(picture)), Ok(pushed.len() as u64));
                },
                Step::Send => {
                    let messages = taken(&mut window, &mut stream, limits);
                    for message in &messages {
                        prop_assert!(message.encoded_len() <= bytes, "{} of {bytes}", message.encoded_len());
                    }
                    under_way.extend(messages);
                }
                Step::Acknowledge => if let Some(message) = under_way.pop_front() {
                    daemon.receive(message);
                    prop_assert_eq!(window.acknowledged(daemon.durable()), Ok(()));
                },
                Step::Break(arrive) => {
                    under_way.drain(..).take(arrive).for_each(|message| daemon.receive(message));
                    daemon.forget();
                    stream = None;
                    prop_assert!(window.welcomed(daemon.durable(), daemon.crc.value()).is_ok());
                }
            }
        }
        under_way.drain(..).for_each(|message| daemon.receive(message));
        while window.durable() < window.last() {
            taken(&mut window, &mut stream, limits).into_iter().for_each(|message| daemon.receive(message));
            prop_assert_eq!(window.acknowledged(daemon.durable()), Ok(()));
        }
        prop_assert_eq!(&daemon.pictures, &pushed);
        prop_assert!(window.welcomed(daemon.durable(), daemon.crc.value()).is_ok());
    }
}

#[test]
fn a_large_cloud_is_split_and_comes_out_whole() -> Result<(), Box<dyn std::error::Error>> {
    let mut window = Window::new(8, 0, 0);
    let xyz_m: Vec<f32> = (0..6000_u16).map(f32::from).collect();
    let cloud = PointCloud { xyz_m: xyz_m.clone(), frame_id: "map".to_owned(), ..PointCloud::default() };
    window.push_scan(5, Given::Cloud(cloud))?;
    let messages = taken(&mut window, &mut None, ScanMessageLimits { scans: 256, bytes: 4096 });
    assert!(messages.len() > 2, "{}", messages.len());
    let last = messages.len() - 1;
    let mut whole: Option<v1::Scan> = None;
    for (i, mut message) in messages.into_iter().enumerate() {
        assert!(message.encoded_len() <= 4096);
        assert_eq!((message.first_sequence, message.first_time_nanos, message.continues), (1, 5, i < last));
        let part = message.scans.remove(0);
        match &mut whole {
            Some(whole) => join_part(&mut whole.content, part.content)?,
            None => whole = Some(part),
        }
    }
    let Some(Content::Cloud(cloud)) = whole.and_then(|scan| scan.content) else { panic!("a cloud") };
    assert_eq!((cloud.xyz_m, cloud.frame_id.as_str()), (xyz_m, "map"));
    Ok(())
}

#[test]
fn the_bytes_of_scans_bound_the_window() -> Result<(), Box<dyn std::error::Error>> {
    let mut window = Window::new(1000, 0, 0).with_bytes(10_000);
    let cloud = PointCloud { xyz_m: vec![0.0; 3000], ..PointCloud::default() };
    assert!(window.has_room());
    window.push_scan(5, Given::Cloud(cloud))?;
    assert!(!window.has_room() && window.push("door", 6, 1.0).is_none());
    taken(&mut window, &mut None, ScanMessageLimits { scans: 256, bytes: 1 << 20 });
    window.acknowledged(1)?;
    assert_eq!(window.push("door", 6, 1.0), Some(2));
    Ok(())
}

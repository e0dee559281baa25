//! Observations are read back exactly, as long as the map keeps them: from the log, from history files, and across
//! the two.

use std::{collections::BTreeMap, time::Duration};

use tidemap_client::{
    Client, Error,
    maps::{NewMap, Retention},
    observe::{
        Producer,
        scan::Scan,
        tiles::{TileIndex, TileMasks},
    },
    queries::ModelKind,
};
use tidemap_tests::{
    daemon::{Daemon, Launch},
    film::{Film, FilmCell, holds},
    oracle::run_update,
};
use tonic::Code;

use super::{MAP, grid, model, new_map, office, partial_view, predicted, producer, send, summary};

const DAY_NANOS: i64 = 86_400_000_000_000;
const SCANS_PER_DAY: u32 = 200;

type Readings = Vec<(i64, f64)>;

/// The readings of some cells, by time.
fn readings(
    film: &Film,
    sent: &[(i64, Vec<(TileIndex, TileMasks)>)],
    cells: &[FilmCell],
) -> BTreeMap<String, Readings> {
    let mut sent: Vec<&(i64, Vec<(TileIndex, TileMasks)>)> = sent.iter().collect();
    sent.sort_by_key(|(time, _)| *time);
    let of_cell = |&(slot, place): &FilmCell| {
        let reading = |(time, tiles): &&(i64, Vec<(TileIndex, TileMasks)>)| {
            let (_, masks) = tiles.iter().find(|(tile, _)| *tile == film.tiles()[slot])?;
            let is_occupied = holds(&masks.occupied(), place);
            holds(&masks.observed(), place).then_some((*time, f64::from(u8::from(is_occupied))))
        };
        (film.name((slot, place)), sent.iter().filter_map(reading).collect())
    };
    cells.iter().map(of_cell).collect()
}

async fn recalled(client: &Client, state: &str, from_nanos: i64, to_nanos: i64) -> Result<Readings, Error> {
    let mut answer = client.reconstruct(MAP, state, from_nanos, to_nanos).await?;
    let mut all = Vec::new();
    while let Some(more) = answer.next().await? {
        all.extend(more);
    }
    Ok(all)
}

/// Reads all of it, and a part that begins and ends in the middle of a day.
async fn check(daemon: &Daemon, expected: &BTreeMap<String, Readings>, film: &Film, at: &str) {
    let client = daemon.client();
    let from = film.time(0);
    for (name, expected) in expected {
        let found = recalled(&client, name, 0, i64::MAX).await.unwrap_or_else(|error| panic!("{at}: {name}: {error}"));
        assert_eq!(&found, expected, "{at}: {name}");
        let piece = from + DAY_NANOS / 3..from + DAY_NANOS * 5 / 2;
        let within: Readings = expected.iter().copied().filter(|(time, _)| piece.contains(time)).collect();
        let found = recalled(&client, name, piece.start, piece.end).await.expect("a piece");
        assert_eq!(found, within, "{at}: a piece of {name}");
    }
}

fn status(error: &Error) -> (Code, &str) {
    match error {
        Error::Server(error) => (error.code, &error.message),
        other => panic!("the daemon should have reported it: {other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_history_gives_back_exactly_what_was_sent() {
    let film = Film::new(4, SCANS_PER_DAY);
    let whole: Vec<_> = film.run().map(|(time, occupied)| (time, film.seen(&occupied))).collect();
    let part: Vec<_> = partial_view(&film).collect();
    let cells: Vec<FilmCell> = film.changing(45).chain(film.still(1_800)).chain([(1, 209), (2, 209)]).collect();
    let (data, mut daemon) = office(grid(Retention::Forever)).await;
    let mut sent = Vec::new();
    let mut door = Vec::new();
    // By half days, so that some updates learn the second part of a day.
    for half in 0..8 {
        let bounds = [half, half + 1].map(|half| film.time(0) + half * DAY_NANOS / 2);
        let now = |(time, _): &&(i64, Vec<(TileIndex, TileMasks)>)| (bounds[0]..bounds[1]).contains(time);
        let (whole, part) = (whole.iter().filter(now), part.iter().filter(now));
        let (mut camera, mut robot) = (producer(&daemon, "camera").await, producer(&daemon, "robot").await);
        for (time, tiles) in whole.clone() {
            camera.send_scan(*time, Scan::Tiles(tiles.clone())).await.expect("taken");
            if time % 7 == 0 || door.len() < 5 {
                let value = (door.len() % 11) as f64 / 10.0;
                camera.send("door", *time, value).await.expect("taken");
                door.push((*time, value));
            }
        }
        flushed(&mut camera).await;
        send(&mut robot, part.clone().cloned()).await;
        sent.extend(whole.chain(part).cloned());
        let mut expected = readings(&film, &sent, &cells);
        expected.insert("door".to_owned(), door.clone());
        if half % 3 == 0 {
            check(&daemon, &expected, &film, &format!("half day {half}, before the update")).await;
        }
        if half % 3 == 2 {
            continue;
        }
        run_update(&daemon.client(), MAP, (half % 2 == 0).then_some(bounds[0] + DAY_NANOS / 4)).await;
        check(&daemon, &expected, &film, &format!("half day {half}, after the update")).await;
        if half % 4 == 0 {
            daemon.stop_in_order();
        } else {
            daemon.kill();
        }
        daemon = Launch::on(data.path()).start();
        check(&daemon, &expected, &film, &format!("half day {half}, after a restart")).await;
    }
    let unknown = recalled(&daemon.client(), "cell/900/0/0", 0, i64::MAX).await.expect_err("never observed");
    assert_eq!(status(&unknown).0, Code::NotFound);
    assert!(status(&unknown).1.contains("cell/900/0/0"), "{unknown:?}");
}

async fn flushed(producer: &mut Producer) {
    producer.flush().await.expect("durable");
    assert_eq!(producer.take_refusals(), []);
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_without_history_gives_an_error_that_names_the_option() {
    let film = Film::new(1, 10);
    let (_data, daemon) = office(grid(Retention::None)).await;
    let mut camera = producer(&daemon, "camera").await;
    send(&mut camera, film.run().map(|(time, occupied)| (time, film.seen(&occupied)))).await;
    camera.send("door", film.time(0), 1.0).await.expect("taken");
    flushed(&mut camera).await;
    let client = daemon.client();
    for update in [false, true] {
        if update {
            run_update(&client, MAP, None).await;
        }
        let name = film.name((0, 0));
        let refused = recalled(&client, &name, 0, i64::MAX).await.expect_err("nothing is kept");
        let (code, message) = status(&refused);
        assert_eq!(code, Code::FailedPrecondition);
        assert!(message.contains(MAP) && message.contains("grid retention"), "{message}");
        // Named states keep theirs unless it is set otherwise.
        let door = recalled(&client, "door", 0, i64::MAX).await.expect("kept");
        assert_eq!(door, [(film.time(0), 1.0)]);
    }
}

/// Waits until the first day is deleted: the save after an update runs in the background.
async fn forgotten(client: &Client, film: &Film) {
    let first = film.changing(1).next().expect("a cell");
    let gone = async {
        while recalled(client, &film.name(first), 0, film.time(film.scans_of(1))).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(Duration::from_secs(60), gone).await.expect("the first day is forgotten");
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_history_of_a_day_forgets_what_is_older_and_leaves_the_models_alone() {
    let film = Film::new(5, SCANS_PER_DAY);
    let cells: Vec<FilmCell> = film.changing(60).collect();
    let mut sent = Vec::new();
    let mut answers = Vec::new();
    for retention in [Retention::Forever, Retention::Duration(DAY_NANOS)] {
        let data = tempfile::tempdir().expect("a folder");
        let mut daemon = Launch::on(data.path()).start();
        let map = NewMap { retention: Some(retention), ..new_map(grid(retention)) };
        daemon.client().create_map(map).await.expect("a new map");
        sent = film.run().map(|(time, occupied)| (time, film.seen(&occupied))).collect();
        for day in 0..5 {
            let mut camera = producer(&daemon, "camera").await;
            send(&mut camera, sent[film.scans_of(day)..film.scans_of(day + 1)].iter().cloned()).await;
            camera.send("door", film.time(film.scans_of(day)), 0.25).await.expect("taken");
            flushed(&mut camera).await;
            // The first update after a start is saved at once, and older observations are deleted then.
            daemon.stop_in_order();
            daemon = Launch::on(data.path()).start();
            run_update(&daemon.client(), MAP, None).await;
        }
        if retention != Retention::Forever {
            let client = daemon.client();
            let before = film.time(film.scans_of(3));
            let kept_from = format!(" {} s ", (film.time(film.scans() - 1) - DAY_NANOS) / 1_000_000_000);
            forgotten(&client, &film).await;
            for (name, expected) in readings(&film, &sent, &cells) {
                for state in [name.as_str(), "door"] {
                    let gone = recalled(&client, state, 0, film.time(film.scans_of(1))).await.expect_err("forgotten");
                    let (code, message) = status(&gone);
                    assert_eq!(code, Code::OutOfRange, "{message}");
                    assert!(message.contains(state) && message.contains(&kept_from), "{message}");
                }
                let kept: Readings = expected.iter().copied().filter(|(time, _)| *time >= before).collect();
                let all = recalled(&client, &name, 0, i64::MAX).await.expect("a part is kept");
                assert!(all.ends_with(&kept), "{name}: the newest day is kept whole");
                assert!(all.len() < expected.len(), "{name}: nothing was forgotten");
                assert!(expected.ends_with(&all), "{name}: what is kept is what was sent");
            }
        }
        daemon.stop_in_order();
        daemon = Launch::on(data.path()).start();
        let to = film.time(film.scans() - 1) + DAY_NANOS;
        let grid = predicted(&daemon, to, model(ModelKind::Auto, None)).await;
        let mut models = Vec::new();
        for cell in &cells {
            models.push(daemon.client().describe_model(MAP, &film.name(*cell)).await.expect("a cell"));
        }
        answers.push((summary(&daemon).await, grid.tiles, models));
    }
    assert_eq!(sent.len(), film.scans());
    assert_eq!(answers[0], answers[1]);
}

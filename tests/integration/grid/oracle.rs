//! Cells of a grid that two producers observe, one of them only in part, against a naive model of each.

use std::collections::BTreeMap;

use tidemap_client::queries::{Blend, ModelKind, ModelSelector};
use tidemap_tests::{
    cli,
    daemon::{Daemon, Launch},
    film::{Film, FilmCell, holds},
    oracle::run_update,
};

use super::{
    MAP, grid, model,
    naive::{Naive, Phasors, Reading, bins},
    office, partial_view, predicted, producer, send, summary,
};
use tidemap_client::time::format_rfc3339;
use tidemap_client::{
    maps::{GridSpec, Retention, SensorNoise},
    observe::{
        Producer, ProducerOptions, ProducerSensor,
        tiles::{TileIndex, TileMasks},
    },
};

/// Readings of each cell in the order of their arrival.
#[derive(Default)]
struct Sent {
    readings: BTreeMap<FilmCell, Vec<Reading>>,
    /// The time and the log odds of each reading.
    odds: BTreeMap<FilmCell, Vec<(i64, f64)>>,
    phasors: Phasors,
    /// The times of the scans.
    scans: Vec<i64>,
    cell_observations: u64,
}

impl Sent {
    /// Records the values of readings: `levels` for a free and an occupied one.
    fn note(
        &mut self,
        film: &Film,
        scans: &[(i64, Vec<(TileIndex, TileMasks)>)],
        levels: (f64, f64),
        odds: (f64, f64),
    ) {
        for (time, tiles) in scans {
            self.scans.push(*time);
            for (tile, masks) in tiles {
                let slot = film.tiles().iter().position(|known| known == tile).expect("a tile of the film");
                self.cell_observations += u64::from(masks.observed().count());
                for (&(_, place), readings) in self.readings.range_mut((slot, 0)..(slot + 1, 0)) {
                    if holds(&masks.observed(), place) {
                        let is_occupied = holds(&masks.occupied(), place);
                        readings.push((*time, if is_occupied { levels.1 } else { levels.0 }, is_occupied));
                        let of_cell = self.odds.entry((slot, place)).or_default();
                        of_cell.push((*time, if is_occupied { odds.1 } else { odds.0 }));
                    }
                }
            }
        }
    }
}

fn near(found: f64, expected: f64, what: &str) {
    assert!((found - expected).abs() <= 1e-6, "{what} is {found}, and not {expected}");
}

/// Compares the daemon's answers for the cells with the naive model of the readings before the cut; returns the number
/// of cells whose components were compared.
async fn compare(daemon: &Daemon, film: &Film, sent: &mut Sent, cut_nanos: i64, levels: (f64, f64)) -> usize {
    let client = daemon.client();
    let (from, to) = (film.time(0), film.time(film.scans() - 1));
    let times = [from, from + (to - from) / 3, to - 3_600_000_000_000, to + 8_000_000_000, to + 400_000_000_000_000];
    let names: Vec<String> = sent.readings.keys().map(|&cell| film.name(cell)).collect();
    let persistent = ModelSelector { blend: Blend::Persistence, ..ModelSelector::default() };
    let selectors = [
        model(ModelKind::Auto, None),
        model(ModelKind::Mean, None),
        model(ModelKind::Spectral, Some(2)),
        model(ModelKind::Spectral, Some(15)),
        model(ModelKind::Latest, None),
        persistent,
    ];
    let mut answers = Vec::new();
    for selector in selectors {
        let mut runs = client.predict(MAP, names.clone(), times.to_vec(), selector);
        let mut by_cell = Vec::new();
        while let Some(run) = runs.next().await.expect("cells are states") {
            by_cell.extend(run.probabilities);
        }
        assert_eq!(by_cell.len(), names.len() * times.len());
        answers.push(by_cell);
    }
    let drawn = predicted(daemon, times[2], model(ModelKind::Auto, None)).await;
    let (mut compared, mut orders) = (0, 0);
    for (at, (&cell, readings)) in sent.readings.iter().enumerate() {
        let name = &names[at];
        let learned = bins(&sent.scans, &sent.odds[&cell], cut_nanos, levels);
        let expected = Naive::new(readings, &learned, &mut sent.phasors);
        let model_state = client.describe_model(MAP, name).await.expect("a cell");
        assert_eq!(model_state.learned_observations, expected.folded, "{name}");
        assert_eq!(model_state.last_nanos, expected.last.map(|(time, _)| time), "{name}");
        let values =
            [model_state.last_value, expected.last.map(|(_, value)| value)].map(|value| value.unwrap_or(f64::NAN));
        near(values[0], values[1], &format!("the last value of {name}"));
        near(model_state.mean, expected.mean, &format!("the mean of {name}"));
        near(model_state.persistence_tau_secs / expected.tau_secs, 1.0, &format!("τ of {name} by what it should be"));
        for (at_time, &time) in times.iter().enumerate() {
            let answer = |selector: usize| answers[selector][at * times.len() + at_time];
            let what = |kind: &str| format!("{kind} of {name} at {time}");
            near(answer(1), expected.mean, &what("the mean"));
            near(answer(4), expected.last.map_or(0.5, |(_, value)| value), &what("the latest"));
            if expected.is_tied {
                continue;
            }
            near(answer(0), expected.answer(time), &what("the prediction"));
            near(answer(2), expected.probability(2, time), &what("the prediction of order 2"));
            near(answer(3), expected.probability(15, time), &what("the prediction of order 15"));
            near(answer(5), expected.persistent(time), &what("the prediction with persistence"));
        }
        if expected.is_tied {
            continue;
        }
        compared += 1;
        orders += usize::from(expected.order > 0);
        assert_eq!(model_state.order as usize, expected.order, "the order of {name}, by errors {:?}", expected.errors);
        for (found, expected) in model_state.order_errors.iter().zip(expected.errors) {
            let apart = (found - expected).abs() / (1.0 + expected);
            assert!(apart <= 1e-3, "an error of {name} is {found}, and not {expected}");
        }
        let value = f64::from(drawn.cell(film.index(cell)).value().expect("a known cell"));
        near(value, expected.answer(times[2]), &format!("{name} in the whole grid"));
    }
    println!("{compared} of {} cells have components that can be told apart; {orders} an order", names.len());
    compared
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_models_of_cells_are_those_of_a_naive_model() {
    let film = Film::new(6, 1_000);
    let (_data, daemon) = office(grid(Retention::None)).await;
    let client = daemon.client();
    let mut sent = Sent::default();
    // The obstacle of the partial view in layer 3 is in a cell that the office never changes.
    let in_the_way = (0..film.tiles().len()).map(|slot| (slot, 3 * 64 + 17)).step_by(3);
    for cell in film.changing(10).chain(film.still(900)).chain(in_the_way) {
        sent.readings.insert(cell, Vec::new());
    }
    assert!(sent.readings.len() >= 50, "{}", sent.readings.len());

    let whole: Vec<_> = film.run().map(|(time, occupied)| (time, film.seen(&occupied))).collect();
    let part: Vec<_> = partial_view(&film).collect();
    let (mut one, mut other) = (producer(&daemon, "camera").await, producer(&daemon, "robot").await);
    // Midnight in London, which is that of UTC until then.
    let midnight = film.time(film.scans_of(2));
    for (from, to) in [(i64::MIN, midnight), (midnight, i64::MAX)] {
        for (producer, scans) in [(&mut one, &whole), (&mut other, &part)] {
            let of_round: Vec<_> = scans.iter().filter(|(time, _)| (from..to).contains(time)).cloned().collect();
            sent.note(&film, &of_round, (0.0, 1.0), (-1.0, 1.0));
            send(producer, of_round).await;
        }
        run_update(&client, MAP, Some(to).filter(|to| *to < i64::MAX)).await;
        let summary = summary(&daemon).await;
        assert_eq!((summary.scans, summary.pending_scans), (sent.scans.len() as u64, 0));
        assert_eq!(summary.cell_observations, sent.cell_observations);
        let compared = compare(&daemon, &film, &mut sent, to, (0.0, 1.0)).await;
        assert!(compared >= 40, "{compared} cells are too few");
    }
}

/// P(occupied | reads free) and P(occupied | reads occupied), by Bayes' rule.
fn levels(ProducerSensor { hit, false_alarm }: ProducerSensor, prior: f64) -> (f64, f64) {
    let posterior =
        |if_occupied: f64, if_free: f64| if_occupied * prior / (if_occupied * prior + if_free * (1.0 - prior));
    (posterior(1.0 - hit, 1.0 - false_alarm), posterior(hit, false_alarm))
}

/// The log odds of a free and an occupied reading; none is surer than .97.
fn odds(ProducerSensor { hit, false_alarm }: ProducerSensor) -> (f64, f64) {
    let odds = |p: f64| {
        let p = p.clamp(0.03, 0.97);
        (p / (1.0 - p)).ln()
    };
    (odds((1.0 - hit) / (2.0 - hit - false_alarm)), odds(hit / (hit + false_alarm)))
}

async fn with_sensor(daemon: &Daemon, name: &str, sensor: Option<ProducerSensor>) -> Result<Producer, String> {
    let options = ProducerOptions { sensor, ..ProducerOptions::new(name, "", MAP) };
    Producer::open(&daemon.client(), options).await.map_err(|error| error.to_string())
}

#[tokio::test(flavor = "multi_thread")]
async fn grid_that_producers_with_sensors_of_their_own_observe_weighs_their_readings() {
    let film = Film::new(6, 400);
    let own = ProducerSensor { hit: 0.9, false_alarm: 0.05 };
    let sensor = SensorNoise { hit: own.hit, false_alarm: own.false_alarm, prior: 0.4 };
    let (data, mut daemon) = office(GridSpec { sensor, ..grid(Retention::Forever) }).await;
    let mut sent = Sent::default();
    let in_the_way = (0..film.tiles().len()).map(|slot| (slot, 3 * 64 + 17)).step_by(3);
    for cell in film.changing(30).chain(film.still(900)).chain(in_the_way) {
        sent.readings.insert(cell, Vec::new());
    }

    let whole: Vec<_> = film.run().map(|(time, occupied)| (time, film.seen(&occupied))).collect();
    let part: Vec<_> = partial_view(&film).collect();
    // A third producer sees as the robot does, with a better sensor, a little later.
    let shift = 60_000_000_000;
    let late: Vec<_> = part.iter().step_by(3).map(|(time, seen)| (time + shift, seen.clone())).collect();
    let (weak, sharp) =
        (ProducerSensor { hit: 0.7, false_alarm: 0.2 }, ProducerSensor { hit: 0.99, false_alarm: 0.001 });
    let midnight = film.time(film.scans_of(2));
    for (from, to) in [(i64::MIN, midnight), (midnight, i64::MAX)] {
        let announced = |sensor| Some(sensor).filter(|_| from == i64::MIN);
        // In the second round the robot does not declare its sensor.
        for (name, given, is, scans) in [
            ("camera", None, own, &whole),
            ("robot", announced(weak), weak, &part),
            ("inspector", Some(sharp), sharp, &late),
        ] {
            let of_round: Vec<_> = scans.iter().filter(|(time, _)| (from..to).contains(time)).cloned().collect();
            sent.note(&film, &of_round, levels(is, 0.4), odds(is));
            let mut producer = with_sensor(&daemon, name, given).await.expect("a Welcome");
            send(&mut producer, of_round).await;
        }
        // Pending scans are read from the log, and in the second round from a checkpoint too.
        daemon.kill();
        daemon = Launch::on(data.path()).start();
        run_update(&daemon.client(), MAP, Some(to).filter(|to| *to < i64::MAX)).await;
        let compared = compare(&daemon, &film, &mut sent, to, levels(own, 0.4)).await;
        assert!(compared >= 25, "{compared} cells are too few");
    }
    daemon.stop_in_order();
    let daemon = Launch::on(data.path()).start();

    // Drawn on the command line, cell by cell.
    let out = data.path().join("mean.csv");
    let out = out.to_str().expect("a path of text");
    let at = format_rfc3339(film.time(film.scans() / 2));
    cli::tidemap(&daemon, ["grid", "predict", MAP, "--at", &at, "--model", "mean", "--out", out]).table();
    let text = std::fs::read_to_string(out).expect("a file");
    let mut drawn: BTreeMap<[i32; 3], f64> = BTreeMap::new();
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let head = lines.next().expect("a first line");
    let column =
        |name: &str| head.iter().position(|found| *found == name).unwrap_or_else(|| panic!("{name}: {head:?}"));
    let (cell, value) = (["cell_x", "cell_y", "cell_z"].map(column), column("probability"));
    for line in lines {
        let index = cell.map(|column| line[column].parse().expect("an index"));
        drawn.insert(index, line[value].parse().expect("a number"));
    }
    for (&cell, of_cell) in &sent.odds {
        let learned = bins(&sent.scans, of_cell, i64::MAX, levels(own, 0.4));
        let expected = learned.iter().map(|(_, value, _)| value).sum::<f64>() / learned.len() as f64;
        near(drawn[&film.index(cell)], expected, &format!("the mean of {} as it is drawn", film.name(cell)));
    }

    // The sensor of a producer cannot change.
    for (name, given, words) in [
        ("robot", ProducerSensor { hit: 0.75, ..weak }, ["0.7,", "0.75", "another label"]),
        ("robot", own, ["0.7,", "0.9", "another label"]),
        ("camera", weak, ["0.9,", "0.7", "another label"]),
        ("fourth", ProducerSensor { hit: 0.2, false_alarm: 0.2 }, ["0.2", "false alarm", "hit <= 1"]),
        ("fourth", ProducerSensor { hit: f64::NAN, false_alarm: 0.2 }, ["NaN", "false alarm", "hit <= 1"]),
    ] {
        let refused = with_sensor(&daemon, name, Some(given)).await.expect_err("refused");
        assert!(words.iter().all(|word| refused.contains(word)), "{refused}");
    }
    for (name, given) in [("robot", weak), ("camera", own)] {
        with_sensor(&daemon, name, Some(given)).await.expect("what it has");
    }
}

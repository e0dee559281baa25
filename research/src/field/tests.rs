//! Forecasts know what their lead time allows, scores agree with hand-made cases, and recordings are read as they are.

use std::{fs, path::Path};

use tidemap_formats::table::Format;
use tidemap_model::{LocalDay, Sample, StateKind, Zone, models::Interval};

use super::{
    baselines::Baselines,
    lead::HOUR_NANOS,
    recording::ReadState,
    replay::{Forecast, MapAnswer},
    score::crps,
    *,
};
use crate::tests::recordings;

const MINUTE: i64 = HOUR_NANOS / 60;
const DAY: i64 = 24 * HOUR_NANOS;
/// A Monday.
const FIRST: i64 = 19_723 * DAY;

fn sample(utc_nanos: i64, value: f64) -> Sample {
    Sample { utc_nanos, offset_secs: 0, value }
}

fn state(kind: StateKind, samples: Vec<Sample>) -> ReadState {
    ReadState { name: "state".to_owned(), kind, samples }
}

fn recording(test_days: i32, states: Vec<ReadState>) -> ReadRecording {
    ReadRecording::new("made", Some("states"), Zone::utc(), test_days, states)
}

/// Forty days of readings every ten minutes: 0, and 1 from a time on.
fn changed_at(change_nanos: i64) -> ReadRecording {
    let times = (0..40 * 144).map(|slot| FIRST + slot * 10 * MINUTE);
    let samples = times.map(|time| sample(time, f64::from(u8::from(time >= change_nanos)))).collect();
    recording(1, vec![state(StateKind::Probability, samples)])
}

fn forecasts(recording: &ReadRecording) -> Vec<Forecast> {
    let mut all = Vec::new();
    replay(recording, &recording.learned(false), &mut |forecast| all.push(*forecast)).expect("forecasts");
    all
}

#[test]
fn a_forecast_knows_nothing_that_is_nearer_than_its_lead_time() {
    let midnight = FIRST + 39 * DAY;
    let never = forecasts(&changed_at(i64::MAX));
    assert_eq!(never.len(), 144 * Lead::ALL.len(), "all lead times have a view");
    let newest = BASELINES.iter().position(|name| *name == "newest").expect("a baseline");
    // The time of the first reading of 1, and how many forecasts of each lead time know it.
    let changes = [
        (midnight + DAY / 2, [71, 66, 0, 0, 0]),
        (midnight, [143, 138, 0, 0, 0]),
        (midnight - 10 * MINUTE, [144, 139, 144, 0, 0]),
        (midnight - 6 * DAY, [144, 144, 144, 0, 0]),
        (midnight - 6 * DAY - 10 * MINUTE, [144, 144, 144, 144, 0]),
        (midnight - 27 * DAY, [144, 144, 144, 144, 0]),
        (midnight - 27 * DAY - 10 * MINUTE, [144; Lead::ALL.len()]),
    ];
    for (change, expected) in changes {
        let mut knew = [0; Lead::ALL.len()];
        for (forecast, before) in forecasts(&changed_at(change)).iter().zip(&never) {
            let time = forecast.truth.utc_nanos;
            let last_known = match forecast.lead {
                Lead::FiveMinutes => time - 5 * MINUTE,
                Lead::Hour => time - HOUR_NANOS,
                Lead::Day => midnight - 1,
                Lead::Week => midnight - 6 * DAY - 1,
                Lead::FourWeeks => midnight - 27 * DAY - 1,
            };
            let knows = last_known >= change;
            knew[forecast.lead as usize] += usize::from(knows);
            let value = |forecast: &Forecast, model: usize| forecast.answers[model].map(|answer| answer.value);
            assert_eq!(forecast.baselines[newest], if knows { 0.98 } else { 0.02 }, "{forecast:?}");
            if !knows {
                assert_eq!(forecast.baselines, before.baselines, "{forecast:?}");
                for model in [0, 1] {
                    assert_eq!(value(forecast, model), value(before, model), "{forecast:?}");
                }
            } else if forecast.lead.is_short() {
                assert!(value(forecast, 0) > value(before, 0), "the newest reading counts: {forecast:?}");
            }
        }
        assert_eq!(knew, expected);
    }
}

#[test]
fn a_missing_recording_is_left_out_with_a_notice() {
    let folder = tempfile::tempdir().expect("a folder");
    let missing = |recordings: &[&'static str]| FieldProtocol {
        folder: folder.path().to_owned(),
        recordings: recordings.iter().filter_map(|name| FieldRecording::named(name)).collect(),
    };
    let refused = run(&missing(&["door"]), &|_, _| ()).expect_err("nothing to replay").to_string();
    assert!(refused.contains("door is left out: there is no file"), "{refused}");

    write_places(folder.path());
    let outcome = run(&missing(&["door", "brayford", "room"]), &|_, _| ()).expect("scores");
    assert!(outcome.rows.iter().all(|row| row.recording == "brayford"), "{:?}", outcome.rows);
    let [door, room] = &outcome.left_out[..] else { unreachable!("{:?}", outcome.left_out) };
    assert!(door.starts_with("door is left out: there is no file") && door.ends_with("train.csv"), "{door}");
    assert!(room.starts_with("room is left out: there is no file"), "{room}");
}

/// Five places of a week of ten-minute slots, each with somebody in hours of its own.
fn write_places(folder: &Path) {
    let places = folder.join("field/brayford");
    fs::create_dir_all(&places).expect("a folder");
    for place in 0..5 {
        let row = |slot: i64| {
            let is_there = (9 + place..12 + place).contains(&(slot % 144 / 6)) && slot % 5 > 0;
            format!("{},place{place},{}\n", (FIRST + slot * 10 * MINUTE) / 1_000_000_000, u8::from(is_there))
        };
        let rows: String = (0..7 * 144).map(row).collect();
        fs::write(places.join(format!("place{place}.csv")), format!("time,state,value\n{rows}")).expect("written");
    }
}

#[test]
fn a_week_of_places_is_scored_at_the_lead_times_that_it_has() {
    let folder = tempfile::tempdir().expect("a folder");
    write_places(folder.path());
    let protocol = FieldProtocol { folder: folder.path().to_owned(), recordings: Vec::new() };
    let outcome = run(&protocol, &|_, _| ()).expect("scores");
    assert_eq!(outcome.left_out.len(), FIELD_RECORDINGS.len() - 1);
    let models = |is_thinned: bool, lead: Lead| {
        let rows = outcome.rows.iter().filter(|row| row.is_thinned == is_thinned && row.lead == lead);
        rows.map(|row| (row.model, row.errors.predictions)).collect::<Vec<_>>()
    };
    let all = FIELD_MODELS.map(|model| (model, 2 * 144 * 5));
    for is_thinned in [false, true] {
        assert_eq!(models(is_thinned, Lead::FiveMinutes), all);
        assert_eq!(models(is_thinned, Lead::Hour), all);
        assert_eq!(models(is_thinned, Lead::Day), [&all[..1], &all[2..]].concat(), "no newest readings to blend in");
        assert_eq!(models(is_thinned, Lead::Week), [], "nothing was learned six midnights before");
        assert_eq!(models(is_thinned, Lead::FourWeeks), []);
    }
    let row = |model: &str| {
        let found = outcome.rows.iter().find(|row| !row.is_thinned && row.lead == Lead::Day && row.model == model);
        found.expect("a row")
    };
    assert!(row("auto").errors.mse() < 0.5 * row("mean").errors.mse(), "hours are learned");
    assert!(row("auto").errors.coverage().is_some() && row("mean").errors.coverage().is_none());
    let above = |row: &FieldRow| row.above_best.filter(|_| BASELINES.contains(&row.model));
    for rows in outcome.rows.chunk_by(|one, next| (one.is_thinned, one.lead) == (next.is_thinned, next.lead)) {
        let least = rows.iter().filter_map(above).fold(f64::INFINITY, f64::min);
        assert_eq!(least, 0.0, "nothing is better than the best baseline: {rows:?}");
    }

    let mut csv = Vec::new();
    summary(&outcome, Format::Csv, &mut csv).expect("written");
    let csv = String::from_utf8(csv).expect("text");
    let (header, first) = (csv.lines().next(), csv.lines().nth(1).unwrap_or_default());
    assert_eq!(header, Some("recording,states,thinned,lead,model,n,mse,loss,coverage_80,vs_best"));
    assert!(first.starts_with("brayford,5 places,false,5m,auto,1440,"), "{first}");
    write(&outcome, folder.path()).expect("written");
    assert_eq!(fs::read_to_string(folder.path().join("results.csv")).expect("a file"), csv);
    assert!(folder.path().join("seconds.csv").is_file());
}

#[test]
fn the_crps_of_a_normal_distribution_is_its_integral() {
    // At the mean: (√2 - 1)/√π deviations.
    let at_mean = (std::f64::consts::SQRT_2 - 1.0) / std::f64::consts::PI.sqrt();
    assert!((crps(3.0, 2.0, 3.0) - 2.0 * at_mean).abs() < 1e-12);
    for (mean, deviation, value) in [(0.0, 1.0, 0.7), (5.0, 0.5, 3.0), (-2.0, 3.0, 4.0)] {
        let below = |x: f64| 0.5 * (1.0 + libm::erf((x - mean) / deviation / std::f64::consts::SQRT_2));
        let square = |x: f64| (below(x) - f64::from(u8::from(x >= value))).powi(2);
        let step = 1e-4;
        let integral: f64 = (-300_000..300_000).map(|at| square(f64::from(at) * step) * step).sum();
        assert!((crps(mean, deviation, value) - integral).abs() < 1e-3, "{mean} {deviation} {value}: {integral}");
    }
    assert_eq!(crps(1.0, 0.0, 4.0), 3.0, "a certain prediction errs by its distance");
    assert_eq!(crps(1.0, 0.0, 1.0), 0.0);
}

#[test]
fn numbers_are_scored_with_the_stated_spread_or_that_of_earlier_days() {
    let values = [(0, 1.0), (1, 3.0), (2, 10.0), (3, 20.0)];
    let samples: Vec<Sample> = values.iter().map(|&(day, value)| sample(FIRST + day * DAY, value)).collect();
    let recording = recording(2, vec![state(StateKind::Continuous, samples.clone())]);
    let learned = recording.learned(false);
    let mut scorer = Scorer::new(&recording, &learned);
    let answer =
        |value: f64| MapAnswer { value, interval: Some(Interval { lower: value - 1.2816, upper: value + 1.2816 }) };
    for (truth, value) in [(samples[2], 11.0), (samples[3], 25.0)] {
        let answers = [Some(answer(value)), None];
        scorer.add(&Forecast { state: 0, truth, lead: Lead::Day, answers, baselines: [value; 5] });
    }
    let errors = &scorer.errors()[0][Lead::Day as usize];
    let [auto, ensemble, mean, ..] = errors;
    assert_eq!((auto.predictions, ensemble.predictions, mean.predictions), (2, 0, 2));
    assert_eq!((auto.mse(), mean.mse()), (13.0, 13.0));
    assert!((auto.loss() - (crps(11.0, 1.0, 10.0) + crps(25.0, 1.0, 20.0)) / 2.0).abs() < 1e-12);
    // The training data is 1 and 3; on the second test day the only earlier error is 1.
    assert!((mean.loss() - (crps(11.0, 1.0, 10.0) + crps(25.0, 1.0, 20.0)) / 2.0).abs() < 1e-12);
    assert_eq!((auto.coverage(), mean.coverage()), (Some(0.5), None));
}

#[test]
fn intervals_are_compared_with_the_mean_of_the_hour_around_a_reading() {
    let zone = Zone::named("Asia/Kolkata").expect("a zone");
    let at = |minute: i64, value: f64| Sample { utc_nanos: FIRST + minute * MINUTE, offset_secs: 19_800, value };
    let samples = vec![at(29, 100.0), at(30, 1.0), at(60, 2.0), at(89, 6.0), at(90, 100.0)];
    let recording = ReadRecording::new("made", None, zone, 1, vec![state(StateKind::Continuous, samples)]);
    assert_eq!(recording.states[0].mean_of_hour(at(60, 2.0)), 3.0);
}

#[test]
fn tables_predict_the_means_of_their_readings() {
    let learn = |kind: StateKind, readings: &[Sample]| {
        let mut tables = Baselines::new(kind);
        readings.iter().for_each(|reading| tables.learn(*reading));
        tables
    };
    // Two Mondays at 10:00 and 10:10, and a Tuesday.
    let ten = FIRST + 10 * HOUR_NANOS;
    let readings =
        [sample(ten, 1.0), sample(ten + 10 * MINUTE, 1.0), sample(ten + DAY, 0.0), sample(ten + 7 * DAY, 1.0)];
    let at = sample(ten + 14 * DAY + MINUTE, f64::NAN);
    let tables = learn(StateKind::Probability, &readings);
    let [mean, hours, fading, newest, weeks] = tables.predict(&readings, at, Lead::Day);
    assert_eq!([mean, hours, newest, weeks], [4.0 / 6.0, 4.0 / 5.0, 0.98, 0.98]);
    assert_eq!(fading, (3.0 + 4.0 / 6.0) / 4.0, "nothing has faded yet");
    let [.., weeks] = tables.predict(&readings, at, Lead::FourWeeks);
    assert_eq!(weeks, 4.0 / 6.0, "there is no reading four weeks before");

    let numbers = learn(StateKind::Continuous, &readings[..3]);
    let [mean, hours, _, newest, weeks] = numbers.predict(&readings, at, Lead::Day);
    assert_eq!([mean, hours, newest, weeks], [2.0 / 3.0, (2.0 + 2.0 / 3.0) / 3.0, 0.0, 2.0 / 3.0]);
    let mut faded = numbers.clone();
    (0..21).for_each(|_| faded.fade());
    let [.., faded, _, _] = faded.predict(&readings, at, Lead::Day);
    assert!((faded - (1.0 + 2.0 / 3.0) / 2.0).abs() < 1e-9, "after 21 days readings count half: {faded}");
}

#[test]
fn the_reading_weeks_before_has_the_same_local_time() {
    let zone = Zone::named("Europe/London").expect("a zone");
    let mut offsets = zone.offset_cache();
    // Clocks went forward on 27 March 2016.
    let noon = zone.midnight_nanos(LocalDay::parse("2016-03-24").expect("a day")) + DAY / 2;
    let mut at = |utc_nanos: i64, value: f64| Sample { utc_nanos, offset_secs: offsets.offset_secs(utc_nanos), value };
    let readings = [at(noon - HOUR_NANOS, 1.0), at(noon, 2.0), at(noon + HOUR_NANOS, 3.0)];
    let mut tables = Baselines::new(StateKind::Continuous);
    readings.iter().for_each(|reading| tables.learn(*reading));
    let noon_in_summer = at(noon + 7 * DAY - HOUR_NANOS, f64::NAN);
    assert_eq!(tables.predict(&readings, noon_in_summer, Lead::Day)[4], 2.0);
}

#[test]
fn thinning_keeps_a_share_to_learn_and_asks_the_same() {
    let recording = changed_at(FIRST);
    let (full, thinned) = (recording.learned(false), recording.learned(true));
    assert_eq!(full[0].len(), 40 * 144);
    assert!((230..350).contains(&thinned[0].len()), "{}", thinned[0].len());
    assert_eq!(thinned, recording.learned(true), "the seed is fixed");
    let asked: Vec<usize> = recording.asked.values().map(Vec::len).collect();
    assert_eq!(asked, [144]);
}

#[test]
fn days_and_readings_are_asked_evenly_spread() {
    let samples = (0..200 * 288).map(|slot| sample(FIRST + slot * 5 * MINUTE, 0.0)).collect();
    let recording = recording(120, vec![state(StateKind::Continuous, samples)]);
    let days: Vec<i32> = recording.asked.keys().map(|day| day.0).collect();
    assert_eq!((days.len(), days[0], days[59]), (60, 19_723 + 80, 19_723 + 198), "every second of the last 120 days");
    let day: Vec<i64> = recording.asked[&LocalDay(days[0])].iter().map(|(_, sample)| sample.utc_nanos).collect();
    assert_eq!((day.len(), day[1] - day[0], day[143] - day[0]), (144, 10 * MINUTE, 143 * 10 * MINUTE));
}

/// The recording of this name with one file of this text.
fn read(name: &str, file: &str, text: &str) -> Result<ReadRecording, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(file);
    fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    fs::write(&path, text).expect("written");
    let read = FieldRecording::named(name).expect("a recording").read(folder.path());
    read.map_err(|error| error.to_string()).and_then(|found| found)
}

#[test]
fn changes_hold_from_step_to_step() {
    let text = "time,state,value\n1374451230,door,0\n1374451290,door,1\n1374451295,door,0\n1374451320,door,1\n";
    let door = read("tro-door", "field/tro-door/week.csv", text).expect("a recording");
    let readings: Vec<(i64, f64)> =
        door.states[0].samples.iter().map(|sample| (sample.utc_nanos / 1_000_000_000, sample.value)).collect();
    assert_eq!(readings, [(1_374_451_260, 0.0), (1_374_451_320, 1.0)]);
}

#[test]
fn local_times_follow_the_clocks() {
    let file = "field/fremont/2013_2016.csv";
    let rows = "2013-11-03T00:00:00,1\n2013-11-03T01:00:00,2\n2013-11-03T01:00:00,3\n2013-11-03T02:00:00,4\n";
    let counts = read("fremont", file, &format!("local_time,count\n2013-03-10T02:00:00,9\n{rows}")).expect("read");
    let first = counts.states[0].samples[0].utc_nanos;
    let hours: Vec<(i64, f64)> =
        counts.states[0].samples.iter().map(|sample| ((sample.utc_nanos - first) / HOUR_NANOS, sample.value)).collect();
    assert_eq!(hours, [(0, 1.0), (1, 2.0), (2, 3.0), (3, 4.0)], "the hour that clocks skip is left out");
    let wrong = read("fremont", file, "local_time,count\n2013-03-10T01:00:00,-1\n").expect_err("no count");
    assert!(wrong.contains("line 2: count \"-1\" is not"), "{wrong}");
}

#[test]
fn stays_are_presence_in_one_place_at_a_time() {
    let text = "0 4 Hall\n4 20 Kitchen\n20 1440 Hall\n";
    let flat = read("aruba", "aruba/presence_8weeks.txt", text).expect("a recording");
    let values = |state: usize| flat.states[state].samples.iter().map(|sample| sample.value).collect::<Vec<_>>();
    let (hall, kitchen) = (values(0), values(1));
    assert_eq!((hall.len(), &hall[..3], &kitchen[..3]), (144, &[0.0, 0.0, 1.0][..], &[1.0, 1.0, 0.0][..]));
    assert_eq!(flat.groups[0].label, "2 places");
}

#[test]
fn real_recordings_have_the_test_days_that_their_sources_name() {
    let Some(field) = recordings("field") else { return };
    let data = field.parent().expect("the folder of data");
    let expected = [
        ("door", 1, "2016-03-21", "2016-04-17", 3888),
        ("velocity", 1, "2014-09-04", "2014-09-06", 144),
        ("office", 4, "2015-02-07", "2015-02-10", 4 * 576),
        ("fremont", 1, "2016-07-03", "2016-12-28", 60 * 24),
        ("bikes", 1, "2012-03-11", "2012-06-29", 1437),
        ("yosemite", 1, "2017-05-22", "2017-05-31", 1440),
        ("brayford", 5, "2014-11-22", "2014-11-23", 5 * 288),
        ("tro-door", 1, "2013-07-27", "2013-07-28", 288),
        ("aruba31", 10, "2010-12-17", "2010-12-30", 19_050),
        ("aruba", 10, "2010-12-16", "2010-12-29", 20_160),
    ];
    for (name, states, first, last, asked) in expected {
        let found = FieldRecording::named(name).expect("a recording").read(data).expect("valid");
        let recording = found.expect("it is there");
        let day = |day: Option<&LocalDay>| day.map(LocalDay::to_string).unwrap_or_default();
        let (begin, end) = (recording.asked.keys().next(), recording.asked.keys().next_back());
        let count: usize = recording.asked.values().map(Vec::len).sum();
        let known = (recording.states.len(), day(begin), day(end), count);
        assert_eq!(known, (states, first.to_owned(), last.to_owned(), asked), "{name}");
    }
}

//! Tests models of every kind: they are trained at the nightly update, and are the same when the update is repeated.

use std::{fs, io::ErrorKind, path::PathBuf};

use tidemap_map::ids::StateId;
use tidemap_model::{
    EnabledModels, StateKind, StateModel, TrainedModel,
    catalogue::{ModelKind, TRAINED_AT_NIGHT},
};

use super::*;

const DAY: i64 = 24 * HOUR;
pub(super) const DAYS: i64 = 24;

/// A state that is open by day and random during an hour of each day; every half hour.
fn day(day: i64) -> (Vec<i64>, Vec<f64>) {
    let value = |slot: i64| f64::from(u8::from((16..36).contains(&slot) && (slot * 31 + day * 17) % 13 != 5));
    let start = NOON - 12 * HOUR - (DAYS - day) * DAY;
    (0..48).map(|slot| (start + slot * HOUR / 2, value(slot))).unzip()
}

pub(super) async fn update(bench: &Bench, handle: &MapHandle, count: usize) {
    let job = bench.jobs.create(handle.spec.name.clone(), UpdateCause::Request, NOON);
    assert!(handle.send(Command::Update { until_nanos: None, cause: UpdateCause::Request, job }));
    ended(bench, count).await;
}

/// Fills a data folder with a map that was updated after each of many days, in two runs of a daemon. Returns the
/// learned model.
pub(super) async fn learn(dir: &Path, retention: Retention) -> StateModel {
    let mut learned = None;
    for days in [0..DAYS / 2, DAYS / 2..DAYS] {
        let bench = bench(dir, NOON);
        let handle = match bench.catalog.get("office") {
            Ok(handle) => handle,
            Err(_) => bench
                .catalog
                .create(MapSpec { retention, models: EnabledModels::ALL, ..spec_with(None) })
                .await
                .expect("created"),
        };
        let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
        for (updates, number) in (1..).zip(days) {
            observe(&handle, &mut robot, number).await;
            update(&bench, &handle, updates).await;
        }
        bench.catalog.stop().await;
        learned = Some(model(&handle));
    }
    learned.expect("two runs")
}

pub(super) async fn observe(handle: &MapHandle, robot: &mut Robot, number: i64) {
    let (times, values) = day(number);
    send_values(handle, robot, times, values);
    let expected = SessionEvent::Ack { durable_sequence: robot.sent, refused: Vec::new() };
    assert_eq!(robot.events.recv().await, Some(expected));
}

pub(super) fn model(handle: &MapHandle) -> StateModel {
    handle.view().model(StateId(0)).clone()
}

pub(super) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("writable");
    for entry in fs::read_dir(from).expect("readable") {
        let entry = entry.expect("readable");
        let to = to.join(entry.file_name());
        if entry.file_type().expect("known").is_dir() {
            copy(&entry.path(), &to);
        } else {
            // A file that was saved meanwhile has another name by now: the copy is as after a kill before the save.
            let copied = fs::copy(entry.path(), to);
            if !copied.as_ref().is_err_and(|error| error.kind() == ErrorKind::NotFound) {
                copied.expect("copied");
            }
        }
    }
}

/// The files of a folder, by name.
pub(super) fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("readable");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("readable").path()).collect();
    files.sort();
    files
}

#[tokio::test]
async fn updates_that_are_run_again_train_the_same_models() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let expected = learn(dir.path(), Retention::Forever).await;
    let known = expected.alternatives().expect("learned");
    // The model is trained first after seven days, then every seven days.
    let newest = known.learned_day().expect("folded").0;
    for kind in TRAINED_AT_NIGHT.into_iter().filter(|kind| kind.supports(StateKind::Probability)) {
        let (model, day) = known.trained(kind).expect("trained");
        assert_eq!((model.kind_at_night(), newest - day.0), (Some(kind), 3));
        if let TrainedModel::Calibrated(model) = model {
            assert_eq!(model.observations(), 21 * 48);
        }
    }

    for (name, checkpoints, keeps_history) in
        [("saved", 2, true), ("saved at half-time", 1, true), ("from the log", 0, true), ("only the log", 0, false)]
    {
        // The copy is opened without the index.
        let again = dir.path().join(name);
        copy(&dir.path().join("maps"), &again.join("maps"));
        fs::copy(dir.path().join("MANIFEST"), again.join("MANIFEST")).expect("copied");
        let folder = again.join("maps/00000001");
        let history = files(&folder.join("history"));
        assert_eq!(history.len(), DAYS as usize);
        if !keeps_history {
            history.iter().for_each(|file| fs::remove_file(file).expect("removed"));
        }
        let all = files(&folder.join("checkpoints"));
        assert_eq!(all.len(), 2, "{all:?}");
        all[checkpoints..].iter().for_each(|file| fs::remove_file(file).expect("removed"));

        let bench = super::bench(&again, NOON);
        let handle = bench.catalog.get("office").expect("the map");
        // The last update is repeated beside the served map.
        generation(&handle, DAYS as u64).await;
        assert_eq!(model(&handle), expected, "{name}");
        bench.catalog.stop().await;
    }
}

#[tokio::test]
async fn a_map_that_keeps_nothing_has_no_trained_model() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let learned = learn(dir.path(), Retention::None).await;
    let known = learned.alternatives().expect("learned");
    assert!(
        TRAINED_AT_NIGHT.iter().all(|&kind| learned.is_training_due(kind) == kind.supports(StateKind::Probability)
            && known.trained(kind).is_none())
    );
}

/// Learns some days with a limit of pending observations. Returns the model of the state, and the number of updates
/// that made room. One day has 48 observations.
async fn learn_with(limit: u64) -> (StateModel, usize) {
    let dir = tempfile::tempdir().expect("temporary folder");
    let bench = bench_with(dir.path(), NOON, |context| context.max_pending.observations = limit);
    let handle = create(&bench).await;
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    let mut updates = 0;
    for number in 0..17 {
        observe(&handle, &mut robot, number).await;
        if handle.view().pending() > limit || handle.view().generation() > updates as u64 {
            updates += 1;
            assert_eq!(ended(&bench, updates).await, vec![UpdateCause::PendingLimit; updates]);
            assert!(handle.view().pending() <= 48);
        }
    }
    update(&bench, &handle, updates + 1).await;
    let learned = model(&handle);
    bench.catalog.stop().await;
    (learned, updates)
}

#[tokio::test]
async fn updates_that_make_room_take_whole_days_and_train_as_others() {
    let (at_once, none) = learn_with(1000).await;
    assert_eq!(none, 0);
    let (trained, day) = at_once.alternatives().expect("learned").trained(ModelKind::Calibrated).expect("trained");
    assert!(matches!(trained, TrainedModel::Calibrated(model) if model.observations() == 14 * 48), "{trained:?}");
    assert_eq!(at_once.alternatives().and_then(|known| known.learned_day()).map(|newest| newest.0 - day.0), Some(3));
    // The second limit allows two days at most beside the day that goes on.
    for (limit, updates) in [(40, 17), (100, 8)] {
        assert_eq!(learn_with(limit).await, (at_once.clone(), updates), "{limit}");
    }
}

#[tokio::test]
async fn damaged_history_costs_the_model_and_not_the_update() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let before = learn(dir.path(), Retention::Forever).await;
    let first = files(&dir.path().join("maps/00000001/history")).into_iter().next().expect("a file");
    fs::write(first, "nothing").expect("written");
    let bench = bench(dir.path(), NOON + 9 * DAY);
    let handle = bench.catalog.get("office").expect("the map");
    let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
    observe(&handle, &mut robot, DAYS + 6).await;
    update(&bench, &handle, 1).await;
    let after = model(&handle);
    assert!(after.is_training_due(ModelKind::Calibrated), "tried again");
    assert_eq!(after.accumulator().observations(), before.accumulator().observations() + 48);
    let trained = |model: &StateModel| {
        model.alternatives().and_then(|known| known.trained(ModelKind::Calibrated)).map(|(_, day)| day)
    };
    assert!(trained(&before).is_some() && trained(&after) == trained(&before));
    bench.catalog.stop().await;
}

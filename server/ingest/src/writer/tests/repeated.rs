//! Tests an update that was cut off: it is repeated beside the map, which is served from the generation before, and has
//! the same result.

use std::fs;

use super::{
    training::{DAYS, copy, files, learn, model, observe, update},
    *,
};

/// A time after all observations.
const NOW: i64 = NOON + 9 * 24 * HOUR;

/// Keeps the turn of updates until the result is dropped.
fn keep_busy(context: &Context) -> crate::update_turns::UpdateTurn {
    context.update_turns.begin()
}

/// A data folder after a kill during the map's last update: without its checkpoint and history.
fn cut_off(from: &Path, to: &Path) {
    copy(&from.join("maps"), &to.join("maps"));
    fs::copy(from.join("MANIFEST"), to.join("MANIFEST")).expect("copied");
    let folder = to.join("maps/00000001");
    let newest = files(&folder.join("checkpoints")).pop().expect("a checkpoint");
    fs::remove_file(newest).expect("removed");
    let history = files(&folder.join("history"));
    history.iter().skip(DAYS as usize).for_each(|file| fs::remove_file(file).expect("removed"));
}

#[tokio::test]
async fn the_map_is_served_from_the_generation_before_while_its_update_is_repeated() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let whole = dir.path().join("whole");
    let before = learn(&whole, Retention::Forever).await;
    let expected = {
        let bench = bench(&whole, NOW);
        let handle = bench.catalog.get("office").expect("the map");
        let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
        for late in 0..8 {
            observe(&handle, &mut robot, DAYS + late).await;
        }
        update(&bench, &handle, 1).await;
        bench.catalog.stop().await;
        model(&handle)
    };
    assert_ne!(expected, before);
    let (last, next) = (DAYS as u64, DAYS as u64 + 1);
    let observed = (DAYS as u64 + 8) * 48;

    let mut killed = dir.path().join("killed 0");
    cut_off(&whole, &killed);
    for life in 1..=2 {
        let mut busy = None;
        let bench = bench_with(&killed, NOW, |context| busy = Some(keep_busy(context)));
        let handle = bench.catalog.get("office").expect("the map");
        // The earlier models are there, and newer observations count.
        let view = handle.view();
        assert_eq!((view.generation(), view.observations()), (last, observed + life - 1));
        assert_eq!(model(&handle), before);
        assert_eq!(bench.jobs.list().iter().map(|job| job.cause).collect::<Vec<_>>(), [UpdateCause::Request.into()]);
        let mut robot = hello(&handle, "r", 0, false).await.expect("accepted");
        robot.observe(&handle, NOON + 8 * 24 * HOUR + life as i64).await;
        let view = handle.view();
        assert_eq!((view.generation(), view.observations(), view.pending()), (last, observed + life, 8 * 48 + life));
        // This is the state after another kill.
        let from = std::mem::replace(&mut killed, dir.path().join(format!("killed {life}")));
        copy(&from.join("maps"), &killed.join("maps"));
        fs::copy(whole.join("MANIFEST"), killed.join("MANIFEST")).expect("copied");

        drop(busy);
        generation(&handle, next).await;
        assert_eq!(model(&handle), expected, "life {life}");
        assert_eq!(handle.view().pending(), life, "what came after it had begun");
        bench.catalog.stop().await;
        assert_eq!(bench.jobs.list().len(), 1);
    }
}

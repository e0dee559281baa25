//! Tests which pieces watchers get, and which pieces are kept.

use tidemap_grid::spec::Retention;
use tidemap_map::{
    event::{NewState, OffsetRun, StateKind},
    live_map::LiveMap,
    name::{MapName, StateName},
    spec::MapSpec,
};
use tokio::sync::broadcast::error::TryRecvError;

use super::*;

fn map() -> LiveMap {
    LiveMap::new(Arc::new(MapSpec {
        retention: Retention::None,
        ..MapSpec::new(MapName::new("office").expect("valid"))
    }))
}

/// `count` observations of one state, the first of them at this time.
fn observations(first: i64, count: usize) -> Observations {
    Observations {
        new_states: vec![NewState::sampled(StateId(0), StateName::new("s").expect("valid"), StateKind::Probability)],
        states: vec![StateId(0); count],
        times_nanos: (first..).take(count).collect(),
        values: vec![1.0; count],
        offsets: vec![OffsetRun { count: u32::try_from(count).expect("few"), offset_secs: 0 }],
        failures: Vec::new(),
        runs: Vec::new(),
    }
}

/// The next piece: the number of observations before it, and its times.
fn received(listening: &mut FeedReceiver) -> Result<(u64, Vec<i64>), TryRecvError> {
    match &*listening.try_recv()? {
        FeedMessage::Applied(piece) => Ok((piece.before, piece.times_nanos.clone())),
        other => panic!("{other:?}"),
    }
}

#[test]
fn observations_are_sent_in_their_order_once_they_are_public() {
    let (mut watchers, view) = (AnomalyFeed::default(), map().publish());
    let (mut listening, before) = watchers.listen();
    assert_eq!(before, 0);
    watchers.applied(&observations(10, 2));
    watchers.applied(&observations(20, 1));
    assert_eq!(received(&mut listening), Err(TryRecvError::Empty));
    watchers.send_waiting(&view);
    assert_eq!(received(&mut listening), Ok((0, vec![10, 11, 20])));
    // A later watcher gets later pieces.
    let (mut late, before) = watchers.listen();
    assert_eq!(before, 3);
    watchers.applied(&observations(0, PIECE + 1));
    watchers.send_waiting(&view);
    for listening in [&mut listening, &mut late] {
        assert_eq!(received(listening).map(|(before, times)| (before, times.len())), Ok((3, PIECE)));
        assert_eq!(received(listening), Ok((3 + PIECE as u64, vec![PIECE as i64])));
        assert_eq!(received(listening), Err(TryRecvError::Empty));
    }
    watchers.end(Ending::MapDeleted);
    assert!(matches!(&*late.try_recv().expect("an end"), FeedMessage::End(Ending::MapDeleted)));
    drop(watchers);
    assert_eq!(received(&mut late), Err(TryRecvError::Closed));
}

#[test]
fn nothing_is_kept_while_nobody_watches() {
    let (mut watchers, view) = (AnomalyFeed::default(), map().publish());
    watchers.applied(&observations(0, 5));
    assert!(watchers.waiting.is_empty());
    let (listening, _) = watchers.listen();
    watchers.applied(&observations(0, 5));
    watchers.send_waiting(&view);
    assert_eq!(watchers.models.len(), 1);
    drop(listening);
    watchers.applied(&observations(0, 5));
    watchers.send_waiting(&view);
    assert!(watchers.waiting.is_empty() && watchers.models.is_empty());
}

#[test]
fn one_who_lags_loses_the_oldest_and_can_compute_how_many() {
    let (mut watchers, view) = (AnomalyFeed::default(), map().publish());
    let (mut listening, mut expected) = watchers.listen();
    let pieces = PIECES as u64 + 10;
    for piece in 0..pieces {
        watchers.applied(&observations(piece as i64, 3));
        watchers.send_waiting(&view);
    }
    let mut missed = 0;
    let mut taken = 0;
    loop {
        match received(&mut listening) {
            Ok((before, times)) => {
                missed += before - expected;
                expected = before + times.len() as u64;
                taken += times.len() as u64;
            }
            Err(TryRecvError::Lagged(_)) => {}
            Err(_) => break,
        }
    }
    assert_eq!((missed, taken), (30, 3 * PIECES as u64));
}

#[test]
fn models_of_two_generations_are_kept_however_far_one_lags() {
    let mut map = map();
    let mut watchers = AnomalyFeed::default();
    let (mut listening, _) = watchers.listen();
    for generation in 0..4 {
        watchers.applied(&observations(generation, 1));
        watchers.send_waiting(&map.publish());
        let event = tidemap_map::event::Event::UpdateStart(map.plan_update(
            None,
            1 + generation,
            tidemap_map::event::UpdateCause::Request,
        ));
        let work = map.apply(map.position() + 1, &event).expect("it follows").expect("work");
        let result = work.run(&std::sync::atomic::AtomicU64::new(0)).expect("no tiles");
        map.finish_update(result);
    }
    let mut judged_by = Vec::new();
    while let Ok(message) = listening.try_recv() {
        let FeedMessage::Applied(piece) = &*message else { panic!("no end") };
        judged_by.push(piece.models.upgrade().map(|models| models.generation()));
    }
    assert_eq!(judged_by, [None, None, Some(2), Some(3)]);
}

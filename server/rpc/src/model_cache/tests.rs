//! Tests which trained models are kept, for how long, and how often one is trained.

use std::{
    convert::Infallible,
    sync::atomic::{AtomicU32, Ordering},
};

use tidemap_model::{
    Sample, TrainedModel,
    models::{MarkovChain, Readings},
};
use tokio::sync::Notify;

use super::*;

fn key(state: u32) -> ModelKey {
    let kind = ModelKind::PERGAM;
    ModelKey { map: MapId(1), handle: 1, generation: 1, subject: Subject::State(StateId(state)), kind, place: None }
}

/// A model that is identified by its newest value.
fn model(value: f64) -> CachedModel {
    let samples = [Sample { utc_nanos: 5, offset_secs: 0, value }];
    CachedModel::Trained(TrainedModel::Persistence(MarkovChain::train(Readings::new(&samples)).expect("a reading")))
}

fn value(trained: &CachedModel) -> f64 {
    let CachedModel::Trained(TrainedModel::Persistence(chain)) = trained else { panic!("{trained:?}") };
    chain.to_parts().last_value
}

async fn keep(cache: &ModelCache, key: ModelKey, value: f64) {
    cache.get_or_train(key, async { Ok::<_, Infallible>(model(value)) }).await.expect("trained");
}

#[tokio::test]
async fn a_model_is_trained_once_however_many_ask_for_it() {
    let cache = Arc::new(ModelCache::new(10));
    let (trained, go) = (Arc::new(AtomicU32::new(0)), Arc::new(Notify::new()));
    let asking: Vec<_> = (0..8)
        .map(|_| {
            let (cache, trained, go) = (Arc::clone(&cache), Arc::clone(&trained), Arc::clone(&go));
            tokio::spawn(async move {
                let training = async {
                    trained.fetch_add(1, Ordering::Relaxed);
                    go.notified().await;
                    Ok::<_, Infallible>(model(0.25))
                };
                cache.get_or_train(key(1), training).await.map(|trained| value(&trained))
            })
        })
        .collect();
    // While this model is trained, others are requested and trained.
    while trained.load(Ordering::Relaxed) == 0 {
        tokio::task::yield_now().await;
    }
    assert!(cache.get(&key(1)).is_none());
    keep(&cache, key(2), 0.5).await;
    assert_eq!(cache.get(&key(2)).map(|trained| value(&trained)), Some(0.5));
    go.notify_one();
    for waiting in asking {
        assert_eq!(waiting.await.expect("no panic"), Ok(0.25));
    }
    keep(&cache, key(1), 1.0).await;
    assert_eq!(cache.get(&key(1)).map(|trained| value(&trained)), Some(0.25));
    assert_eq!(trained.load(Ordering::Relaxed), 1);
}

#[tokio::test]
async fn the_least_recently_used_model_goes() {
    let cache = ModelCache::new(3);
    for state in 1..=3 {
        keep(&cache, key(state), 0.5).await;
    }
    assert!(cache.get(&key(1)).is_some());
    keep(&cache, key(2), 0.5).await;
    keep(&cache, key(4), 0.5).await;
    let kept: Vec<u32> = (1..=4).filter(|&state| cache.get(&key(state)).is_some()).collect();
    assert_eq!(kept, [1, 2, 4]);
    // These models were just looked up, so 1 is the oldest.
    keep(&cache, key(5), 0.5).await;
    keep(&cache, key(6), 0.5).await;
    let kept: Vec<u32> = (1..=6).filter(|&state| cache.get(&key(state)).is_some()).collect();
    assert_eq!(kept, [4, 5, 6]);
    let inner = cache.entries.lock().expect("no panic");
    assert_eq!((inner.slots.len(), inner.by_use.len()), (3, 3));
}

#[tokio::test]
async fn whatever_differs_is_another_model() {
    let cache = ModelCache::new(10);
    let others = [
        ModelKey { map: MapId(2), ..key(1) },
        ModelKey { handle: 2, ..key(1) },
        ModelKey { generation: 2, ..key(1) },
        ModelKey { kind: ModelKind::PERGAM.with_count(4), ..key(1) },
        ModelKey { kind: ModelKind::PERGAM.with_period(7 * ModelKind::PERIOD_NANOS), ..key(1) },
        ModelKey { kind: ModelKind::Uniform, ..key(1) },
        ModelKey { place: Some(StateId(7)), ..key(1) },
        ModelKey { kind: ModelKind::HypertimeEm { clusters: 3 }, ..key(1) },
        key(2),
    ];
    keep(&cache, key(1), 0.5).await;
    for other in others {
        assert!(cache.get(&other).is_none(), "{other:?}");
    }
}

#[tokio::test]
async fn a_training_that_failed_is_not_kept() {
    let cache = ModelCache::new(2);
    keep(&cache, key(1), 0.5).await;
    keep(&cache, key(2), 0.5).await;
    for state in 3..20 {
        let failed = cache.get_or_train(key(state), async { Err("no readings") }).await;
        assert_eq!(failed.err(), Some("no readings"));
        assert!(cache.get(&key(state)).is_none());
    }
    keep(&cache, key(3), 0.75).await;
    assert_eq!(cache.get(&key(3)).map(|trained| value(&trained)), Some(0.75));
}

#[tokio::test]
async fn a_model_that_is_being_trained_is_not_given_up_for_others() {
    let cache = Arc::new(ModelCache::new(1));
    let (go, started) = (Arc::new(Notify::new()), Arc::new(Notify::new()));
    let running = {
        let (cache, go, started) = (Arc::clone(&cache), Arc::clone(&go), Arc::clone(&started));
        tokio::spawn(async move {
            let training = async {
                started.notify_one();
                go.notified().await;
                Ok::<_, Infallible>(model(0.25))
            };
            cache.get_or_train(key(1), training).await.map(drop)
        })
    };
    started.notified().await;
    keep(&cache, key(2), 0.5).await;
    keep(&cache, key(3), 0.5).await;
    go.notify_one();
    assert_eq!(running.await.expect("no panic"), Ok(()));
    assert_eq!(cache.get(&key(1)).map(|trained| value(&trained)), Some(0.25));
    // The extra model is removed with the next one.
    keep(&cache, key(4), 0.5).await;
    assert_eq!(cache.entries.lock().expect("no panic").slots.len(), 1);
}

#[tokio::test]
async fn a_training_goes_on_while_anybody_waits_and_never_again_once_stopped() {
    let cache = ModelCache::<CachedModel>::new(3);
    let (one, other) = (cache.interest(key(1)), cache.interest(key(1)));
    let stop = one.training_stop();
    drop(one);
    assert!(!stop.is_set(), "the other waits");
    drop(other);
    assert!(stop.is_set());
    // A request at this time gets a training of its own.
    let late = cache.interest(key(1));
    assert!(stop.is_set() && !late.training_stop().is_set());
}

//! Views from many viewpoints at many times, on all threads.
//!
//! Invariant: an invalid viewpoint results in an error of its own and does not affect the others. The cost of a request
//! is known before the work begins.

use std::{
    collections::HashMap,
    ops::ControlFlow,
    sync::{Arc, Mutex, PoisonError},
};

use rayon::prelude::*;

use tidemap_model::{EarlyStop, StopSignal};

use super::{Fan, InvalidSensor, Sensor, TimedScene, TimedViewScorer, ViewError, Viewpoint};

/// Number of viewpoints between two reports.
const ROUND: usize = 64;
/// Maximum number of kept fans of different yaws.
const FANS: usize = 16;

/// The limits of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewLimits {
    /// Viewpoints x times x cells of one unobstructed view.
    pub max_work: u64,
}

impl Default for ViewLimits {
    /// The limit is 10^12: some minutes on two cores.
    fn default() -> ViewLimits {
        ViewLimits { max_work: 1_000_000_000_000 }
    }
}

/// The reason why many views are refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TooMuchWork {
    /// The request is too expensive.
    #[error(
        "{views} views at {times} times pass {work} cells, at most {max} are allowed: request fewer views \
         or times, or a shorter range"
    )]
    Work { views: usize, times: usize, work: u128, max: u64 },
    /// The sensor is invalid.
    #[error(transparent)]
    Sensor(#[from] InvalidSensor),
    /// The work received the signal to stop.
    #[error(transparent)]
    Stop(#[from] EarlyStop),
}

/// Fans by yaw.
struct Fans<'a> {
    sensor: &'a Sensor,
    scene: &'a TimedScene,
    stop: StopSignal<'a>,
    known: Mutex<HashMap<u64, Arc<Fan>>>,
}

impl Fans<'_> {
    fn of(&self, yaw_rad: f64) -> Result<Arc<Fan>, InvalidSensor> {
        let yaw = if self.sensor.is_all_around() { 0.0 } else { yaw_rad };
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(fan) = known().get(&yaw.to_bits()) {
            return Ok(Arc::clone(fan));
        }
        // The fan is made without the lock, so that other threads can continue.
        let fan = Arc::new(Fan::until(self.sensor, self.scene.lattice(), yaw, self.stop)?);
        let mut known = known();
        if known.len() >= FANS {
            known.clear();
        }
        known.insert(yaw.to_bits(), Arc::clone(&fan));
        Ok(fan)
    }
}

/// The expected information in bits of each viewpoint at each of the scene's times; `None` at times at which its cell
/// is probably occupied. Each result is reported with the viewpoint's number, in order, as soon as possible; an invalid
/// viewpoint results in its error. [`ControlFlow::Break`] stops the work. Runs on the threads of rayon's pool. A sensor
/// that is not all around needs a [`Fan`] for each distinct yaw.
///
/// # Errors
/// [`TooMuchWork`], before the work begins; [`TooMuchWork::Stop`].
pub fn view_many(
    scene: &TimedScene,
    sensor: &Sensor,
    viewpoints: &[Viewpoint],
    limits: ViewLimits,
    stop: StopSignal<'_>,
    mut report: impl FnMut(usize, Result<Vec<Option<f64>>, ViewError>) -> ControlFlow<()>,
) -> Result<(), TooMuchWork> {
    let fans = Fans { sensor, scene, stop, known: Mutex::default() };
    let first = fans.of(viewpoints.iter().map(|at| at.yaw_rad).find(|yaw| yaw.is_finite()).unwrap_or(0.0))?;
    stop.check()?;
    let (views, times) = (viewpoints.len(), scene.times());
    let work = views as u128 * times as u128 * first.len() as u128;
    if work > u128::from(limits.max_work) {
        return Err(TooMuchWork::Work { views, times, work, max: limits.max_work });
    }
    for (round, viewpoints) in viewpoints.chunks(ROUND).enumerate() {
        let evaluate = |scorer: &mut TimedViewScorer, at: &Viewpoint| {
            let from = match scene.stand(sensor, at) {
                Ok(from) => from,
                Err(error) => return Ok(Err(error)),
            };
            stop.check()?;
            Ok(Ok(scorer.view_until(scene, fans.of(at.yaw_rad)?.as_ref(), from, stop)))
        };
        let views: Vec<Result<_, TooMuchWork>> =
            viewpoints.par_iter().map_init(|| TimedViewScorer::new(&first), evaluate).collect();
        stop.check()?;
        for (number, view) in (round * ROUND..).zip(views) {
            if report(number, view?).is_break() {
                return Ok(());
            }
        }
    }
    Ok(())
}

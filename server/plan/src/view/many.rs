//! Many viewpoints, at many times, on all threads.
//!
//! Invariant: a viewpoint from which nobody can look has its reason told and costs the others nothing. What a question
//! may cost is known before it is answered.

use std::{
    collections::HashMap,
    ops::ControlFlow,
    sync::{Arc, Mutex, PoisonError},
};

use rayon::prelude::*;

use super::{Fan, InvalidSensor, Sensor, TimedScene, TimedViewScorer, ViewError, Viewpoint};

/// Viewpoints that are looked from between two rounds of telling.
const ROUND: usize = 64;
/// Fans of different yaws that are kept.
const FANS: usize = 16;

/// What a question may cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewLimits {
    /// Viewpoints x times x cells that the rays pass of one view where nothing is in their way.
    pub max_work: u64,
}

impl Default for ViewLimits {
    /// 10^12: some minutes on two cores.
    fn default() -> ViewLimits {
        ViewLimits { max_work: 1_000_000_000_000 }
    }
}

/// Why many looks are not taken.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TooMuchWork {
    /// They would cost too much.
    #[error(
        "{views} views at {times} times pass {work} cells, and may pass {max}: ask for fewer views or times, or a shorter range"
    )]
    Work { views: usize, times: usize, work: u128, max: u64 },
    /// The sensor is none.
    #[error(transparent)]
    Sensor(#[from] InvalidSensor),
}

/// Fans by yaw.
struct Fans<'a> {
    sensor: &'a Sensor,
    scene: &'a TimedScene,
    known: Mutex<HashMap<u64, Arc<Fan>>>,
}

impl Fans<'_> {
    fn of(&self, yaw_rad: f64) -> Result<Arc<Fan>, InvalidSensor> {
        let yaw = if self.sensor.is_all_around() { 0.0 } else { yaw_rad };
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(fan) = known().get(&yaw.to_bits()) {
            return Ok(Arc::clone(fan));
        }
        // Not under the lock: others look meanwhile.
        let fan = Arc::new(Fan::new(self.sensor, self.scene.lattice(), yaw)?);
        let mut known = known();
        if known.len() >= FANS {
            known.clear();
        }
        known.insert(yaw.to_bits(), Arc::clone(&fan));
        Ok(fan)
    }
}

/// Information in bits that each viewpoint is expected to give at each of the scene's times; `None` at times at which
/// its cell is probably occupied. Each result is told with the viewpoint's number, in their order, as soon as those
/// before are told; a viewpoint from which nobody can look has its reason. [`ControlFlow::Break`] ends it. On the
/// threads of rayon's pool. A sensor that does not look all around needs a [`Fan`] for each distinct yaw.
///
/// # Errors
/// [`TooMuchWork`], before the work begins.
pub fn look_many(
    scene: &TimedScene,
    sensor: &Sensor,
    viewpoints: &[Viewpoint],
    limits: ViewLimits,
    mut tell: impl FnMut(usize, Result<Vec<Option<f64>>, ViewError>) -> ControlFlow<()>,
) -> Result<(), TooMuchWork> {
    let fans = Fans { sensor, scene, known: Mutex::default() };
    let first = fans.of(viewpoints.iter().map(|at| at.yaw_rad).find(|yaw| yaw.is_finite()).unwrap_or(0.0))?;
    let (views, times) = (viewpoints.len(), scene.times());
    let work = views as u128 * times as u128 * first.len() as u128;
    if work > u128::from(limits.max_work) {
        return Err(TooMuchWork::Work { views, times, work, max: limits.max_work });
    }
    for (round, viewpoints) in viewpoints.chunks(ROUND).enumerate() {
        let look = |looker: &mut TimedViewScorer, at: &Viewpoint| {
            let from = match scene.stand(sensor, at) {
                Ok(from) => from,
                Err(error) => return Ok(Err(error)),
            };
            Ok(Ok(looker.look(scene, fans.of(at.yaw_rad)?.as_ref(), from)))
        };
        let told: Vec<Result<_, InvalidSensor>> =
            viewpoints.par_iter().map_init(|| TimedViewScorer::new(&first), look).collect();
        for (number, told) in (round * ROUND..).zip(told) {
            if tell(number, told?).is_break() {
                return Ok(());
            }
        }
    }
    Ok(())
}

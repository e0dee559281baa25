//! Tours: the viewpoints of one exploration tour, and the order of the drive (RA-L, section III.E and G).
//!
//! Candidates are the points of a uniform grid to which the robot can drive. The value of a candidate is the
//! information of its view times the probability of reaching it (RA-L eq. 4). Goals are chosen greedily, and each
//! chosen goal lowers the value of candidates that see the same cells. Then they are ordered by the shortest drive.
//!
//! Invariant: the same request gives the same tour, bit by bit; ties: the candidate with the lowest y, then x. Requests
//! that are too expensive are refused before the work begins.

use rayon::prelude::*;
use tidemap_map::{no_go::NoGoAreas, reachability::Reachability};
use tidemap_model::StopSignal;

use crate::{
    predicted::PredictedGrid,
    travel::{Column, Distances, TravelGrid},
    view::{Fan, Scene},
};

mod budget;
mod choose;
mod order;
mod path;
mod question;

#[cfg(test)]
mod tests;

use budget::TourBudget;
use choose::{GoalSelection, TourGoal};
use order::Ways;
use path::TourPaths;
use question::TourCandidate;
pub use question::{GOALS_MAX, START_TOLERANCE_M, TourEnd, TourError, TourQuestion};

/// The reason why a tour has no goal.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum NoTour {
    /// There is no free place at or near the start.
    #[error("nothing within {START_TOLERANCE_M} m of the start is free for the robot")]
    StartBlocked,
    /// No candidate is reachable with a free view.
    #[error("no place on the candidates' grid can be reached and has a free view")]
    NothingReachable,
    /// There are candidates, but no information.
    #[error("no reachable place has information to gain")]
    NothingToLearn,
    /// No goal fits into the time.
    #[error("the time for the tour is {budget_secs} s, and the nearest goal alone takes {least_secs} s")]
    Budget { budget_secs: f64, least_secs: f64 },
}

/// A goal of a tour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TourStep {
    /// Position of the goal: x and y in the map's frame, metres.
    pub at_m: [f64; 2],
    /// Expected information of the view beyond that of the goals chosen before, bits.
    pub information_bits: f64,
    /// Probability of reaching the goal, in (0, 1].
    pub reachability: f64,
    /// Arrival of the robot at the goal, seconds from its start.
    pub arrival_secs: f64,
}

/// A tour. The planner gives a [`NoTour`] as the reason why there is no goal; a user receives it as text.
#[derive(Clone, Debug, PartialEq)]
pub struct Tour<R = NoTour> {
    /// Goals in the order of the drive.
    pub steps: Vec<TourStep>,
    /// Sum of the goals' information if all are reached, bits.
    pub information_bits: f64,
    /// Sum of the goals' information, each times the probability of reaching the goal, bits: E_G of RA-L, section
    /// III.E, with the new information at each goal.
    pub expected_bits: f64,
    /// The drive around obstacles, from the start to the end: points with straight lines between them, x and y in the
    /// map's frame, metres. Empty without a goal.
    pub path_m: Vec<[f64; 2]>,
    /// Length of the drive, metres.
    pub length_m: f64,
    /// Duration, observations included, seconds.
    pub duration_secs: f64,
    /// Number of reachable candidates with a free view.
    pub candidates: usize,
    /// The reason why there is no goal, if there is none.
    pub no_tour: Option<R>,
}

impl Tour {
    fn none(no_tour: Option<NoTour>, candidates: usize) -> Tour {
        Tour {
            steps: Vec::new(),
            information_bits: 0.0,
            expected_bits: 0.0,
            path_m: Vec::new(),
            length_m: 0.0,
            duration_secs: 0.0,
            candidates,
            no_tour,
        }
    }
}

/// The best tour through a predicted grid, by RA-L's greedy choice. It runs on the threads of rayon's pool.
///
/// A tour without a goal gives its reason. Up to 12 goals are in the shortest order; more goals are in a good order.
/// Goals that do not fit into the time are omitted, first those with the least information for their time.
///
/// # Errors
/// [`TourError`], before the work begins; [`TourError::Stop`].
pub fn plan_tour(
    grid: &PredictedGrid,
    reachability: &Reachability,
    question: &TourQuestion,
    stop: StopSignal<'_>,
) -> Result<Tour, TourError> {
    question.check(grid)?;
    let fan = Fan::until(&question.sensor, grid.lattice(), question.yaw_rad, stop)?;
    stop.check()?;
    plan_tour_with(&fan, grid, reachability, question, stop)
}

/// Does the same as [`plan_tour`], but drives through no closed area.
///
/// # Errors
/// The errors are those of [`plan_tour`].
pub fn plan_tour_around(
    grid: &PredictedGrid,
    (reachability, no_go): (&Reachability, &NoGoAreas),
    question: &TourQuestion,
    stop: StopSignal<'_>,
) -> Result<Tour, TourError> {
    question.check(grid)?;
    let fan = Fan::until(&question.sensor, grid.lattice(), question.yaw_rad, stop)?;
    stop.check()?;
    let tour = find_tour(&fan, grid, (reachability, no_go), question, stop);
    stop.check()?;
    tour
}

/// Does the same as [`plan_tour`] with an existing fan of rays, which many tours on regions of one size can share.
///
/// # Errors
/// [`TourError`], before the work begins; [`TourError::Stop`]; [`TourError::OtherFan`] for rays that do not match the
/// request.
pub fn plan_tour_with(
    fan: &Fan,
    grid: &PredictedGrid,
    reachability: &Reachability,
    question: &TourQuestion,
    stop: StopSignal<'_>,
) -> Result<Tour, TourError> {
    let tour = find_tour(fan, grid, (reachability, &NoGoAreas::default()), question, stop);
    stop.check()?;
    tour
}

/// The tour; must not be used if the signal is set.
fn find_tour(
    fan: &Fan,
    grid: &PredictedGrid,
    (reachability, no_go): (&Reachability, &NoGoAreas),
    question: &TourQuestion,
    stop: StopSignal<'_>,
) -> Result<Tour, TourError> {
    question.check(grid)?;
    if !fan.is_of(&question.sensor, grid.lattice(), question.yaw_rad) {
        return Err(TourError::OtherFan);
    }
    let mut travel = TravelGrid::until(grid, &question.travel, stop)?;
    if !no_go.is_empty() {
        travel.close(no_go, question.travel.radius_m, stop);
    }
    let scene = Scene::until(grid, &question.scene, stop)?;
    stop.check()?;
    let [x_m, y_m] = question.start_m;
    let Some((start, gap_m)) = travel.nearest(x_m, y_m, START_TOLERANCE_M) else {
        return Ok(Tour::none(Some(NoTour::StartBlocked), 0));
    };
    let from_start = travel.distances_until(start, stop);
    stop.check()?;
    let candidates = question.candidates(&scene, &travel, &from_start, grid, reachability);
    if candidates.is_empty() {
        return Ok(Tour::none(Some(NoTour::NothingReachable), 0));
    }
    let mut choice = GoalSelection::new(&scene, fan, &candidates, stop);
    let chosen = choice.choose(question.goals);
    stop.check()?;
    if chosen.is_empty() {
        return Ok(Tour::none(Some(NoTour::NothingToLearn), candidates.len()));
    }
    let goals: Vec<Column> = chosen.iter().map(|goal| candidates[goal.candidate].column).collect();
    let between: Vec<Distances> = goals.par_iter().map(|&goal| travel.distances_until(goal, stop)).collect();
    stop.check()?;
    let to_start = |&goal: &Column| from_start.to(goal).unwrap_or(f64::INFINITY) + gap_m;
    let ways = Ways::new(goals.iter().map(to_start).collect(), question.end == TourEnd::Start, stop, |one, other| {
        between[one].to(goals[other]).unwrap_or(f64::INFINITY)
    });
    let values: Vec<f64> = chosen.iter().map(|goal| goal.bits * candidates[goal.candidate].reachability).collect();
    let budget = TourBudget {
        ways: &ways,
        values: &values,
        secs_m: question.speed_m_per_s.recip(),
        observation_secs: question.observation_secs,
        budget_secs: question.budget_secs.unwrap_or(f64::INFINITY),
    };
    let order = budget.select();
    stop.check()?;
    if order.is_empty() {
        let (budget_secs, least_secs) = (budget.budget_secs, budget.least_secs());
        return Ok(Tour::none(Some(NoTour::Budget { budget_secs, least_secs }), candidates.len()));
    }
    let paths = TourPaths { travel: &travel, start, from_start: &from_start, goals: &goals, between: &between };
    let path_m = paths.path_m(question.start_m, &order, question.end);
    Ok(Tour { path_m, ..tour_of(&scene, &candidates, &chosen, &order, &budget) })
}

/// The tour through goals in an order.
fn tour_of(
    scene: &Scene,
    candidates: &[TourCandidate],
    chosen: &[TourGoal],
    order: &[usize],
    budget: &TourBudget,
) -> Tour {
    let mut tour = Tour::none(None, candidates.len());
    let mut new_bits = vec![0.0; chosen.len()];
    let mut covered = vec![false; scene.lattice().held()];
    // The goals in the order of choice, without those that do not fit.
    for (goal, chosen) in chosen.iter().enumerate().filter(|(goal, _)| order.contains(goal)) {
        for &place in &chosen.seen {
            if !std::mem::replace(&mut covered[place as usize], true) {
                new_bits[goal] += scene.bits_at(place as usize);
            }
        }
    }
    for (step, &goal) in order.iter().enumerate() {
        let TourCandidate { at_m, reachability, .. } = candidates[chosen[goal].candidate];
        let driven_m = budget.ways.to_last(&order[..=step]);
        tour.steps.push(TourStep {
            at_m,
            information_bits: new_bits[goal],
            reachability,
            arrival_secs: driven_m * budget.secs_m + step as f64 * budget.observation_secs,
        });
        tour.information_bits += new_bits[goal];
        tour.expected_bits += new_bits[goal] * reachability;
    }
    tour.length_m = budget.ways.length(order);
    tour.duration_secs = budget.duration_secs(order);
    tour
}

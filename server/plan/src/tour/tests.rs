//! Tours in drawn rooms, and their parts against naive oracles.

use std::{
    collections::HashSet,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use proptest::prelude::*;
use tidemap_grid::index::{CellBox, CellIndex};
use tidemap_model::EarlyStop;

use super::*;
use crate::{
    predicted::{Lattice, tests::spec},
    travel::{TravelOptions, tests::drawn},
    view::{SceneOptions, Sensor, ViewScorer},
};

/// A room of cells of 10 cm with walls around it; `p` gives each cell's probability of being occupied.
fn room(width: i32, depth: i32, p: impl Fn(i32, i32) -> f32) -> PredictedGrid {
    let max = CellIndex { x: width, y: depth, z: 1 };
    let lattice = Lattice::new(&spec(true), CellBox { min: CellIndex::default(), max }, 1 << 20).unwrap();
    PredictedGrid::from_fn(Arc::new(lattice), |CellIndex { x, y, .. }| {
        let is_wall = x == 0 || y == 0 || x == width - 1 || y == depth - 1;
        Some(if is_wall { 1.0 } else { p(x, y) })
    })
}

fn at(grid: &PredictedGrid, x: i32, y: i32) -> [f64; 2] {
    let [x_m, y_m, _] = grid.lattice().centre_m(CellIndex { x, y, z: 0 });
    [x_m, y_m]
}

fn question(grid: &PredictedGrid, x: i32, y: i32) -> TourQuestion {
    TourQuestion {
        start_m: at(grid, x, y),
        spacing_m: 0.4,
        goals: 3,
        sensor: Sensor { range_m: 0.8, ..Sensor::default() },
        travel: TravelOptions { radius_m: 0.1, ..TravelOptions::default() },
        ..TourQuestion::default()
    }
}

fn tour(grid: &PredictedGrid, question: &TourQuestion) -> Tour {
    plan_tour(grid, &Reachability::default(), question, StopSignal::NEVER).unwrap()
}

/// Two corners of a room with changes, one with more.
fn two_corners() -> PredictedGrid {
    room(60, 30, |x, y| match (x, y) {
        (45.., 20..) => 0.5,
        (..15, 20..) => 0.4,
        _ => 0.0,
    })
}

#[test]
fn goals_lie_where_there_is_something_to_learn() {
    let grid = two_corners();
    let plan = tour(&grid, &TourQuestion { goals: 2, ..question(&grid, 30, 5) });
    assert_eq!((plan.steps.len(), plan.no_tour), (2, None));
    let [left, right] = [at(&grid, 15, 0)[0] + 0.3, at(&grid, 45, 0)[0] - 0.3];
    assert!(plan.steps.iter().any(|step| step.at_m[0] < left));
    assert!(plan.steps.iter().any(|step| step.at_m[0] > right));
    for step in &plan.steps {
        assert_eq!(step.reachability, 0.5);
    }
    // The corners share no cell, so the first goal has the same worth as a single goal.
    let alone = tour(&grid, &TourQuestion { goals: 1, ..question(&grid, 30, 5) }).information_bits;
    assert!(plan.steps.iter().any(|step| (step.information_bits - alone).abs() < 1e-9));
    let bits: f64 = plan.steps.iter().map(|step| step.information_bits).sum();
    assert!((plan.information_bits - bits).abs() < 1e-9 && (plan.expected_bits - bits / 2.0).abs() < 1e-9);
}

#[test]
fn arrivals_are_the_drive_and_the_looks_before() {
    let grid = two_corners();
    let ask = TourQuestion { goals: 2, speed_m_per_s: 0.5, observation_secs: 10.0, ..question(&grid, 30, 5) };
    let plan = tour(&grid, &ask);
    let travel = TravelGrid::new(&grid, &ask.travel).unwrap();
    let columns: Vec<Column> =
        plan.steps.iter().map(|step| travel.column_at(step.at_m[0], step.at_m[1]).unwrap()).collect();
    let from_start = travel.distances(travel.column_at(ask.start_m[0], ask.start_m[1]).unwrap());
    let between = travel.distances(columns[0]).to(columns[1]).unwrap();
    let [first, back] = [from_start.to(columns[0]).unwrap(), from_start.to(columns[1]).unwrap()];
    assert!((plan.steps[0].arrival_secs - first / 0.5).abs() < 1e-9);
    assert!((plan.steps[1].arrival_secs - ((first + between) / 0.5 + 10.0)).abs() < 1e-9);
    assert!((plan.length_m - (first + between + back)).abs() < 1e-9);
    assert!((plan.duration_secs - (plan.length_m / 0.5 + 20.0)).abs() < 1e-9);
    let open = tour(&grid, &TourQuestion { end: TourEnd::LastGoal, ..ask });
    assert!((open.length_m - (first.min(back) + between)).abs() < 1e-9);
}

#[test]
fn goals_are_apart_where_views_overlap() {
    let grid = room(60, 60, |_, _| 0.5);
    let ask = TourQuestion { goals: 5, ..question(&grid, 30, 30) };
    let plan = tour(&grid, &ask);
    assert_eq!(plan.steps.len(), 5);
    for (number, one) in plan.steps.iter().enumerate() {
        for other in &plan.steps[..number] {
            let apart = (one.at_m[0] - other.at_m[0]).hypot(one.at_m[1] - other.at_m[1]);
            assert!(apart >= 1.2, "{apart} m");
        }
    }
}

#[test]
fn a_view_that_shares_all_is_not_taken_twice() {
    // The room is so small that one view sees all of it.
    let grid = room(9, 9, |_, _| 0.5);
    let plan = tour(&grid, &TourQuestion { spacing_m: 0.1, ..question(&grid, 4, 4) });
    assert_eq!(plan.steps.len(), 1);
}

#[test]
fn obstacles_are_in_the_way() {
    // A wall with a door at the far end: the place behind it is near only in a straight line.
    let wall = |door: bool| {
        room(60, 30, move |x, y| match (x, y) {
            (30, 24..) if door => 0.0,
            (30, _) => 1.0,
            (33..40, ..6) => 0.5,
            _ => 0.0,
        })
    };
    let grid = wall(true);
    let ask = TourQuestion { goals: 1, ..question(&grid, 26, 3) };
    let plan = tour(&grid, &ask);
    assert!(plan.steps[0].at_m[0] > at(&grid, 30, 0)[0]);
    assert!(plan.length_m > 2.0 * 3.5, "{} m", plan.length_m);
    let closed = wall(false);
    let plan = tour(&closed, &ask);
    assert_eq!(plan.no_tour, Some(NoTour::NothingToLearn));
    assert!(plan.steps.is_empty() && plan.candidates > 0);
}

#[test]
fn a_tour_without_a_goal_gives_the_reason() {
    let grid = two_corners();
    let ask = question(&grid, 30, 5);
    let shut_in = drawn(&["#####", "#.###", "#####", "####.", "####."]);
    let start_m = at(&shut_in, 1, 3);
    let none = |spacing_m| TourQuestion { start_m, spacing_m, ..question(&shut_in, 1, 3) };
    assert_eq!(tour(&shut_in, &none(0.2)).no_tour, Some(NoTour::StartBlocked));
    let thin = TravelOptions { radius_m: 0.0, ..TravelOptions::default() };
    let narrow = TourQuestion { travel: thin, spacing_m: 0.5, ..none(0.5) };
    assert_eq!(tour(&shut_in, &narrow).no_tour, Some(NoTour::NothingReachable));

    let mut failed = Reachability::default();
    for x in -10..30 {
        for y in -10..30 {
            failed.report(f64::from(x) * 0.5 + 0.1, f64::from(y) * 0.5 + 0.1, false, 0).unwrap();
        }
    }
    let plan = plan_tour(&grid, &failed, &ask, StopSignal::NEVER).unwrap();
    assert_eq!(plan.no_tour, Some(NoTour::NothingReachable));

    let plan = tour(&grid, &TourQuestion { budget_secs: Some(30.0), ..ask });
    let Some(NoTour::Budget { budget_secs, least_secs }) = plan.no_tour else { panic!("{plan:?}") };
    assert!(budget_secs == 30.0 && least_secs > 60.0 && plan.steps.is_empty());
}

#[test]
fn a_charger_may_stand_at_a_wall() {
    let grid = two_corners();
    let ask = TourQuestion { goals: 1, ..question(&grid, 30, 0) };
    assert_eq!(tour(&grid, &ask).steps.len(), 1);
}

#[test]
fn places_that_were_not_reached_are_worth_less() {
    let grid = two_corners();
    let mut known = Reachability::default();
    for x in 0..20 {
        for y in 0..20 {
            let (x_m, y_m) = (f64::from(x) * 0.5 + 0.1, f64::from(y) * 0.5 - 2.0);
            // The right half is hard to reach: one attempt in five.
            for attempt in 0..5 {
                known.report(x_m, y_m, attempt == 0 || x_m < at(&grid, 30, 0)[0], 0).unwrap();
            }
        }
    }
    let ask = TourQuestion { goals: 1, ..question(&grid, 30, 5) };
    assert!(tour(&grid, &ask).steps[0].at_m[0] > at(&grid, 30, 0)[0]);
    let plan = plan_tour(&grid, &known, &ask, StopSignal::NEVER).unwrap();
    assert!(plan.steps[0].at_m[0] < at(&grid, 30, 0)[0]);
    assert_eq!(plan.steps[0].reachability, 1.0);
}

#[test]
fn what_fits_into_the_time_is_kept() {
    let grid = room(80, 30, |_, _| 0.5);
    let ask = TourQuestion { goals: 6, observation_secs: 10.0, ..question(&grid, 5, 15) };
    let whole = tour(&grid, &ask);
    let mut before = 7;
    for budget_secs in [whole.duration_secs, 60.0, 40.0, 25.0, 15.0] {
        let plan = tour(&grid, &TourQuestion { budget_secs: Some(budget_secs), ..ask });
        assert!(plan.duration_secs <= budget_secs && plan.steps.len() < before, "{plan:?}");
        assert!(!plan.steps.is_empty());
        before = plan.steps.len() + 1;
    }
    assert_eq!(tour(&grid, &TourQuestion { budget_secs: Some(whole.duration_secs), ..ask }), whole);
}

#[test]
fn mistakes_name_the_value() {
    let grid = two_corners();
    let good = question(&grid, 30, 5);
    for (wrong, word) in [
        (TourQuestion { goals: 0, ..good }, "goals 0"),
        (TourQuestion { goals: 101, ..good }, "between 1 and 100"),
        (TourQuestion { spacing_m: f64::NAN, ..good }, "spacing in metres NaN"),
        (TourQuestion { spacing_m: 0.05, ..good }, "length of a cell"),
        (TourQuestion { speed_m_per_s: 0.0, ..good }, "speed in metres a second 0"),
        (TourQuestion { observation_secs: -1.0, ..good }, "seconds at each goal -1"),
        (TourQuestion { budget_secs: Some(f64::NAN), ..good }, "seconds for the tour NaN"),
        (TourQuestion { yaw_rad: f64::INFINITY, ..good }, "yaw in radians inf"),
        (TourQuestion { start_m: [99.0, 0.0], ..good }, "start (99, 0) m"),
        (TourQuestion { sensor: Sensor { range_m: -1.0, ..good.sensor }, ..good }, "range -1"),
        (TourQuestion { travel: TravelOptions { radius_m: -1.0, ..good.travel }, ..good }, "radius -1"),
        (TourQuestion { scene: SceneOptions { threshold: 2.0, ..good.scene }, ..good }, "threshold 2"),
    ] {
        let error = plan_tour(&grid, &Reachability::default(), &wrong, StopSignal::NEVER).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn a_million_candidates_are_refused() {
    let grid = room(1001, 1001, |_, _| 0.0);
    let ask = TourQuestion { spacing_m: 0.1, ..question(&grid, 30, 5) };
    let error = plan_tour(&grid, &Reachability::default(), &ask, StopSignal::NEVER).unwrap_err();
    assert!(matches!(error, TourError::TooManyCandidates { candidates: 1_002_001.0, .. }), "{error}");
    assert!(error.to_string().contains("at most 100000"), "{error}");
}

#[test]
fn rays_at_hand_give_the_same_tour() {
    let grid = two_corners();
    let ask = question(&grid, 30, 5);
    let fan = Fan::new(&ask.sensor, grid.lattice(), 0.0).unwrap();
    let plan = |ask: &TourQuestion, grid: &PredictedGrid| {
        plan_tour_with(&fan, grid, &Reachability::default(), ask, StopSignal::NEVER)
    };
    assert_eq!(plan(&ask, &grid), Ok(tour(&grid, &ask)));
    assert_eq!(plan(&TourQuestion { yaw_rad: 1.0, ..ask }, &grid), Ok(tour(&grid, &ask)));
    let other = TourQuestion { sensor: Sensor { range_m: 0.9, ..ask.sensor }, ..ask };
    assert_eq!(plan(&other, &grid), Err(TourError::OtherFan));
    assert_eq!(plan(&ask, &room(61, 30, |_, _| 0.5)), Err(TourError::OtherFan));
}

#[test]
fn a_tour_that_is_stopped_ends_soon_and_gives_nothing() {
    let grid = room(60, 60, |x, y| if (x * 7 + y * 3) % 5 == 0 { 0.3 } else { 0.1 });
    let ask = TourQuestion {
        goals: 30,
        spacing_m: 0.4,
        observation_secs: 2.0,
        budget_secs: Some(60.0),
        ..question(&grid, 30, 30)
    };
    let fan = Fan::new(&ask.sensor, grid.lattice(), 0.0).unwrap();
    let calls = AtomicUsize::new(0);
    let plan = |after: usize| {
        calls.store(0, Ordering::Relaxed);
        let is_set = || calls.fetch_add(1, Ordering::Relaxed) >= after;
        plan_tour_with(&fan, &grid, &Reachability::default(), &ask, StopSignal::new(&is_set))
    };
    let whole = plan(usize::MAX).unwrap();
    let steps = calls.load(Ordering::Relaxed);
    assert!(whole.steps.len() > 8 && steps > 300, "{} {steps}", whole.steps.len());
    for after in (0..20).map(|part| part * steps / 20).chain([steps - 1]) {
        assert_eq!(plan(after), Err(TourError::Stop(EarlyStop)), "{after} of {steps}");
        let further = calls.load(Ordering::Relaxed) - after;
        assert!(further <= 20, "{further} further steps after {after} of {steps}");
    }
    assert_eq!(plan(steps), Ok(whole));
}

fn ways(numbers: &[f64], count: usize, returns: bool) -> Ways<'static> {
    // Distances of points in a plane with detours, so that nearest first is often wrong.
    let point = |goal: usize| (numbers[2 * goal], numbers[2 * goal + 1]);
    let apart = |one: (f64, f64), other: (f64, f64)| (one.0 - other.0).hypot(one.1 - other.1);
    let from_start = (0..count).map(|goal| apart((0.5, 0.5), point(goal))).collect();
    Ways::new(from_start, returns, StopSignal::NEVER, |one, other| {
        apart(point(one), point(other)) + 0.2 * point(one.max(other)).0
    })
}

fn permutations(goals: &[usize], report: &mut impl FnMut(&[usize])) {
    fn each(order: &mut Vec<usize>, from: usize, report: &mut impl FnMut(&[usize])) {
        if from == order.len() {
            report(order);
        }
        for other in from..order.len() {
            order.swap(from, other);
            each(order, from + 1, report);
            order.swap(from, other);
        }
    }
    each(&mut goals.to_vec(), 0, report);
}

/// Chooses goals by evaluating every candidate in every round.
fn choose_plainly(scene: &Scene, fan: &Fan, candidates: &[TourCandidate], goals: usize) -> Vec<(usize, f64)> {
    let mut scorer = ViewScorer::new(fan);
    let mut covered: HashSet<CellIndex> = HashSet::new();
    let mut chosen: Vec<(usize, f64)> = Vec::new();
    while chosen.len() < goals {
        let mut best = (0, 0.0, 0.0);
        for (number, candidate) in candidates.iter().enumerate() {
            let cells = scorer.cells(scene, fan, candidate.cell);
            let mut bits = 0.0;
            for cell in cells.iter().filter(|cell| !covered.contains(cell)) {
                bits += scene.bits(*cell);
            }
            if bits * candidate.reachability > best.1 {
                best = (number, bits * candidate.reachability, bits);
            }
        }
        if best.1 <= 0.0 {
            break;
        }
        covered.extend(scorer.cells(scene, fan, candidates[best.0].cell));
        chosen.push((best.0, best.2));
    }
    chosen
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn the_lazy_choice_is_the_plain_one(
        cells in prop::collection::vec(0_u8..20, 24 * 18),
        reach in prop::collection::vec(0_u8..4, 40),
        range in 0.2_f64..0.9,
        goals in 1_usize..6,
        quiet in 0_i32..24,
    ) {
        let grid = room(24, 18, |x, y| match cells[(y * 24 + x) as usize] {
            0 | 1 => 1.0,
            _ if x < quiet => 0.0,
            p => f32::from(p) / 40.0,
        });
        let scene = Scene::new(&grid, &SceneOptions::default()).unwrap();
        let sensor = Sensor { range_m: range, ..Sensor::default() };
        let fan = Fan::new(&sensor, scene.lattice(), 0.0).unwrap();
        let mut candidates = Vec::new();
        for number in 0..40 {
            let (x, y) = (1 + number % 8 * 3, 1 + number / 8 * 4);
            let cell = CellIndex { x, y, z: 0 };
            let reachability = f64::from(reach[number as usize]) / 3.0;
            if reachability > 0.0 && !scene.is_occupied(cell) {
                let column = Column { x: x as usize, y: y as usize };
                candidates.push(TourCandidate { column, cell, at_m: at(&grid, x, y), reachability });
            }
        }
        let chosen = GoalSelection::new(&scene, &fan, &candidates, StopSignal::NEVER).choose(goals);
        let chosen: Vec<(usize, f64)> = chosen.iter().map(|goal| (goal.candidate, goal.bits)).collect();
        prop_assert_eq!(chosen, choose_plainly(&scene, &fan, &candidates, goals));
    }

    #[test]
    fn few_goals_have_the_shortest_drive(numbers in prop::collection::vec(0.0_f64..1.0, 14), count in 0_usize..8, returns in any::<bool>()) {
        let ways = ways(&numbers, count, returns);
        let goals: Vec<usize> = (0..count).rev().collect();
        let mut least = f64::INFINITY;
        permutations(&goals, &mut |order| least = least.min(ways.length(order)));
        let order = ways.order(&goals);
        prop_assert!((ways.length(&order) - least).abs() < 1e-9);
        let all: HashSet<usize> = order.iter().copied().collect();
        prop_assert_eq!((all.len(), order.len()), (count, count));
    }

    #[test]
    fn many_goals_have_no_longer_drive_than_to_the_nearest_first(numbers in prop::collection::vec(0.0_f64..1.0, 60), returns in any::<bool>()) {
        let ways = ways(&numbers, 30, returns);
        let goals: Vec<usize> = (0..30).collect();
        let (nearest, order) = (ways.nearest(&goals), ways.order(&goals));
        prop_assert!(ways.length(&order) <= ways.length(&nearest));
        let all: HashSet<usize> = order.iter().copied().collect();
        prop_assert_eq!((all.len(), order.len()), (30, 30));
        let few: Vec<usize> = (0..9).collect();
        let improved = ways.improved(ways.nearest(&few));
        prop_assert!(ways.length(&improved) >= ways.length(&ways.shortest(&few)) - 1e-9);
        prop_assert!(ways.length(&improved) <= 1.25 * ways.length(&ways.shortest(&few)));
    }

    #[test]
    fn what_is_kept_fits_and_nothing_more_would(
        numbers in prop::collection::vec(0.0_f64..1.0, 20),
        values in prop::collection::vec(0.1_f64..1.0, 10),
        budget_secs in 0.0_f64..6.0,
    ) {
        let ways = ways(&numbers, 10, true);
        let budget = TourBudget { ways: &ways, values: &values, secs_m: 1.0, observation_secs: 0.2, budget_secs };
        let order = budget.select();
        prop_assert!(order.is_empty() || budget.duration_secs(&order) <= budget_secs);
        prop_assert_eq!(order.is_empty(), budget.least_secs() > budget_secs);
        for other in (0..10).filter(|other| !order.contains(other)) {
            let mut more = order.clone();
            more.push(other);
            prop_assert!(budget.duration_secs(&ways.order(&more)) > budget_secs);
        }
    }
}

/// Length of a path, metres.
fn length_m(path_m: &[[f64; 2]]) -> f64 {
    path_m.windows(2).map(|legs| (legs[1][0] - legs[0][0]).hypot(legs[1][1] - legs[0][1])).sum()
}

#[test]
fn the_path_goes_around_obstacles_and_is_as_long_as_the_tour() {
    // A wall across the room with a gap at its end.
    let grid = room(60, 30, |x, y| match (x, y) {
        (30, ..25) => 1.0,
        (45.., ..12) => 0.5,
        _ => 0.0,
    });
    for end in [TourEnd::Start, TourEnd::LastGoal] {
        let question = TourQuestion { goals: 2, end, ..question(&grid, 10, 5) };
        let plan = tour(&grid, &question);
        assert_eq!(plan.steps.len(), 2);
        assert_eq!(plan.path_m.first(), Some(&question.start_m));
        assert!((length_m(&plan.path_m) - plan.length_m).abs() < 1e-9, "{plan:?}");
        for step in &plan.steps {
            assert!(plan.path_m.contains(&step.at_m), "{plan:?}");
        }
        let last = plan.path_m.last();
        let expected = if end == TourEnd::Start { question.start_m } else { plan.steps[1].at_m };
        assert_eq!(last, Some(&expected));
        // No point between two corners is in the wall.
        let travel = TravelGrid::new(&grid, &question.travel).unwrap();
        for legs in plan.path_m.windows(2) {
            for share in 0..=20 {
                let along = |axis: usize| legs[0][axis] + f64::from(share) / 20.0 * (legs[1][axis] - legs[0][axis]);
                let column = travel.column_at(along(0), along(1)).unwrap();
                assert!(travel.is_passable(column), "{legs:?}");
            }
        }
    }
}

#[test]
fn a_tour_without_goals_has_no_path() {
    let grid = room(20, 20, |_, _| 0.0);
    assert_eq!(tour(&grid, &question(&grid, 10, 10)).path_m, Vec::<[f64; 2]>::new());
}

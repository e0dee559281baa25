//! One run: all explorers in one office, from the first day to the last.
//!
//! Invariant: in each slot, all explorers are judged before any tour takes place.

use tidemap_model::LocalDay;
use tidemap_plan::{
    day::DaySlots,
    predicted::PredictedGrid,
    strategy::{self, Budget, Gains, Strategy},
};
use tidemap_sim::ExploredOffice;

use super::{
    ExplorerCourse, OfficeError, OfficeProtocol,
    explorer::{Explorer, ExplorerKind},
    space::{DAY_NANOS, START_NANOS, Space},
};

/// Working hours: tours during them are counted separately.
const WORKING_HOURS: std::ops::Range<i64> = 8..18;
const HOUR_NANOS: i64 = 3_600_000_000_000;

/// Explores an office once; `day_done` is called after each day.
pub(super) fn explore(
    protocol: &OfficeProtocol,
    office: &ExploredOffice,
    seed: u64,
    day_done: &impl Fn(),
) -> Result<Vec<ExplorerCourse>, OfficeError> {
    let space = Space::new(office, protocol.goals)?;
    let mut explorers =
        protocol.explorers.iter().map(|&kind| Explorer::new(kind, &space)).collect::<Result<Vec<_>, OfficeError>>()?;
    let mut courses = vec![ExplorerCourse::default(); explorers.len()];
    for day in 0..protocol.days {
        let midnight_nanos = START_NANOS + day as i64 * DAY_NANOS;
        let slots = DaySlots::of(&space.spec().zone, LocalDay::of_civil_nanos(midnight_nanos), protocol.slot_nanos)?;
        let mut schedules = Vec::with_capacity(explorers.len());
        for (explorer, course) in explorers.iter_mut().zip(&mut courses) {
            if day > 0 {
                explorer.midnight(midnight_nanos)?;
            }
            let kind = (day > 0).then_some(explorer.kind);
            schedules.push((
                kind.unwrap_or(ExplorerKind::Spatial),
                schedule(protocol, &space, explorer, kind, &slots, seed * 1000 + day as u64)?,
            ));
            for counts in [&mut course.changes, &mut course.discovered, &mut course.tours, &mut course.tours_by_day] {
                counts.push(0);
            }
        }
        for slot in 0..slots.count() {
            let (start_nanos, middle_nanos) = (slots.start_nanos(slot), slots.middle_nanos(slot));
            for (course, error) in courses.iter_mut().zip(judge(&space, &explorers, middle_nanos)?) {
                course.errors.push(error);
            }
            for ((explorer, course), (kind, schedule)) in explorers.iter_mut().zip(&mut courses).zip(&schedules) {
                if schedule.get(slot).copied().flatten().is_none() {
                    continue;
                }
                let findings = explorer.tour(&space, *kind, start_nanos, middle_nanos)?;
                let is_working = WORKING_HOURS.contains(&((middle_nanos - midnight_nanos) / HOUR_NANOS));
                course.changes[day] += findings.changes;
                course.discovered[day] += findings.discovered;
                course.tours[day] += u64::from(findings.scans > 0);
                course.tours_by_day[day] += u64::from(findings.scans > 0 && is_working);
            }
        }
        day_done();
    }
    Ok(courses)
}

/// The slots of a day in which an explorer goes on a tour.
fn schedule(
    protocol: &OfficeProtocol,
    space: &Space,
    explorer: &Explorer,
    kind: Option<ExplorerKind>,
    slots: &DaySlots,
    seed: u64,
) -> Result<Vec<Option<usize>>, OfficeError> {
    let count = slots.count();
    let budget = Budget::Visits(protocol.tours.min(count));
    let even = || Gains::of(count, 1, |_, _| 1.0);
    // The first day is the same for all, because no map is trained yet. Tours at regular times would make periods of 24
    // h / i and 24 h / (24 - i) indistinguishable.
    let Some(kind) = kind else { return Ok(strategy::schedule(Strategy::Random, &even()?, budget, seed)?) };
    if kind == ExplorerKind::Spatial {
        return Ok(strategy::schedule(Strategy::RoundRobin { visited: 0 }, &even()?, budget, seed)?);
    }
    // E_G of each slot (RA-L, sections III.E and F).
    let bits = (0..count)
        .map(|slot| Ok(explorer.best_tour(space, slots.middle_nanos(slot))?.expected_bits))
        .collect::<Result<Vec<f64>, OfficeError>>()?;
    Ok(strategy::schedule(Strategy::MonteCarlo, &Gains::of(count, 1, |slot, _| bits[slot])?, budget, seed)?)
}

/// The share of cells that each explorer predicts wrongly, among those that any explorer has seen.
fn judge(space: &Space, explorers: &[Explorer], utc_nanos: i64) -> Result<Vec<Option<f64>>, OfficeError> {
    let truth = space.occupied(utc_nanos);
    let seen: Vec<usize> =
        (0..space.cells()).filter(|&cell| explorers.iter().any(|explorer| explorer.has_seen(cell))).collect();
    let wrong = |grid: &PredictedGrid| {
        let is_occupied = |cell: usize| grid.probability(space.cell(cell)).is_some_and(|p| p > 0.5);
        seen.iter().filter(|&&cell| is_occupied(cell) != truth[cell]).count()
    };
    let error_share = |explorer: &Explorer| {
        let grid = explorer.predict(utc_nanos)?;
        Ok((!seen.is_empty()).then(|| wrong(&grid) as f64 / seen.len() as f64))
    };
    explorers.iter().map(error_share).collect()
}

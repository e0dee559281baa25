//! Tests rows that come after an update has learned their time: their states are learned anew.

use tidemap_grid::spec::Retention;
use tidemap_model::catalogue::ModelKind;

use super::*;
use crate::{
    live_map::tests::training::Pieces,
    training::{ReadingsRequest, StateReadings},
    update::{LateRowsOutcome, UpdateResult},
};

const DOOR: StateId = StateId(0);

/// A home with the history of its updates.
pub(super) struct KeptHome {
    pub(super) home: Home,
    known: Pieces,
    /// The snapshot of the last update.
    snapshot: Option<MapSnapshot>,
}

impl KeptHome {
    pub(super) fn new(kind: StateKind, reporting: Reporting, retention: Retention) -> KeptHome {
        let mut home = Home::new(kind, reporting);
        let spec = MapSpec { retention, ..MapSpec::clone(home.map.spec()) };
        home.map = LiveMap::new(Arc::new(spec));
        let name = StateName::new("door").expect("valid");
        let new = NewState { id: DOOR, name, shape: kind.into(), labels: Vec::new(), sensor: None, reporting };
        home.map.apply(1, &Event::AddState(new)).expect("fits");
        KeptHome { home, known: Pieces::default(), snapshot: None }
    }

    /// Learns all rows that have arrived. Returns the number of states learned anew, and of states with single
    /// readings.
    fn update(&mut self, until: i64) -> (u64, u64) {
        let outcome = self.update_from(until, Arc::new(self.known.clone()));
        (outcome.learned_anew, outcome.not_kept + outcome.beyond_bound + outcome.unreadable)
    }

    /// Learns the rows that have arrived, up to this many readings. Returns the time up to which rows are learned, if
    /// some wait.
    pub(super) fn update_bounded(&mut self, until: i64, readings_max: u64) -> Option<i64> {
        let source = Arc::new(self.known.clone());
        let result = self.run(until, source, |work| work.with_readings_max(readings_max));
        let to_nanos = result.rows_to_nanos();
        self.finish(result);
        to_nanos
    }

    /// Restarts the map from its checkpoint.
    pub(super) fn restart(&mut self) {
        let snapshot = self.snapshot.take().expect("an update");
        self.home.map = LiveMap::restore(Arc::clone(self.home.map.spec()), snapshot);
    }

    fn update_from(&mut self, until: i64, source: Arc<dyn StateReadings>) -> LateRowsOutcome {
        let result = self.run(until, source, |work| work);
        let outcome = result.late_rows_outcome().clone();
        self.finish(result);
        outcome
    }

    fn run(
        &mut self,
        until: i64,
        source: Arc<dyn StateReadings>,
        change: impl FnOnce(UpdateWork) -> UpdateWork,
    ) -> UpdateResult {
        let start = self.home.map.plan_update(Some(until), until, UpdateCause::Request);
        self.home.position += 1;
        let work = self.home.map.apply(self.home.position, &Event::UpdateStart(start)).expect("fits").expect("work");
        change(work.with_readings(source)).run(&AtomicU64::new(0)).expect("in memory")
    }

    fn finish(&mut self, result: UpdateResult) {
        let snapshot = self.home.map.finish_update(result);
        self.known.0.extend(snapshot.history.iter().cloned());
        self.snapshot = Some(snapshot);
    }

    pub(super) fn model(&mut self) -> StateModel {
        StateModel::clone(self.home.map.publish().model(DOOR))
    }
}

fn changes() -> Reporting {
    Reporting::Changes(hold(7 * DAY, 5 * MINUTE))
}

#[test]
fn a_state_whose_refused_rows_come_after_an_update_is_learned_anew() {
    let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
    let (on, off): (Vec<_>, Vec<_>) = office_hours(14).into_iter().partition(|(_, value)| *value == 1.0);
    // The words for "off" were not known at first: the door seems to be always open.
    home.home.observe(&on, HOUR);
    assert_eq!(home.update(MONDAY + 14 * DAY), (0, 0));
    assert!(home.home.predict(None, MONDAY + 14 * DAY + 3 * HOUR, "auto") > 0.9);
    home.home.observe(&off, HOUR);
    assert_eq!(home.update(MONDAY + 14 * DAY), (1, 0));
    let mut in_order = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
    in_order.home.observe(&office_hours(14), HOUR);
    in_order.update(MONDAY + 14 * DAY);
    assert_eq!(home.model(), in_order.model());
    assert!(home.home.predict(None, MONDAY + 14 * DAY + 3 * HOUR, "auto") < 0.1);
    // The last value is not changed by rows that are older.
    assert_eq!(
        home.home.map.publish().live(DOOR).persistence.last(),
        in_order.home.map.publish().live(DOOR).persistence.last()
    );
}

#[test]
fn a_row_that_comes_again_corrects_the_first() {
    let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
    let mut rows = office_hours(7);
    let right = rows[4];
    rows[4].1 = 0.0;
    home.home.observe(&rows, HOUR);
    home.update(MONDAY + 7 * DAY);
    home.home.observe(&[right], HOUR);
    assert_eq!(home.update(MONDAY + 7 * DAY), (1, 0));
    let mut in_order = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
    in_order.home.observe(&office_hours(7), HOUR);
    in_order.update(MONDAY + 7 * DAY);
    assert_eq!(home.model().accumulator(), in_order.model().accumulator());
}

#[test]
fn rows_of_older_files_are_learned_before_those_that_are_known() {
    let reporting = Reporting::Events(hold(7 * DAY, HOUR));
    let events = |days: std::ops::Range<i64>| -> Vec<(i64, f64)> {
        days.flat_map(|day| (0..4).map(move |n| (MONDAY + day * DAY + 12 * HOUR + n * 10 * MINUTE, 1.0))).collect()
    };
    let mut home = KeptHome::new(StateKind::Count, reporting, Retention::Forever);
    home.home.observe(&events(7..14), HOUR);
    home.update(MONDAY + 14 * DAY);
    home.home.observe(&events(0..7), HOUR);
    assert_eq!(home.update(MONDAY + 14 * DAY), (1, 0));
    let mut in_order = KeptHome::new(StateKind::Count, reporting, Retention::Forever);
    in_order.home.observe(&events(0..14), HOUR);
    in_order.update(MONDAY + 14 * DAY);
    assert_eq!(home.model(), in_order.model());
}

#[test]
fn late_rows_are_single_readings_where_history_is_not_kept() {
    for retention in [Retention::None, Retention::Duration(5 * DAY)] {
        let mut home = KeptHome::new(StateKind::Probability, changes(), retention);
        home.home.observe(&office_hours(14), HOUR);
        home.update(MONDAY + 14 * DAY);
        let before = home.model().accumulator().observations();
        home.home.observe(&[(MONDAY + 12 * HOUR, 0.0)], HOUR);
        assert_eq!(home.update(MONDAY + 14 * DAY), (0, 1));
        assert_eq!(home.model().accumulator().observations(), before + 1);
    }
    // All rows of the state are younger than the retention time.
    let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Duration(30 * DAY));
    home.home.observe(&office_hours(14), HOUR);
    home.update(MONDAY + 14 * DAY);
    home.home.observe(&[(MONDAY + 12 * HOUR, 0.0)], HOUR);
    assert_eq!(home.update(MONDAY + 14 * DAY), (1, 0));
}

/// History that cannot be read.
#[derive(Debug)]
struct Damaged;

impl StateReadings for Damaged {
    fn readings(&self, _: &[ReadingsRequest]) -> Result<Vec<Vec<Sample>>, String> {
        Err("damaged".to_owned())
    }
}

#[test]
fn late_rows_are_single_readings_where_history_is_damaged_or_incomplete() {
    let damaged: Arc<dyn StateReadings> = Arc::new(Damaged);
    let unreadable = LateRowsOutcome { unreadable: 1, failure: Some("damaged".to_owned()), ..Default::default() };
    let not_kept = LateRowsOutcome { not_kept: 1, ..Default::default() };
    for (source, expected) in [(damaged, unreadable), (Arc::new(Pieces::default()), not_kept)] {
        let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
        home.home.observe(&office_hours(14), HOUR);
        home.update(MONDAY + 14 * DAY);
        let before = home.model().accumulator().observations();
        home.home.observe(&[(MONDAY + 12 * HOUR, 0.0)], HOUR);
        assert_eq!(home.update_from(MONDAY + 14 * DAY, source), expected);
        assert_eq!(home.model().accumulator().observations(), before + 1);
    }
}

#[test]
fn what_one_update_learns_anew_is_bounded_by_what_rows_stand_for() {
    // There is a reading each second: 20 million readings are 231 days.
    for (days, expected) in [(230, (1, 0)), (232, (0, 1))] {
        let reporting = Reporting::Changes(hold(HOUR, 1_000_000_000));
        let mut home = KeptHome::new(StateKind::Probability, reporting, Retention::Forever);
        home.home.observe(&[(MONDAY, 1.0), (MONDAY + days * DAY, 0.0)], HOUR);
        home.update(MONDAY + (days + 1) * DAY);
        home.home.observe(&[(MONDAY + 12 * HOUR, 0.0)], HOUR);
        assert_eq!(home.update(MONDAY + (days + 1) * DAY), expected, "{days} days");
    }
}

#[test]
fn models_of_states_that_are_learned_anew_are_trained_on_their_rows_alone() {
    let train = |late: bool| {
        let mut home = KeptHome::new(StateKind::Probability, changes(), Retention::Forever);
        let rows = office_hours(20);
        let (first, rest) = (rows[..1].to_vec(), rows[1..].to_vec());
        if late {
            home.home.observe(&rest, HOUR);
            home.update(MONDAY + 20 * DAY);
            home.home.observe(&first, HOUR);
        } else {
            home.home.observe(&rows, HOUR);
        }
        home.update(MONDAY + 20 * DAY);
        home.model()
    };
    let (late, in_order) = (train(true), train(false));
    assert!(late.alternatives().is_some_and(|known| known.trained(ModelKind::Calibrated).is_some()));
    assert_eq!(late, in_order);
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(40))]
    #[test]
    fn the_order_of_arrival_changes_nothing(
        minutes in proptest::collection::btree_set(0_i64..14 * 1_440, 2..60),
        values in proptest::collection::vec(proptest::option::weighted(0.9, proptest::bool::ANY), 60),
        shuffled in proptest::collection::vec(0_usize..5, 60),
        is_changes: bool,
    ) {
        let (kind, reporting) = match is_changes {
            true => (StateKind::Probability, Reporting::Changes(hold(2 * DAY, 5 * MINUTE))),
            false => (StateKind::Count, Reporting::Events(hold(2 * DAY, HOUR))),
        };
        let value = |value: Option<bool>| value.map_or(f64::NAN, |value| f64::from(u8::from(value)));
        let rows: Vec<(i64, f64)> =
            minutes.iter().zip(&values).map(|(minute, of_row)| (MONDAY + minute * MINUTE, value(*of_row))).collect();
        let end = MONDAY + 15 * DAY;
        let mut in_order = KeptHome::new(kind, reporting, Retention::Forever);
        in_order.home.observe(&rows, HOUR);
        in_order.update(end);
        let mut home = KeptHome::new(kind, reporting, Retention::Forever);
        // The newest row comes first, so that all others are late.
        let (newest, others) = rows.split_last().expect("two at least");
        home.home.observe(&[*newest], HOUR);
        home.update(end);
        for part in 0..5 {
            let arrived: Vec<_> =
                others.iter().zip(&shuffled).filter_map(|(row, of_row)| (*of_row == part).then_some(*row)).collect();
            if !arrived.is_empty() {
                home.home.observe(&arrived, HOUR);
                home.update(end);
            }
        }
        proptest::prop_assert_eq!(home.model(), in_order.model());
    }
}

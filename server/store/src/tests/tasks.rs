//! Tasks, kept plans, reports and no-go areas come back from their records; what is not valid is refused.

use tidemap_layout::task::TaskBook;
use tidemap_map::{
    event::{Envelope, Event, Observations, OffsetRun, SequenceSpan},
    ids::{ProducerId, StateId},
    name::TaskName,
    no_go::NoGoEdit,
    site::{Site, SiteEdit},
    task::{KeptPlan, KeptStep, KeptWork, RobotTask, TaskDays, TaskEdit, TaskRun, TaskRuns},
};
use tidemap_model::LocalDay;

use super::example::spoiled;
use crate::record::{self, tables};

fn name() -> TaskName {
    TaskName::new("clean", "hall").expect("valid")
}

pub(super) fn run() -> TaskRun {
    TaskRun {
        name: name(),
        start_nanos: 1_700_000_000_000_000_000,
        end_nanos: 1_700_000_600_000_000_000,
        success: false,
        intervention: true,
        reason: "the door was closed".to_owned(),
    }
}

pub(super) fn edits() -> Vec<TaskEdit> {
    let daily = RobotTask {
        name: name(),
        from_secs: 28_800,
        until_secs: 64_800,
        duration_secs: 600,
        days: TaskDays::Weekly(31),
        every_secs: Some(7_200),
        value: 0.1 + 0.2,
        value_state: Some(name().state()),
    };
    let once = RobotTask {
        name: TaskName::new("guide", "lab").expect("valid"),
        days: TaskDays::On(LocalDay(-3)),
        every_secs: None,
        value_state: None,
        ..daily.clone()
    };
    let step = |departure_nanos, work| KeptStep {
        departure_nanos,
        start_nanos: departure_nanos + 5,
        end_nanos: departure_nanos + 9,
        work,
    };
    let steps = vec![
        step(0, KeptWork::Task { name: name(), value: 1.5, success: 0.75 }),
        step(9, KeptWork::Explore { place: "2.5,-1".to_owned(), information_bits: 1.0 / 3.0 }),
    ];
    let plan = KeptPlan { day: LocalDay(17_000), made_nanos: 4, steps };
    vec![
        TaskEdit::Set(daily),
        TaskEdit::Set(once.clone()),
        TaskEdit::KeepPlan(plan),
        TaskEdit::Remove(once.name.clone()),
        TaskEdit::Set(once),
    ]
}

pub(super) fn area() -> SiteEdit {
    let corners = vec![[0.0, -0.0], [1.0 / 3.0, 0.0], [0.5, 7.0]];
    SiteEdit::NoGo(NoGoEdit::Set(name().node, corners))
}

fn comes_back(event: &Event) {
    let (kind, payload) = record::event::encode(event).expect("valid");
    assert_eq!(record::event::decode(kind, &payload).as_ref(), Ok(event));
}

#[test]
fn edits_and_reports_come_back_from_the_log() {
    edits().into_iter().for_each(|edit| comes_back(&Event::EditSite(SiteEdit::Task(edit))));
    comes_back(&Event::EditSite(area()));
    comes_back(&Event::EditSite(SiteEdit::NoGo(NoGoEdit::Remove(name().node))));
    let envelope = Envelope {
        producer: ProducerId(0),
        new_producer: None,
        incarnation: 1,
        span: SequenceSpan { first: 3, last: 3, content_crc: 9 },
        received_nanos: 7,
        refused: Vec::new(),
    };
    let observations = Observations {
        states: vec![StateId(0)],
        times_nanos: vec![run().start_nanos],
        values: vec![0.0],
        offsets: vec![OffsetRun { count: 1, offset_secs: 0 }],
        runs: vec![run()],
        ..Observations::default()
    };
    comes_back(&Event::Observations(envelope, observations));
}

#[test]
fn a_site_comes_back_with_its_tasks() {
    let mut site = Site::default();
    for edit in edits() {
        site.apply(&SiteEdit::Task(edit), 0).expect("valid");
    }
    site.apply(&area(), 0).expect("valid");
    let mut runs = TaskRuns::default();
    runs.add(run());
    let tasks = site.tasks().clone().with_runs(runs);
    let site = site.with_tasks(tasks);
    let rows: Vec<_> = tables::rows(&site).collect();
    assert_eq!(tables::site(&rows, 0), Ok(site));

    // The row of the no-go area is the first.
    let broken = |change: fn(&mut TaskBook)| {
        tables::site(&spoiled(&rows, 1, change), 0).expect_err("not valid");
    };
    broken(|book| book.tasks[0].node = "a/b".to_owned());
    broken(|book| book.tasks[0].weekdays = 1_000);
    broken(|book| book.tasks[0].until_secs = 0);
    broken(|book| book.plans[0].steps[1].departure_nanos = 2);
    broken(|book| book.runs[0].duration_nanos = -1);
    broken(|book| book.runs[0].reason = "a\nb".to_owned());
}

#[test]
fn a_site_without_tasks_has_no_row_of_them() {
    let mut site = Site::default();
    site.apply(&SiteEdit::Charger(Some([1.0, 2.0])), 0).expect("valid");
    let of_charger: Vec<_> = tables::rows(&site).map(|row| row.table).collect();
    assert_eq!(of_charger, [1]);
}

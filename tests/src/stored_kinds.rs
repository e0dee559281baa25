//! A map with all data that is stored beside plain values: labels, rows of changes, traversals, sightings, reports of
//! tasks, tasks, and kept plans. Each kind has a sender of its own.
//!
//! Invariant: item n of a kind is a function of n alone. So a second daemon that gets the same items, and is never
//! killed, must answer the same.

use std::{collections::BTreeMap, fmt, time::Duration};

use tidemap_client::{
    Client, Error,
    exploration::DayQuery,
    maps::{RowKind, State, StatedReporting},
    observe::{Producer, ProducerError, ProducerOptions, SightingReport, TraversalReport},
    tasks::{LocalDay, RobotTask, TaskDays, TaskName, TaskQuery, TaskRun},
};
use tokio::task::JoinHandle;

use crate::{
    cli::{tidemap, tidemap_reading},
    daemon::Daemon,
    oracle::{Mark, Violation},
};

/// The name of the map.
pub const MAP: &str = "depot";

/// Monday 2021-03-01, midnight UTC.
const START_SECS: i64 = 1_614_556_800;
const STEP_SECS: i64 = 600;
/// Items between two that are awaited.
const GROUP: u64 = 15;
const PAUSE: Duration = Duration::from_millis(3);
/// Days for which plans are kept, again and again. A map keeps 100 plans.
const PLANNED_DAYS: u64 = 60;

const TOPOLOGY: &str = "node Dock\nnode Hall\nnode Lab\nlink Dock Hall 20\nlink Hall Lab 10\n";
const LANDMARKS: &str = "place,name,u_px,v_px,descriptor,along_m\nHall,window,100,50,00000000000000ff,\n\
                         Hall,lamp,300,40,0000000000ff0000,\nHall/Lab,sign,40,70,0f0f0f0f0f0f0f0f,1.5\n";

/// An item to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum StoredItem {
    Label,
    Change,
    Traversal,
    Sighting,
    TaskReport,
}

const ITEMS: [StoredItem; 5] =
    [StoredItem::Label, StoredItem::Change, StoredItem::Traversal, StoredItem::Sighting, StoredItem::TaskReport];

impl StoredItem {
    fn producer(self) -> String {
        format!("{self:?}").to_lowercase()
    }

    fn options(self) -> ProducerOptions {
        let reporting = (self == Self::Change)
            .then(|| StatedReporting::new(RowKind::Changes, Some(7_200), Some(300)).expect("valid durations"));
        let patience = Duration::ZERO;
        ProducerOptions { reporting, patience, nightly: true, ..ProducerOptions::new(&self.producer(), "", MAP) }
    }
}

fn nanos(secs: i64) -> i64 {
    secs * 1_000_000_000
}

fn time_nanos(n: u64) -> i64 {
    nanos(START_SECS + STEP_SECS * i64::try_from(n).expect("few items"))
}

fn traversal(n: u64) -> TraversalReport {
    let [from, to] = [["Dock", "Hall"], ["Hall", "Lab"]][(n % 2) as usize].map(str::to_owned);
    let (start_nanos, success) = (time_nanos(n), !n.is_multiple_of(5));
    let reason = if success { String::new() } else { format!("door {n} was shut") };
    TraversalReport { from, to, action: String::new(), start_nanos, end_nanos: start_nanos + nanos(9), success, reason }
}

fn sighting(n: u64) -> SightingReport {
    let on_edge = n.is_multiple_of(3);
    let seen = if on_edge { "sign" } else { ["window", "lamp"][(n / 40 % 2) as usize] };
    SightingReport {
        place: if on_edge { "Hall/Lab" } else { "Hall" }.to_owned(),
        from_m: None,
        to_m: None,
        time_nanos: time_nanos(n),
        seen: vec![seen.to_owned()],
        out_of_view: Vec::new(),
        traversal: None,
    }
}

fn task_run(n: u64) -> TaskRun {
    let (start_nanos, success) = (time_nanos(n), !n.is_multiple_of(4));
    TaskRun {
        name: TaskName::new("greet", "Hall").expect("a name"),
        start_nanos,
        end_nanos: start_nanos + nanos(300),
        success,
        intervention: !success,
        reason: if success { String::new() } else { format!("nobody came to {n}") },
    }
}

async fn send(producer: &mut Producer, item: StoredItem, n: u64) -> Result<u64, ProducerError> {
    match item {
        StoredItem::Label => {
            let label = ["sleep", "eat", "work"][(n / 7 % 3) as usize];
            producer.send_label("activity", time_nanos(n), label).await
        }
        StoredItem::Change => {
            producer.send("door", time_nanos(n), f64::from(u8::from((n / 3).is_multiple_of(2)))).await
        }
        StoredItem::Traversal => producer.send_traversal(&traversal(n)).await,
        StoredItem::Sighting => producer.send_sighting(&sighting(n)).await,
        StoredItem::TaskReport => unreachable!("a report is a request of its own"),
    }
}

/// Sends items up to `until`, or until the daemon ends. Returns how far it came.
async fn send_items(client: Client, item: StoredItem, known: Mark, until: u64) -> Mark {
    let mut mark = known;
    if item == StoredItem::TaskReport {
        let producer = item.producer();
        for n in known.acknowledged + 1..=until {
            mark.sent = mark.sent.max(n);
            // A report that is sent again with its number is taken once.
            match client.report_task(MAP, (&producer, ""), n, &task_run(n)).await {
                Ok(receipt) => mark.acknowledged = mark.acknowledged.max(receipt.durable_sequence),
                Err(_) => break,
            }
            tokio::time::sleep(PAUSE).await;
        }
        return mark;
    }
    let Ok(mut producer) = Producer::open(&client, item.options()).await else { return mark };
    for n in producer.last_sequence() + 1..=until {
        mark.sent = mark.sent.max(n);
        let is_last = n == until || n.is_multiple_of(GROUP);
        if send(&mut producer, item, n).await.is_err() || (is_last && producer.flush().await.is_err()) {
            break;
        }
        if is_last {
            tokio::time::sleep(PAUSE).await;
        }
    }
    mark.acknowledged = mark.acknowledged.max(producer.progress().durable_sequence);
    mark
}

fn task(n: u64) -> RobotTask {
    RobotTask {
        name: TaskName::new(&format!("patrol-{}", n % 40), ["Hall", "Lab"][(n % 2) as usize]).expect("a name"),
        from_secs: 6 * 3_600,
        until_secs: 20 * 3_600,
        duration_secs: 60 + u32::try_from(n % 500).expect("small"),
        days: TaskDays::Weekly(0b111_1111),
        every_secs: None,
        value: 1.0 + (n % 9) as f64,
        value_state: None,
    }
}

fn planned_day(n: u64) -> LocalDay {
    LocalDay::of_civil_nanos(time_nanos(n % PLANNED_DAYS * 144))
}

/// Sets task n and keeps a plan.
async fn plan(client: &Client, n: u64) -> Result<(String, String), Error> {
    client.set_task(MAP, &task(n)).await?;
    let date = planned_day(n).to_string();
    let day = DayQuery { map: MAP.to_owned(), date: date.clone(), ..DayQuery::default() };
    let query = TaskQuery { start_node: Some("Dock".to_owned()), ready_nanos: None, keep: true };
    client.plan_tasks(day, query).await?;
    let kept = client.kept_plan(MAP, Some(&date), None).await?.0;
    assert!(!kept.steps.is_empty(), "a plan of nothing tests nothing");
    Ok((date, format!("{kept:?}")))
}

/// Plans, and what was acknowledged of them.
#[derive(Clone, Debug, Default)]
struct Plans {
    /// Number of items that were made.
    made: u64,
    /// The newest of each day.
    kept: BTreeMap<String, String>,
}

async fn make_plans(client: Client, mut plans: Plans, until: u64) -> Plans {
    while plans.made < until {
        match plan(&client, plans.made + 1).await {
            Ok((date, text)) => plans.kept.insert(date, text),
            Err(_) => break,
        };
        plans.made += 1;
        tokio::time::sleep(PAUSE).await;
    }
    plans
}

/// Senders that run.
#[derive(Debug)]
pub struct Senders {
    items: Vec<JoinHandle<Mark>>,
    plans: JoinHandle<Plans>,
}

/// The items that were sent of each kind.
#[derive(Clone, Debug)]
pub struct StoredKinds {
    marks: [Mark; ITEMS.len()],
    plans: Plans,
    /// How far the daemon that is never killed was filled.
    reference: [Mark; ITEMS.len()],
}

fn differs(what: String, expected: impl fmt::Debug, found: impl fmt::Debug) -> Violation {
    Violation::Differs { what, expected: format!("{expected:?}"), found: format!("{found:?}") }
}

impl StoredKinds {
    /// Creates the map on a daemon.
    pub fn create(daemon: &Daemon) -> Self {
        tidemap(daemon, ["map", "create", MAP, "--time-zone", "Europe/London"]).table();
        tidemap_reading(daemon, ["topology", "load", MAP, "-"], TOPOLOGY).table();
        tidemap_reading(daemon, ["landmark", "add", MAP, "-", "--descriptors", "test-64"], LANDMARKS).table();
        tidemap(daemon, ["task", "add", MAP, "greet", "Hall", "--duration", "5m"]).table();
        Self { marks: Default::default(), plans: Plans::default(), reference: Default::default() }
    }

    /// Starts the senders. Each ends after item `until`, or when the daemon ends.
    #[must_use]
    pub fn start(&self, client: &Client, until: u64) -> Senders {
        let items = ITEMS.into_iter().zip(self.marks);
        let items = items.map(|(item, mark)| tokio::spawn(send_items(client.clone(), item, mark, until))).collect();
        Senders { items, plans: tokio::spawn(make_plans(client.clone(), self.plans.clone(), until)) }
    }

    /// Waits for the end of the senders.
    ///
    /// # Panics
    /// If a sender panics.
    pub async fn settle(&mut self, senders: Senders) {
        for (mark, sender) in self.marks.iter_mut().zip(senders.items) {
            *mark = sender.await.expect("a sender does not panic");
        }
        self.plans = senders.plans.await.expect("a sender does not panic");
    }

    /// How many items of each kind are acknowledged; the last is that of plans.
    #[must_use]
    pub fn acknowledged(&self) -> Vec<u64> {
        self.marks.iter().map(|mark| mark.acknowledged).chain([self.plans.made]).collect()
    }

    /// Compares a daemon with the items that it acknowledged, and with a daemon that was never killed, which gets the
    /// same items.
    ///
    /// # Errors
    /// The first violation.
    ///
    /// # Panics
    /// If a daemon does not answer.
    pub async fn verify(&mut self, daemon: &Daemon, reference: &Daemon) -> Result<(), Violation> {
        let (client, sound) = (daemon.client(), reference.client());
        let known = client.producers(MAP).await.expect("the map is there");
        for (place, item) in ITEMS.into_iter().enumerate() {
            let (mark, producer) = (&mut self.marks[place], item.producer());
            let durable = known.iter().find(|it| it.producer == producer).map_or(0, |it| it.durable_sequence);
            if durable < mark.acknowledged {
                return Err(Violation::Lost { producer, acknowledged: mark.acknowledged, durable });
            }
            if durable > mark.sent {
                return Err(Violation::Foreign { producer, sent: mark.sent, durable });
            }
            mark.acknowledged = durable;
            let filled = send_items(sound.clone(), item, self.reference[place], durable).await;
            assert_eq!(filled.acknowledged, durable, "the reference takes all of {producer}");
            self.reference[place] = filled;
        }
        let [found, expected] = [content(&client).await, content(&sound).await];
        for (name, text) in &expected {
            if found.get(name) != Some(text) {
                return Err(differs(format!("what is stored of {name}"), text, found.get(name)));
            }
        }
        if let Some((name, text)) = found.iter().find(|(name, _)| !expected.contains_key(*name)) {
            return Err(differs(format!("what is stored of {name}"), "nothing", text));
        }
        self.verify_plans(&client).await
    }

    /// The plan that was being made may be there or not.
    async fn verify_plans(&self, client: &Client) -> Result<(), Violation> {
        let under_way = planned_day(self.plans.made + 1).to_string();
        for (date, text) in self.plans.kept.iter().filter(|(date, _)| **date != under_way) {
            let kept = client.kept_plan(MAP, Some(date), None).await;
            let kept = kept.map_or_else(|error| error.to_string(), |(kept, _)| format!("{kept:?}"));
            if kept != *text {
                return Err(differs(format!("the kept plan of {date}"), text, kept));
            }
        }
        let tasks = client.tasks(MAP).await.expect("the map is there");
        let newest = self.plans.made + 1;
        for n in (newest.saturating_sub(39).max(1)..newest).filter(|n| n % 40 != newest % 40) {
            let expected = task(n);
            let found = tasks.iter().find(|task| task.name == expected.name);
            if found != Some(&expected) {
                return Err(differs(format!("task {}", expected.name), &expected, found));
            }
        }
        Ok(())
    }
}

/// The names under which the history of a state is read: its own, or those of its labels.
#[must_use]
pub fn parts(state: &State) -> Vec<String> {
    if state.labels.is_empty() {
        return vec![state.name.clone()];
    }
    state.labels.iter().map(|label| format!("{}/{label}", state.name)).collect()
}

async fn history(client: &Client, part: &str) -> Result<Vec<(i64, f64)>, Error> {
    let mut rows = client.reconstruct(MAP, part, 0, i64::MAX).await?;
    let mut all = Vec::new();
    while let Some(more) = rows.next().await? {
        all.extend(more);
    }
    Ok(all)
}

/// All that a map stores of observations and landmarks, by name; nothing that an update changes.
async fn content(client: &Client) -> BTreeMap<String, String> {
    let mut facts = BTreeMap::new();
    let (states, more) = client.states(MAP, "").await.expect("the map is there");
    assert_eq!(more, None, "one page holds all states");
    for state in states {
        let shape = (state.shape, state.reporting, &state.labels);
        let mut text = format!("{shape:?} {} {:?}", state.observations, state.last_nanos);
        for part in parts(&state) {
            match history(client, &part).await {
                Ok(rows) => text += &format!(" {part}: {rows:?}"),
                Err(error) => text += &format!(" {part}: {error}"),
            }
        }
        facts.insert(format!("state {}", state.name), text);
    }
    let (places, descriptors) = client.landmark_places(MAP).await.expect("the map is there");
    facts.insert("landmarks".to_owned(), format!("{places:?} {descriptors}"));
    facts
}

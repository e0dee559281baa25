//! Mappings: states of any topic.
//!
//! Invariant: what is expected follows from how the recording was written.

use tidemap_tests::bag::{self, Bag};

use super::{SECOND_NANOS, START_NANOS, counts, started, words, written};

const HOUR_NANOS: i64 = 3600 * SECOND_NANOS;

#[test]
fn the_door_opens_in_a_recording_and_the_map_knows_when_it_will_again() {
    let (folder, daemon) = started();
    let mut bag = Bag::default();
    for step in 0..14 * 24 * 6 {
        let hour = step / 6 % 24;
        bag.bool("/door/open", START_NANOS + step * HOUR_NANOS / 6, (8..18).contains(&hour));
    }
    let file = written(&folder, "fortnight.bag", &bag, usize::MAX);
    let import = words(&daemon, &format!("import home {} --nightly --producer robot-1", file.display()));
    assert_eq!(counts(&import.table(), "/door/open"), [14 * 24 * 6, 0, 0]);
    let command = "predict home door-open --at 2025-01-21T03:00:00Z,2025-01-21T12:00:00Z,2025-01-21T21:00:00Z";
    let p = words(&daemon, command).table().numbers("probability");
    assert!(p[0] < 0.2 && p[1] > 0.8 && p[2] < 0.2, "{p:?}");
}

#[test]
fn a_mapping_gives_states_kinds_values_and_what_reports_are() {
    let (folder, daemon) = started();
    let mut bag = Bag::default();
    let door = ("own_msgs/Door", "string name\nuint8 mode\nint32[] people\nfloat32 celsius");
    for step in 0..24_i64 {
        let time = START_NANOS + step * HOUR_NANOS;
        let people: i64 = step % 3;
        let mut data = bag::text(if step % 2 == 0 { "front/left" } else { "back" });
        data.push(u8::try_from(step % 4).expect("a mode"));
        data.extend(u32::try_from(people).expect("few").to_le_bytes());
        (0..people).for_each(|_| data.extend(7_i32.to_le_bytes()));
        data.extend(f32::from(20_u8).to_le_bytes());
        bag.message("/doors", door, time, &data);
        bag.text("/activity", time, ["sleep", "work", "unknown"][usize::try_from(step % 3).expect("an index")]);
    }
    let file = written(&folder, "doors.bag", &bag, usize::MAX);
    let mapping = folder.path().join("mapping.yaml");
    let text = "states:\n  /doors.mode:\n    state: 'door-{name}'\n    values: {0: 0, 2: 1}\n    reports: changes\n  \
                /doors.people: {state: crowd, kind: count}\n  /doors.celsius: {state: warmth, kind: continuous}\n  \
                /activity.data:\n    state: activity\n    kind: categorical\n    values: {sleep: asleep, work: busy}\n";
    std::fs::write(&mapping, text).expect("a mapping");
    let line = format!("import home {} --mapping {} --producer robot-1", file.display(), mapping.display());
    let import = words(&daemon, &line);
    let table = import.table();
    // Half of the 24 messages have a mode with a meaning; people and celsius always have one.
    assert_eq!(counts(&table, "/doors"), [12 + 24 + 24, 12, 0]);
    assert_eq!(counts(&table, "/activity"), [16, 8, 0]);
    assert!(import.stderr.contains("the value \"unknown\" means no value of the state, 8 times"), "{}", import.stderr);
    let states = words(&daemon, "state list home").table();
    let kind = |name: &str| {
        let row = states.column("state").iter().position(|state| *state == name)?;
        Some((states.column("kind")[row].to_owned(), states.column("observations")[row].to_owned()))
    };
    let is = |kind: &str, count: &str| Some((kind.to_owned(), count.to_owned()));
    assert_eq!(kind("door-front-left"), is("probability", "12"));
    assert_eq!(kind("crowd"), is("count", "24"));
    assert_eq!(kind("warmth"), is("continuous", "24"));
    assert!(kind("activity").is_some_and(|(kind, _)| kind == "categorical"), "{states:?}");
}

#[test]
fn traversals_and_people_come_from_their_messages() {
    let (folder, daemon) = started();
    let statistics = (
        "strands_navigation_msgs/NavStatistics",
        "string edge_id\nstring status\nstring origin\nstring target\nstring topological_map\nstring final_node\n\
         float64 time_to_waypoint\nfloat64 operation_time\nstring date_started\nstring date_at_node\nstring date_finished",
    );
    let mut bag = Bag::default();
    for (step, status) in (0_i64..).zip(["success", "failed", "success"]) {
        let time = START_NANOS + (1 + step) * HOUR_NANOS;
        let names = ["Hall_Lab", status, "Hall", "Lab", "building", "Lab"];
        let mut data: Vec<u8> = names.iter().flat_map(|name| bag::text(name)).collect();
        data.extend([12.0_f64, 12.5].iter().flat_map(|number| number.to_le_bytes()));
        data.extend(["", "", ""].iter().flat_map(|text| bag::text(text)));
        bag.message("/topological_navigation/Statistics", statistics, time, &data);
    }
    let file = written(&folder, "runs.bag", &bag, usize::MAX);
    let topology = folder.path().join("building.txt");
    std::fs::write(&topology, "node Hall\nnode Lab\nlink Hall Lab 8\n").expect("a file");
    words(&daemon, "map create home").table();
    words(&daemon, &format!("topology load home {}", topology.display())).table();
    let table = words(&daemon, &format!("import home {} --producer robot-1", file.display())).table();
    assert_eq!(table.column("becomes"), ["traversals"]);
    assert_eq!(counts(&table, "/topological_navigation/Statistics"), [3, 0, 0]);
    let states = words(&daemon, "state list home").table();
    assert!(states.column("state").contains(&"edge/Hall/Lab"), "{states:?}");
}

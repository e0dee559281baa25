//! Mappings as people write them, and the errors for wrong ones.

use super::*;

#[test]
fn a_mapping_is_read() -> Result<(), Box<dyn std::error::Error>> {
    let mapping = Mapping::read(
        "skip: [/rosout]\ngrid: [/map]\nstates:\n  /kitchen/door.data: kitchen-door\n  /doors.current_mode.value:\n    \
         state: 'door-{door_name}'\n    values: {2: 1, 0: 0}\n    reports: changes\n  /people.people: {state: crowd, kind: \
         count}\n  /seen.detections[].results[0].id:\n    state: 'seen-{results[0].id}'\n    value: 1\n    reports: events\n\
         positions:\n  /people.people[].position: person\ntraversals:\n  /stats: {from: origin, to: target, seconds: \
         operation_time, status: status, success: [success, true]}\n",
    )?;
    assert_eq!(mapping.topics().count(), 8);
    let states: Vec<String> = mapping.states.iter().map(|rule| rule.state.text()).collect();
    assert_eq!(states, ["door-{door_name}", "kitchen-door", "crowd", "seen-{results[0].id}"]);
    assert_eq!(mapping.states[0].reports, Reports::Changes);
    assert!(matches!(&mapping.states[0].value, ValueRule::Table(table) if table.get("2").is_some_and(|to| to == "1")));
    assert!(mapping.states[3].place.each.is_some() && mapping.states[3].value == ValueRule::Same(1.0));
    assert_eq!(mapping.traversals[0].success, ["success", "true"]);
    assert_eq!(Mapping::read("transform_gap: 7.5")?.transform_gap_nanos, Some(7_500_000_000));
    assert_eq!(Mapping::read("")?, Mapping::default());
    Ok(())
}

#[test]
fn what_is_wrong_with_a_mapping_is_reported_with_its_entry() {
    for (text, words) in [
        ("states: {door.data: door}", "door.data: use TOPIC.FIELD"),
        ("states: {/door.data: 'door-{name'}", "has no }"),
        ("states: {/door.data: {state: door, values: {1: open}}}", "\"open\" is no number"),
        ("states: {/door.data: {state: door, kind: vector}}", "vector"),
        ("states: {/door.data: {state: door, report: changes}}", "report"),
        ("states: {/door.da ta: door}", "is no field"),
        ("states: {/t.data: {state: t, kind: continuous, reports: events}}", "events is for"),
        ("positions: {/p.pose: {state: p, dimensions: 4}}", "use 2 or 3"),
        ("traversals: {/stats.x: {from: a, to: b, seconds: c, status: d, success: [e]}}", "topic alone"),
        ("transform_gap: -1", "transform_gap: -1 is no time"),
        ("state: {}", "state"),
        ("- a", ""),
    ] {
        let error = Mapping::read(text).err().map(|error| error.to_string());
        assert!(error.as_ref().is_some_and(|error| error.contains(words)), "{text}: {error:?}");
    }
}

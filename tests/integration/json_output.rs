//! The output of commands with `--output json`, against the schema that `tidemap schema` prints.
//!
//! Invariant: every command with a result is run here, and its output validated; keywords that the validator does not
//! know are an error, so that no rule of the schema is skipped.

use std::{collections::BTreeSet, fs, path::Path};

use serde_json::Value;
use tempfile::tempdir;
use tidemap_tests::{
    bag::Bag,
    cli::{self, Outcome},
    daemon::{Daemon, Launch},
};

/// Commands that take long, or no daemon; their definition is that of a command that is run. Commands of a cluster are
/// run where there is one, in `cluster.rs`.
const NOT_RUN: [&str; 8] = [
    "cluster status",
    "cluster maps",
    "cluster move",
    "cluster drain",
    "cluster forget",
    "cluster verify",
    "cluster heal",
    "foxglove",
];
/// Definitions that are no commands.
const PARTS: [&str; 5] = ["time", "time_or_null", "component", "model_error", "error"];

fn is_type(value: &Value, name: &str) -> bool {
    match name {
        "null" => value.is_null(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        "string" => value.is_string(),
        "array" => value.is_array(),
        "object" => value.is_object(),
        other => panic!("unknown type {other:?}"),
    }
}

fn resolved<'a>(root: &'a Value, path: &str) -> &'a Value {
    let name = path.strip_prefix("#/$defs/").unwrap_or_else(|| panic!("{path} is not a definition"));
    root["$defs"].get(name.replace("%20", " ")).unwrap_or_else(|| panic!("there is no {path}"))
}

/// Checks a value by the keywords of JSON Schema that our schema uses.
pub(crate) fn validate(root: &Value, schema: &Value, value: &Value, at: &str) -> Result<(), String> {
    let wrong = |text: String| Err(format!("{at}: {text}"));
    let rules = schema.as_object().expect("a schema is an object");
    for (keyword, rule) in rules {
        match keyword.as_str() {
            "description" | "patternProperties" => {}
            "$ref" => validate(root, resolved(root, rule.as_str().expect("a path")), value, at)?,
            "type" => {
                let one = [rule.clone()];
                let mut names = rule.as_array().map_or(&one[..], Vec::as_slice).iter().filter_map(Value::as_str);
                if !names.any(|name| is_type(value, name)) {
                    return wrong(format!("{value} is not {rule}"));
                }
            }
            "enum" if !rule.as_array().expect("values").contains(value) => return wrong(format!("{value}: {rule}")),
            "enum" => {}
            "minimum" | "maximum" => {
                let (bound, is_low) = (rule.as_f64().expect("a number"), keyword == "minimum");
                if value.as_f64().is_some_and(|found| if is_low { found < bound } else { found > bound }) {
                    return wrong(format!("{value} is beyond {keyword} {bound}"));
                }
            }
            "pattern" => {
                assert_eq!(rule, "^[A-Z_]+$", "a pattern that this validator does not know");
                let text = value.as_str().unwrap_or_default();
                if text.is_empty() || !text.chars().all(|letter| letter.is_ascii_uppercase() || letter == '_') {
                    return wrong(format!("{value} does not match {rule}"));
                }
            }
            "not" if validate(root, rule, value, at).is_ok() => return wrong(format!("{value} is not expected")),
            "not" => {}
            "anyOf" => {
                let tried = rule.as_array().expect("schemas").iter().map(|one| validate(root, one, value, at));
                let problems: Vec<String> = tried.filter_map(Result::err).collect();
                if problems.len() == rule.as_array().map_or(0, Vec::len) {
                    return wrong(problems.join("; or "));
                }
            }
            "items" => {
                for (index, item) in value.as_array().into_iter().flatten().enumerate() {
                    validate(root, rule, item, &format!("{at}[{index}]"))?;
                }
            }
            "required" => {
                for name in rule.as_array().into_iter().flatten().filter_map(Value::as_str) {
                    if value.is_object() && value.get(name).is_none() {
                        return wrong(format!("{name} is missing"));
                    }
                }
            }
            "properties" => {
                for (name, rule) in rule.as_object().expect("properties") {
                    value.get(name).map_or(Ok(()), |member| validate(root, rule, member, &format!("{at}.{name}")))?;
                }
            }
            "additionalProperties" => {
                let starts: Vec<&String> = rules
                    .get("patternProperties")
                    .and_then(Value::as_object)
                    .into_iter()
                    .flat_map(|all| all.keys())
                    .collect();
                for (name, member) in value.as_object().into_iter().flatten() {
                    let is_known = rules.get("properties").is_some_and(|known| known.get(name).is_some())
                        || starts.iter().any(|start| name.starts_with(start.trim_start_matches('^')));
                    match rule {
                        _ if is_known => {}
                        Value::Bool(false) => return wrong(format!("{name} has no schema")),
                        rule => validate(root, rule, member, &format!("{at}.{name}"))?,
                    }
                }
            }
            other => panic!("keyword {other:?}: this validator does not know it"),
        }
    }
    Ok(())
}

/// Runs commands and validates what they print.
struct Checked {
    daemon: Daemon,
    schema: Value,
    ran: BTreeSet<String>,
}

impl Checked {
    fn new(data: &Path) -> Self {
        let daemon = Launch::on(data).start();
        let printed = cli::tidemap(&daemon, ["schema"]);
        let schema = serde_json::from_str(&printed.stdout).expect("the schema is JSON");
        Self { daemon, schema, ran: BTreeSet::new() }
    }

    fn outcome(&self, args: &str, more: &[&str]) -> Outcome {
        cli::tidemap(&self.daemon, args.split_whitespace().chain(more.iter().copied()).chain(["--output", "json"]))
    }

    /// Runs a command of these words; its output must match the schema, and have rows unless `may_be_empty`.
    #[track_caller]
    fn run(&mut self, words: &str, args: &str) -> Value {
        self.ran.insert(words.to_owned());
        let outcome = self.outcome(&format!("{words} {args}"), &[]);
        assert_eq!(outcome.code, Some(0), "{words} {args}: {}", outcome.stderr);
        let definition = &self.schema["$defs"][words];
        assert!(definition.is_object(), "{words} has no definition");
        if outcome.stdout.is_empty() {
            let silent = resolved(&self.schema, "#/$defs/map%20delete");
            let is_silent = definition == silent || definition["$ref"] == "#/$defs/map%20delete";
            assert!(is_silent, "{words} {args} printed nothing: {}", outcome.stderr);
            return Value::Null;
        }
        let value: Value = serde_json::from_str(&outcome.stdout).unwrap_or_else(|e| panic!("{e}: {}", outcome.stdout));
        if let Err(problem) = validate(&self.schema, definition, &value, words) {
            panic!("{args}: {problem}\n{}", outcome.stdout);
        }
        value
    }

    /// A command that fails writes its error as the schema defines it.
    #[track_caller]
    fn fails(&self, args: &str, code: &str) {
        let outcome = self.outcome(args, &[]);
        assert!(outcome.code.is_some_and(|code| code != 0) && outcome.stdout.is_empty(), "{args}: {outcome:?}");
        let line = outcome.stderr.lines().last().unwrap_or_default();
        let value: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{args}: {error}: {line}"));
        if let Err(problem) = validate(&self.schema, &self.schema["$defs"]["error"], &value, args) {
            panic!("{problem}");
        }
        assert_eq!(value["error"]["code"], code, "{args}: {value}");
    }
}

const DAY: &str = "2025-01-28";
const NOON: &str = "2025-01-28T12:00:00Z";

/// Three weeks of a door, and of a person's place.
fn write_files(folder: &Path) {
    let mut door = "time,state,value\n".to_owned();
    let mut anna = "time,state,x,y\n".to_owned();
    for step in 0..1_000_i64 {
        let time = 1_736_121_600 + step * 1_740;
        let is_open = (9..17).contains(&(time / 3_600 % 24));
        door += &format!("{time},door,{}\n{time},Lab,{}\n", u8::from(is_open), u8::from(!is_open));
        anna += &format!("{time},anna,{},{}\n", if is_open { 1.5 } else { 6.0 }, 2.0);
    }
    let runs = "from,to,start,end,success,reason\n\
                Hall,Lab,2025-01-06T10:00:00Z,2025-01-06T10:00:20Z,true,\n\
                Hall,Lab,2025-01-06T22:00:00Z,2025-01-06T22:00:20Z,false,closed\n";
    let topology = "node Hall\nnode Lab\nnode Shop\nlink Hall Lab 10\nlink Lab Shop 20\n";
    let pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\nHEIGHT 1\n\
               VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA ascii\n2 0 0\n0 2 0\n-2 0 0\n1 1 0\n";
    for (name, text) in [("door.csv", &*door), ("anna.csv", &anna), ("runs.csv", runs), ("map.txt", topology)] {
        fs::write(folder.join(name), text).expect("a file");
    }
    let landmarks = "place,name,u_px,v_px,descriptor,along_m,number,x,y,z,qx,qy,qz,qw\n\
                     Hall,clock,10,20,00ff,,,,,,,,,\nHall,tag,,,,,7,1,2,0,0,0,0,1\nHall/Lab,sign,5,6,0f0f,2.5,,,,,,,,\n";
    let sightings = "time,place,seen\n2025-01-06T10:00:00Z,Hall,clock\n";
    let features = "u_px,v_px,descriptor\n12,21,00fe\n300,40,ff00\n";
    for (name, text) in [("landmarks.csv", landmarks), ("sightings.csv", sightings), ("features.csv", features)] {
        fs::write(folder.join(name), text).expect("a file");
    }
    fs::write(folder.join("scan.pcd"), pcd).expect("a file");
}

/// States before and after they are learned.
fn check_states(checked: &mut Checked, folder: &str) {
    // Nothing is learned yet, and people and programs see that.
    let before = checked.run("predict", &format!("home door --at {NOON}"));
    assert_eq!((&before[0]["model"], &before[0]["pending"]), (&"prior".into(), &1_000.into()), "{before}");
    let states = checked.run("state list", "home");
    assert!(states.as_array().is_some_and(|all| all.iter().any(|state| state["pending"] == 1_000)), "{states}");
    let updated = checked.run("update", "home");
    let after = checked.run("predict", &format!("home door --at {NOON}"));
    assert_eq!((&after[0]["pending"], &before[0]["observations"]), (&0.into(), &1_000.into()), "{after}");
    let chosen = updated.as_array().and_then(|all| all.iter().find(|row| row["state"] == "door"));
    assert_eq!(chosen.map(|row| &row["model"]), Some(&after[0]["model"]), "{updated} {after}");
    let shown = checked.run("model show", "home door");
    // The single model that the update has chosen, beside the ensemble that predicts.
    assert_eq!((&after[0]["model"], &shown["model"]), (&"ensemble".into(), &"histogram:24".into()));
    let mean = checked.run("predict", &format!("home door --at {NOON} --model mean"));
    assert_eq!(mean[0]["model"], "mean");
    checked.run("predict", &format!("home door --at {NOON} --where anna=1.5,2 --density 0.5,1"));
    checked.run("position", &format!("home anna --at {NOON} --top 3 --count 1h"));
    checked.run("evaluate", &format!("home {folder}/door.csv --models auto,mean,latest"));
    let times = "--from 2025-01-06T00:00:00Z --to 2025-01-27T00:00:00Z";
    checked.run("anomalies", &format!("home door --model auto --confidence 0.6 {times}"));
    checked.run("state add", "home activity --kind categorical --labels sleep,eat");
    let labels = checked.run("classify", &format!("home activity --at {NOON} --likelihood sleep=1,eat=3"));
    assert_eq!((labels[1]["label"].as_str(), labels[1]["probability"].as_f64()), (Some("eat"), Some(0.75)));
    checked.run("model show", "home activity");
    checked.run("predict", &format!("home activity --at {NOON}"));
    checked.run("anomalies", &format!("home --confidence 0.9 {times}"));
    checked.run("reconstruct", "home door --from 2025-01-06T00:00:00Z --to 2025-01-07T00:00:00Z");
}

/// A grid, locations, and what to explore.
fn check_grid_and_exploration(checked: &mut Checked, folder: &str) {
    checked.run("grid observe", &format!("home {folder}/scan.pcd --at {NOON} --pose 0,0,0,0,0,0,1 --producer r"));
    checked.run("update", "home");
    checked.run("grid predict", &format!("home --at {NOON} --out {folder}/noon.png"));
    let exported = checked.run("export", &format!("home {folder}/noon.yaml --at {NOON} --mask speed"));
    assert_eq!((&exported[0]["content"], exported.as_array().map(Vec::len)), (&"speed".into(), Some(1)));
    let exported = checked.run("export", &format!("home {folder}/map.yaml --at {NOON}"));
    assert!(exported[0]["ever_occupied"].is_u64(), "{exported}");
    checked.run("grid predict", &format!("home --at {NOON} --out {folder}/map-too.pgm"));
    let compared = checked.run("grid compare", &format!("home {folder}/map.yaml --at {NOON}"));
    assert_eq!(compared[0]["file_occupied"], compared[0]["map_found"]);
    let changed = checked.run("grid changed", "home");
    assert_eq!(changed, serde_json::json!([]));
    checked.run("visit", &format!("home 1,1 --reached true --at {NOON}"));
    let places = checked.run("reachability list", "home");
    assert_eq!((&places[0]["x"], &places[0]["reachability"]), (&1.25.into(), &1.into()), "{places}");
    checked.run("tour", &format!("home --at {NOON} --count 2 --start 0,0"));
    checked.run("info", &format!("home --at {NOON} --state door"));
    checked.run("info", &format!("home --at {NOON} --view 0,0,0.2"));
    checked.run("location set", "home entrance door --position 1,2");
    let places = checked.run("location list", "home");
    assert_eq!(places[0]["states"], serde_json::json!(["door"]));
    checked.run("day", &format!("home --date {DAY} --slot 4h --explore 2"));
    checked.run("slot", &format!("home --at {NOON}"));
    checked.run("location delete", "home entrance");
}

/// A topological map, with routes and searches.
fn check_topology(checked: &mut Checked, folder: &str) {
    checked.run("topology load", &format!("home {folder}/map.txt"));
    checked.run("traverse", &format!("home {folder}/runs.csv --producer r"));
    let route = checked.run("route", &format!("home Hall Shop --at {NOON} --alternatives 1"));
    assert_eq!((&route[0]["reports"], &route[0]["pending_reports"]), (&2.into(), &2.into()), "{route}");
    checked.run("update", "home");
    let route = checked.run("route", &format!("home Hall Shop --at {NOON}"));
    assert_eq!((&route[0]["reports"], &route[0]["pending_reports"]), (&2.into(), &0.into()), "{route}");
    checked.run("landmark add", &format!("home {folder}/landmarks.csv --descriptors orb"));
    checked.run("landmark observe", &format!("home {folder}/sightings.csv --producer r"));
    let places = checked.run("landmark list", "home");
    assert_eq!(places, serde_json::json!([{"place": "Hall", "landmarks": 2}, {"place": "Hall/Lab", "landmarks": 1}]));
    let landmarks = checked.run("landmark predict", &format!("home Hall --at {NOON} --count 1"));
    assert_eq!((&landmarks[0]["landmark"], &landmarks[0]["sightings"]), (&"clock".into(), &1.into()), "{landmarks}");
    checked.run("landmark list", "home Hall/Lab");
    checked.run("landmark locate", &format!("home {folder}/features.csv --at {NOON}"));
    checked.run("landmark prune", "home --below 0.1 --min-sightings 5");
    checked.run("landmark remove", "home Hall tag");
    checked.run("topology show", "home");
    checked.run("topology show", "home --edges");
    checked.run("topology failures", "home");
    checked.run("topology failures", "home --by reason");
    checked.run("no-go add", "home pit 20,20:21,20:21,21");
    checked.run("no-go list", "home");
    checked.run("no-go remove", "home pit");
    checked.run("topology predict", &format!("home --at {NOON}"));
    let reached = checked.run("topology reachable", &format!("home Hall --at {NOON}"));
    assert_eq!((&reached[0]["node"], &reached[0]["edges"]), (&"Hall".into(), &0.into()), "{reached}");
    checked.run("task add", "home clean Shop --from 09:00 --until 17:00 --duration 10m --value-state door");
    checked.run("task list", "home");
    let day = checked.run("day", &format!("home --date {DAY} --slot 1h --tasks --start-node Hall --keep"));
    assert!(day.as_array().is_some_and(|slots| slots.iter().any(|slot| slot["task"] == "clean/Shop")), "{day}");
    let plan = checked.run("plan show", &format!("home --date {DAY}"));
    assert_eq!((&plan[0]["task"], &plan[0]["now"]), (&"clean/Shop".into(), &false.into()), "{plan}");
    let times = format!("--start {NOON} --end {DAY}T12:30:00Z");
    checked.run("task report", &format!("home clean Shop --success true --producer r {times}"));
    let weeks = checked.run("task weeks", "home --hours 09:00-17:00");
    assert_eq!(weeks[0]["active_secs"], 1_800.0, "{weeks}");
    checked.run("task remove", "home clean Shop");
    checked.run("policy", &format!("home Shop --at {NOON} --horizon 1h"));
    checked.run("search", &format!("home --start Hall --at {NOON}"));
    checked.run("presence", &format!("home --at {NOON}"));
    checked.run("joint", &format!("home Lab door --from {NOON} --threshold 0.01"));
    checked.run("topology edit add-node", "home Attic --position 3,4");
    checked.run("topology edit set-node", "home Attic --position 3,5");
    checked.run("topology edit link", "home Shop Attic 12");
    checked.run("topology edit set-link", "home Shop Attic 14");
    checked.run("topology edit unlink", "home Shop Attic");
    checked.run("topology edit rename-node", "home Attic Loft");
    checked.run("topology edit remove-node", "home Loft");
}

/// Jobs, producers, copies, and the end of a map.
fn check_upkeep(checked: &mut Checked, folder: &str) {
    let jobs = checked.run("job list", "");
    checked.run("job watch", &jobs[0]["id"].to_string());
    checked.run("producer list", "home");
    checked.run("producer forget", "home r");
    checked.run("stats", "home");
    checked.run("backup create", &format!("{folder}/backup"));
    checked.run("erase", "home --state anna");
    let mut bag = Bag::default();
    bag.bool("/lamp", 1_736_121_600_000_000_000, true);
    bag.write(Path::new(&format!("{folder}/lamp.bag")), usize::MAX);
    let listed = checked.run("import", &format!("home {folder}/lamp.bag --list"));
    assert_eq!((&listed[0]["becomes"], &listed[0]["accepted"]), (&"state lamp".into(), &Value::Null));
    let imported = checked.run("import", &format!("home {folder}/lamp.bag --producer robot-2"));
    assert_eq!(imported[0]["accepted"], 1);
    checked.run("sample", "");
    checked.run("sample", &format!("door {folder}/door"));
    checked.run("map delete", "home --yes");
}

/// Errors as JSON.
fn check_errors(checked: &mut Checked, folder: &str) {
    checked.fails("map show home", "NOT_FOUND");
    checked.fails("map create Home", "INVALID_ARGUMENT");
    checked.fails("map delete home", "NOT_FOUND");
    checked.fails("predict home door --at then", "USAGE");
    checked.fails("predict home", "USAGE");
    checked.fails("sing", "USAGE");
    checked.fails("map list --server http://127.0.0.1:1", "UNAVAILABLE");
    checked.fails(&format!("observe home {folder}/none.csv"), "FAILED");
}

#[test]
fn every_command_prints_what_is_in_its_schema() {
    let work = tempdir().expect("a folder");
    let folder = &work.path().display().to_string();
    write_files(work.path());
    let mut checked = Checked::new(&work.path().join("data"));
    let map = checked.run("map create", "home --time-zone Europe/London --grid resolution=0.5,origin=-4:-4:0,flat");
    assert!(map[0]["periods"].is_array() && map[0]["models"].is_array(), "{map}");
    checked.run("map list", "");
    checked.run("map show", "home");
    checked.run("map set", "home --charger 0.5,0.5");
    checked.run("state add", "home visitors --kind count");
    checked.run("observe", &format!("home {folder}/door.csv --producer r"));
    checked.run("observe", &format!("home {folder}/anna.csv --producer r"));

    check_states(&mut checked, folder);
    check_grid_and_exploration(&mut checked, folder);
    check_topology(&mut checked, folder);
    check_upkeep(&mut checked, folder);
    check_errors(&mut checked, folder);

    let defined = checked.schema["$defs"].as_object().expect("definitions").keys();
    let missing: Vec<&String> = defined
        .filter(|name| !PARTS.contains(&name.as_str()) && !NOT_RUN.contains(&name.as_str()))
        .filter(|name| !checked.ran.contains(name.as_str()))
        .collect();
    assert_eq!(missing, Vec::<&String>::new(), "run these commands here");
    checked.daemon.stop_in_order();
}

#[test]
fn the_validator_finds_what_is_wrong() {
    let root = serde_json::json!({ "$defs": { "a b": {
        "type": "object", "properties": { "n": { "type": ["integer", "null"], "minimum": 0, "maximum": 1 } },
        "required": ["n"], "additionalProperties": false } } });
    let schema = serde_json::json!({ "type": "array", "items": { "$ref": "#/$defs/a%20b" } });
    let check = |value: Value| validate(&root, &schema, &value, "it").is_ok();
    assert!(check(serde_json::json!([{ "n": 1 }, { "n": null }])));
    for wrong in [
        serde_json::json!([{ "n": 1.5 }]),
        serde_json::json!([{ "n": 2 }]),
        serde_json::json!([{ "n": -1 }]),
        serde_json::json!([{}]),
        serde_json::json!([{ "n": 1, "m": 1 }]),
        serde_json::json!({ "n": 1 }),
    ] {
        assert!(!check(wrong.clone()), "{wrong}");
    }
}

//! Rules that the compiler does not check: the direction of dependencies between crates, which crate may use which
//! library, and the form of files. A failure names the file and the rule.
//!
//! Invariant: reads the work tree and changes nothing. Rules apply to code only: comments and tests may name anything.

mod bits;
mod catalogue;
mod circles;
mod phrases;
mod words;

use std::{
    fs,
    path::{Path, PathBuf},
};

/// Folder, package, and the workspace's packages that it may depend on.
const CRATES: [(&str, &str, &[&str]); 26] = [
    ("server/layout", "tidemap-layout", &[]),
    ("migrations", "tidemap-migrations", &["tidemap-layout"]),
    ("server/model", "tidemap-model", &[]),
    ("server/grid", "tidemap-grid", &["tidemap-model"]),
    ("server/map", "tidemap-map", &["tidemap-grid", "tidemap-model"]),
    ("server/picture", "tidemap-picture", &[]),
    ("server/plan", "tidemap-plan", &["tidemap-grid", "tidemap-map", "tidemap-model"]),
    ("server/answer", "tidemap-answer", &["tidemap-grid", "tidemap-map", "tidemap-model"]),
    (
        "server/store",
        "tidemap-store",
        &["tidemap-grid", "tidemap-layout", "tidemap-map", "tidemap-migrations", "tidemap-model"],
    ),
    ("server/cluster", "tidemap-cluster", &["tidemap-map", "tidemap-model", "tidemap-store"]),
    ("proto", "tidemap-proto", &["tidemap-grid", "tidemap-map", "tidemap-model", "tidemap-plan"]),
    (
        "server/base",
        "tidemap-base",
        &["tidemap-cluster", "tidemap-map", "tidemap-model", "tidemap-proto", "tidemap-store"],
    ),
    (
        "server/ingest",
        "tidemap-ingest",
        &[
            "tidemap-base",
            "tidemap-cluster",
            "tidemap-grid",
            "tidemap-map",
            "tidemap-model",
            "tidemap-proto",
            "tidemap-store",
        ],
    ),
    (
        "server/rpc",
        "tidemap-rpc",
        &[
            "tidemap-answer",
            "tidemap-base",
            "tidemap-cluster",
            "tidemap-grid",
            "tidemap-ingest",
            "tidemap-map",
            "tidemap-model",
            "tidemap-plan",
            "tidemap-proto",
            "tidemap-store",
        ],
    ),
    (
        "server/web",
        "tidemap-web",
        &[
            "tidemap-base",
            "tidemap-grid",
            "tidemap-ingest",
            "tidemap-map",
            "tidemap-model",
            "tidemap-picture",
            "tidemap-proto",
            "tidemap-rpc",
        ],
    ),
    (
        "server",
        "tidemapd",
        &[
            "tidemap-base",
            "tidemap-cluster",
            "tidemap-ingest",
            "tidemap-map",
            "tidemap-model",
            "tidemap-rpc",
            "tidemap-store",
            "tidemap-web",
        ],
    ),
    ("client", "tidemap-client", &["tidemap-grid", "tidemap-map", "tidemap-model", "tidemap-plan", "tidemap-proto"]),
    (
        "client/bench",
        "tidemap-bench",
        &[
            "tidemap-cli",
            "tidemap-client",
            "tidemap-formats",
            "tidemap-model",
            "tidemap-proto",
            "tidemap-sim",
            "tidemap-terminal",
        ],
    ),
    (
        "client/cli",
        "tidemap",
        &[
            "tidemap-client",
            "tidemap-formats",
            "tidemap-model",
            "tidemap-proto",
            "tidemap-recordings",
            "tidemap-sim",
            "tidemap-terminal",
        ],
    ),
    ("client/formats", "tidemap-formats", &["tidemap-map", "tidemap-model", "tidemap-picture"]),
    ("client/recordings", "tidemap-recordings", &[]),
    ("client/sim", "tidemap-sim", &[]),
    ("client/terminal", "tidemap-terminal", &["tidemap-formats"]),
    (
        "research",
        "tidemap-research",
        &[
            "tidemap-formats",
            "tidemap-grid",
            "tidemap-map",
            "tidemap-model",
            "tidemap-plan",
            "tidemap-sim",
            "tidemap-terminal",
        ],
    ),
    ("tests", "tidemap-tests", &["tidemap-client", "tidemap-cluster", "tidemap-proto", "tidemap-sim", "tidemap-store"]),
    // The daemon on a disk with a planted fault. Nothing depends on it.
    ("tests/planted_fault", "tidemapd-planted-fault", &["tidemapd", "tidemap-store"]),
];

/// Crates with a workspace of their own, so that `cargo build` needs neither Python nor C++ nor a fuzzer. Nothing
/// depends on them.
const APART: [(&str, &str, &[&str]); 3] = [
    ("client/cpp/queue", "tidemap-cpp", &["tidemap-client"]),
    ("client/python", "tidemap-python", &["tidemap-client", "tidemap-model", "tidemap-proto"]),
    (
        "tests/fuzz",
        "tidemap-fuzz",
        &["tidemap-formats", "tidemap-grid", "tidemap-proto", "tidemap-recordings", "tidemap-store"],
    ),
];

/// Crates that do no I/O, read no clock and draw no hidden randomness.
const PURE: [&str; 9] = [
    "server/answer",
    "server/model",
    "server/grid",
    "server/map",
    "server/picture",
    "server/plan",
    "client/formats",
    "client/recordings",
    "client/sim",
];

/// Names that a pure crate must not use.
const IMPURE: [&str; 18] = [
    "std::fs",
    "std::net",
    "std::env",
    "std::process",
    "tokio",
    "tonic",
    "sled",
    "serde",
    "SystemTime",
    "Instant::now",
    "Timestamp::now",
    "Zoned::now",
    "TimeZone::system",
    "thread_rng",
    "rand::rng",
    "rand::random",
    "from_os_rng",
    "OsRng",
];

const WALL_CLOCK: [&str; 3] = ["SystemTime::now", "Timestamp::now", "Zoned::now"];

const LINES_MAX: usize = 600;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the crate is in a workspace").to_path_buf()
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path} cannot be read: {error}"))
}

/// Files below a folder with an ending, relative to the root, without build results and hidden files.
fn files(folder: &str, ending: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![root().join(folder)];
    while let Some(folder) = folders.pop() {
        let entries = fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        for entry in entries {
            let path = entry.expect("a directory entry").path();
            let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
            if path.is_dir() && name != "target" && !name.starts_with('.') {
                folders.push(path);
            } else if name.ends_with(ending) {
                let relative = path.strip_prefix(root()).expect("a file below the root");
                found.push(relative.to_string_lossy().into_owned());
            }
        }
    }
    found.sort();
    found
}

/// The product files of a crate: no tests, no benchmarks, no build script.
fn sources(folder: &str) -> Vec<String> {
    files(&format!("{folder}/src"), ".rs").into_iter().filter(|path| is_product(path)).collect()
}

fn is_product(path: &str) -> bool {
    !path.ends_with("/tests.rs") && !path.contains("/tests/")
}

/// The code of a file without comments, up to the first `#[cfg(test)]` module.
fn code(text: &str) -> String {
    let mut kept = String::new();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        if line.trim() == "#[cfg(test)]" && lines.peek().is_some_and(|next| next.trim_end().ends_with('{')) {
            break;
        }
        kept.push_str(without_comment(line));
        kept.push('\n');
    }
    kept
}

fn without_comment(line: &str) -> &str {
    let mut quoted = false;
    let bytes = line.as_bytes();
    for (at, &byte) in bytes.iter().enumerate() {
        match byte {
            b'"' if at == 0 || !matches!(bytes[at - 1], b'\\' | b'\'') => quoted = !quoted,
            b'/' if !quoted && bytes.get(at + 1) == Some(&b'/') => return &line[..at],
            _ => {}
        }
    }
    line
}

/// Whether code names something: a path or the start of one, not the tail of another word.
fn names(code: &str, what: &str) -> bool {
    let word = |character: char| character.is_alphanumeric() || character == '_';
    let plain = code.match_indices(what).any(|(at, _)| {
        let after = &code[at + what.len()..];
        // `tonic` is also in `tonic_health::…`; a path such as `std::fs` ends where the word ends.
        let ends = if what.contains("::") { !after.starts_with(word) } else { after.starts_with([':', '_', ';', ' ']) };
        ends && !code[..at].ends_with(word)
    });
    // `use std::{env, fs};`
    let grouped = what.split_once("::").is_some_and(|(outer, inner)| {
        code.split(&format!("{outer}::{{")).skip(1).any(|rest| {
            let group = rest.split(';').next().unwrap_or_default();
            group.split(|character| !word(character)).any(|name| name == inner)
        })
    });
    plain || grouped
}

/// Packages in a section of a manifest.
fn dependencies(manifest: &str, section: &str) -> Vec<String> {
    let mut inside = false;
    let mut found = Vec::new();
    for line in manifest.lines() {
        if let Some(title) = line.strip_prefix('[') {
            inside = title.trim_end_matches(']') == section;
        } else if inside && !line.starts_with('#') {
            found.extend(line.split(['.', '=', ' ']).next().filter(|name| !name.is_empty()).map(str::to_owned));
        }
    }
    found
}

#[track_caller]
fn hold(broken: &[String]) {
    assert!(broken.is_empty(), "\n{}\n", broken.join("\n"));
}

#[test]
fn arrows_between_crates_go_one_way() {
    let manifest = read("Cargo.toml");
    let mut broken = Vec::new();
    for path in files(".", "Cargo.toml").iter().filter(|path| *path != "Cargo.toml") {
        let folder = path.trim_end_matches("/Cargo.toml");
        if !CRATES.iter().chain(&APART).any(|&(known, ..)| known == folder) {
            broken.push(format!("{path}: a crate that tests/tidy does not know; add it to CRATES"));
        }
    }
    for (folder, package, allowed) in CRATES.into_iter().chain(APART) {
        let path = format!("{folder}/Cargo.toml");
        let own = read(&path);
        for (section, extra) in [("dependencies", ""), ("build-dependencies", ""), ("dev-dependencies", "tidemap-sim")]
        {
            for name in dependencies(&own, section).iter().filter(|name| name.starts_with("tidemap")) {
                if !allowed.contains(&name.as_str()) && name != extra {
                    broken.push(format!("{path}: {package} may not depend on {name}; allowed: {allowed:?}"));
                }
            }
        }
        if APART.iter().any(|&(apart, ..)| apart == folder) {
            continue;
        }
        if !own.contains("[lints]\nworkspace = true") {
            broken.push(format!("{path}: has to take the lints of the workspace"));
        }
        if !manifest.contains(&format!("\"{folder}\"")) {
            broken.push(format!("Cargo.toml: {folder} is not a member of the workspace"));
        }
    }
    hold(&broken);
}

#[test]
fn pure_crates_do_no_io_and_hide_no_randomness() {
    let mut broken = Vec::new();
    for path in PURE.iter().flat_map(|folder| sources(folder)) {
        let code = code(&read(&path));
        // The formats parse text with it; the other crates parse nothing.
        let may_serde = path.starts_with("client/formats/") || path.starts_with("client/recordings/");
        for word in IMPURE.iter().filter(|&&word| names(&code, word) && !(may_serde && word == "serde")) {
            broken.push(format!("{path}: names {word}; a pure crate does no I/O, reads no clock, draws by a seed"));
        }
    }
    hold(&broken);
}

#[test]
fn libraries_stay_where_they_belong() {
    let mut broken = Vec::new();
    for (folder, ..) in CRATES.iter().filter(|&&(folder, ..)| folder != "tests") {
        for path in sources(folder) {
            let code = code(&read(&path));
            let may_tonic = path.starts_with("proto/")
                || matches!(*folder, "server/rpc" | "server/web" | "client" | "client/bench" | "client/cli");
            if !may_tonic && names(&code, "tonic") {
                broken.push(format!(
                    "{path}: names tonic; only proto, server/{{rpc,web}}, client, client/bench and client/cli may"
                ));
            }
            if *folder != "server/store" && names(&code, "sled") {
                broken.push(format!("{path}: names sled; only server/store may"));
            }
            if *folder != "server/cluster" && names(&code, "async_nats") {
                broken.push(format!("{path}: names async_nats; only server/cluster may"));
            }
            if path.ends_with("/clock.rs") {
                continue;
            }
            for word in WALL_CLOCK.iter().filter(|word| names(&code, word)) {
                broken.push(format!("{path}: names {word}; only clock.rs reads the wall clock"));
            }
        }
    }
    hold(&broken);
}

/// Folders whose code must not name something, because `proto/src/convert` does what it is for.
const NOT_NAMED: [(&str, &str); 3] =
    [("server/rpc/src", "InvalidField::new"), ("server/ingest/src", "v1::"), ("server/web/src/links", "v1::")];

#[test]
fn fields_of_the_wire_are_checked_in_convert() {
    let mut broken = Vec::new();
    for (folder, what) in NOT_NAMED {
        for path in files(folder, ".rs").iter().filter(|path| is_product(path)) {
            for (number, line) in code(&read(path)).lines().enumerate().filter(|(_, line)| line.contains(what)) {
                broken.push(format!("{path}:{}: {}; proto/src/convert does that", number + 1, line.trim()));
            }
        }
    }
    hold(&broken);
}

#[test]
fn files_are_named_opened_and_sized_well() {
    let mut broken = Vec::new();
    for path in files(".", ".rs") {
        let text = read(&path);
        let stem = path.rsplit('/').next().unwrap_or_default().trim_end_matches(".rs");
        if matches!(stem, "mod" | "utils" | "common" | "helpers" | "manager") {
            broken.push(format!("{path}: no file is called {stem}.rs"));
        }
        if !text.starts_with("//!") {
            broken.push(format!("{path}: opens with //!, what it is and its invariant"));
        }
        let lines = text.lines().count();
        if lines > LINES_MAX {
            broken.push(format!("{path}: {lines} lines; a file is read in one sitting, {LINES_MAX} at most"));
        }
    }
    hold(&broken);
}

#[test]
fn every_field_of_the_wire_is_explained() {
    let mut broken = Vec::new();
    for path in files("proto", ".proto") {
        let text = read(&path);
        let mut before = "";
        let mut depth = 0_usize;
        for (number, line) in text.lines().map(str::trim).enumerate() {
            let item = line.starts_with("rpc ") || (depth > 0 && line.ends_with(';') && line.contains(" = "));
            if item && !before.starts_with("//") {
                broken.push(format!("{path}:{}: has no comment above it: {line}", number + 1));
            }
            if !line.starts_with("//") {
                depth = (depth + line.matches('{').count()).saturating_sub(line.matches('}').count());
            }
            before = line;
        }
    }
    hold(&broken);
}

#[test]
fn the_readme_names_only_targets_that_exist() {
    let makefile = read("Makefile");
    let readme = read("README.md");
    let targets: Vec<&str> = makefile
        .lines()
        .filter(|line| !line.starts_with(['\t', '#', ' ', '.']))
        .filter_map(|line| line.split_once(':').filter(|(_, rest)| !rest.starts_with('=')))
        .flat_map(|(names, _)| names.split_whitespace())
        .collect();
    let mut broken = Vec::new();
    let lines = readme.lines().map(str::trim);
    let typed = lines.filter_map(|line| line.strip_prefix("make "));
    let quoted = readme.split("`make ").skip(1).filter_map(|rest| rest.split('`').next());
    for target in typed.chain(quoted).filter_map(|rest| rest.split_whitespace().next()) {
        if !targets.contains(&target) {
            broken.push(format!("README.md: `make {target}` is not a target of the Makefile"));
        }
    }
    hold(&broken);
}

#[test]
fn the_rules_can_fail() {
    assert!(names("use std::{env, fs};", "std::fs"));
    assert!(names("    std::fs::read(path)", "std::fs"));
    assert!(names("let now = Instant::now();", "Instant::now"));
    assert!(names("tonic_health::server", "tonic"));
    assert!(!names("use crate::unassled::Thing;", "sled"));
    assert!(!names(&code("/// unlike std::fs\n// sled::open\nfn f() {}"), "std::fs"));
    assert!(!names(&code("fn f() {}\n#[cfg(test)]\nmod tests {\n use std::fs;\n}"), "std::fs"));
    assert_eq!(without_comment("let url = \"http://x\"; // std::fs"), "let url = \"http://x\"; ");
    assert_eq!(
        dependencies("[dependencies]\na.workspace = true\nb = { path = \"x\" }\n[lints]\n", "dependencies"),
        ["a", "b"]
    );
}

//! Runs the shell examples of the README and of the guide, as a reader would type them.
//!
//! Every page has a folder and a daemon of its own, and all of them are read in order with one. Its ```` ```sh ````
//! blocks run in order and must end with status 0; an ```` ```output ```` block directly behind one must be what that
//! block showed. In it `…` matches any text, and a line with `…` alone any number of lines; the number of spaces
//! between words does not matter. Commands that a test cannot run, such as installation, are ```` ```console ````.
//!
//! Invariant: a block sees what a reader sees: tables, as on a terminal, unless its output goes to a file or a pipe. A
//! failure names the page and the line of the block.

mod output;
mod page;

use std::{
    fs,
    ops::Range,
    os::unix::{fs::PermissionsExt as _, process::CommandExt as _},
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process_group};
use tempfile::TempDir;
use tidemap_tests::{
    binaries,
    daemon::{Daemon, Launch},
};

use self::page::Block;

/// A block that has not ended by then hangs.
const ENDS_WITHIN: Duration = Duration::from_secs(180);
const POLL: Duration = Duration::from_millis(5);

/// A test for each page, and the list of all of them.
macro_rules! pages {
    ($($name:ident: $path:literal,)*) => {
        const PAGES: &[&str] = &[$($path),*];
        $(#[test]
        fn $name() {
            run($path);
        })*
    };
}

pages! {
    readme: "README.md",
    alerts: "docs/src/alerts.md",
    anomalies: "docs/src/anomalies.md",
    api: "docs/src/api.md",
    backup: "docs/src/backup.md",
    certainty: "docs/src/certainty.md",
    clusters: "docs/src/clusters.md",
    commands: "docs/src/commands.md",
    configuration: "docs/src/configuration.md",
    data_folder: "docs/src/data-folder.md",
    durability: "docs/src/durability.md",
    experiments: "docs/src/experiments.md",
    categories: "docs/src/categories.md",
    flows: "docs/src/flows.md",
    exploration: "docs/src/exploration.md",
    first_map: "docs/src/first-map.md",
    own_data: "docs/src/own-data.md",
    grids: "docs/src/grids.md",
    install: "docs/src/install.md",
    introduction: "docs/src/introduction.md",
    kinds: "docs/src/kinds.md",
    landmarks: "docs/src/landmarks.md",
    limits: "docs/src/limits.md",
    models: "docs/src/models.md",
    notebooks: "docs/src/notebooks.md",
    page: "docs/src/page.md",
    papers: "docs/src/papers.md",
    people: "docs/src/people.md",
    python: "docs/src/python.md",
    recordings: "docs/src/recordings.md",
    ros: "docs/src/ros.md",
    rotate: "docs/src/rotate.md",
    security: "docs/src/security.md",
    sizing: "docs/src/sizing.md",
    tasks: "docs/src/tasks.md",
    topology: "docs/src/topology.md",
    traces: "docs/src/traces.md",
    upgrade: "docs/src/upgrade.md",
    viewers: "docs/src/viewers.md",
    wire: "docs/src/wire.md",
}

/// Replaces the command line: shows a table where a reader would see one, which is where the output is not redirected.
const PROGRAM_SCRIPT: &str = r#"#!/bin/sh
program="$TIDEMAP_BUILT/$(basename "$0")"
case " $* " in *" --output "*) exec "$program" "$@" ;; esac
if [ /proc/self/fd/1 -ef "$TIDEMAP_SCREEN" ]; then exec "$program" "$@" --output table; fi
exec "$program" "$@"
"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the crate is in a workspace").to_path_buf()
}

/// The blocks of a page.
fn read(path: &str) -> (String, Vec<Block>) {
    let text = fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
    let blocks = page::blocks(&text).unwrap_or_else(|(line, problem)| panic!("{path}:{line}: {problem}"));
    (text, blocks)
}

fn run(path: &str) {
    let (text, blocks) = read(path);
    if blocks.is_empty() {
        return;
    }
    let reader = Reader::new();
    let renewed = reader.follow_all(path, &blocks);
    reader.daemon.stop_in_order();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    // From the last block on, so that the lines of the blocks before stay where they are.
    for (place, output) in renewed.iter().rev() {
        lines.splice(place.clone(), output.lines().map(str::to_owned));
    }
    if !renewed.is_empty() {
        fs::write(root().join(path), lines.join("\n") + "\n").unwrap_or_else(|error| panic!("{path}: {error}"));
    }
}

/// Each page has maps of its own, so that a reader needs one daemon and one folder for all of them.
#[test]
fn the_guide_is_read_in_order_with_one_daemon() {
    let summary = fs::read_to_string(root().join("docs/src/SUMMARY.md")).expect("the summary");
    let pages = summary.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    let reader = Reader::new();
    let mut pages_with_maps = 0;
    for page in pages {
        let path = format!("docs/src/{page}");
        let (_, blocks) = read(&path);
        // The others need neither a daemon nor what was done before.
        if blocks.iter().any(|block| block.script.contains("tidemap map create")) {
            reader.follow_all(&path, &blocks);
            pages_with_maps += 1;
        }
    }
    assert!(pages_with_maps > 10, "{pages_with_maps} pages");
    reader.daemon.stop_in_order();
}

/// Whether the pages are to be written with the outputs of today: `make guide-outputs`.
fn is_writing() -> bool {
    std::env::var_os("TIDEMAP_WRITE_OUTPUTS").is_some()
}

/// Somebody at a shell, with a daemon of their own.
struct Reader {
    folder: TempDir,
    daemon: Daemon,
}

impl Reader {
    fn new() -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        let programs = folder.path().join("programs");
        fs::create_dir_all(&programs).expect("a folder for the programs");
        fs::create_dir_all(folder.path().join("work")).expect("a folder to work in");
        for name in ["tidemap", "tidemap-bench", "tidemap-research"] {
            let script = programs.join(name);
            fs::write(&script, PROGRAM_SCRIPT).expect("the script can be written");
            fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).expect("the script can be run");
        }
        std::os::unix::fs::symlink(binaries::tidemapd(), programs.join("tidemapd")).expect("a link to the daemon");
        let daemon = Launch::on(&folder.path().join("data")).start();
        Self { folder, daemon }
    }

    /// Runs the blocks of a page. Returns the lines of outputs that are to be written, and what they are today.
    ///
    /// # Panics
    /// A block fails, or shows something else than the page.
    fn follow_all(&self, path: &str, blocks: &[Block]) -> Vec<(Range<usize>, String)> {
        let mut renewed = Vec::new();
        for block in blocks {
            let problem = match self.follow(block) {
                Ok(shown) => match &block.output {
                    Some(expected) if !output::matches(expected, &shown) && is_writing() => {
                        renewed.push((block.output_lines.clone(), output::renewed(expected, &shown)));
                        continue;
                    }
                    Some(expected) if !output::matches(expected, &shown) => {
                        format!("the block showed other output than the page has:\n{shown}--- the page\n{expected}")
                    }
                    _ => continue,
                },
                Err(problem) => problem,
            };
            panic!("{path}:{}: {problem}\n--- the daemon\n{}", block.line, self.daemon.process().stderr());
        }
        renewed
    }

    /// Runs a block. Returns what it shows.
    fn follow(&self, block: &Block) -> Result<String, String> {
        let screen = self.folder.path().join("screen");
        let file = fs::File::create(&screen).expect("a file for the output");
        let path = std::env::var("PATH").unwrap_or_default();
        let mut command = Command::new("bash");
        command.args(["-eu", "-o", "pipefail", "-c", &block.script]).current_dir(self.folder.path().join("work"));
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TIDEMAP_")) {
            command.env_remove(name);
        }
        command.env("PATH", format!("{}:{path}", self.folder.path().join("programs").display()));
        command.env("TIDEMAP_SERVER", &self.daemon.grpc);
        command.env("TIDEMAP_SCREEN", &screen).env("TIDEMAP_BUILT", binaries::profile_folder());
        command.env("XDG_CONFIG_HOME", self.folder.path().join("config"));
        let second = file.try_clone().expect("a second handle of the file");
        command.stdin(Stdio::null()).stdout(file).stderr(second);
        let status = wait(command).map_err(|error| format!("bash: {error}"))?;
        let shown = fs::read_to_string(&screen).expect("the output is text");
        if !status.success() {
            return Err(format!("the block ended with {status}:\n{shown}"));
        }
        Ok(shown)
    }
}

/// Runs a command with all processes that it starts; after [`ENDS_WITHIN`] they are ended.
fn wait(mut command: Command) -> std::io::Result<ExitStatus> {
    let mut child = command.process_group(0).spawn()?;
    let since = Instant::now();
    let status = loop {
        match child.try_wait()? {
            Some(status) => break Ok(status),
            None if since.elapsed() > ENDS_WITHIN => break Err(std::io::Error::other("the block does not end")),
            None => thread::sleep(POLL),
        }
    };
    // Kills the processes that the block left running in the background, or all of them.
    if let Some(group) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) {
        let _ = kill_process_group(group, Signal::KILL);
    }
    status
}

#[test]
fn every_page_is_run() {
    let mut pages: Vec<String> = fs::read_dir(root().join("docs/src"))
        .expect("the guide is there")
        .map(|entry| entry.expect("a file of the guide").file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".md") && name != "SUMMARY.md")
        .map(|name| format!("docs/src/{name}"))
        .chain(["README.md".to_owned()])
        .collect();
    pages.sort();
    let mut run = PAGES.to_vec();
    run.sort_unstable();
    assert_eq!(pages, run);
}

#[test]
fn the_summary_lists_every_page_once() {
    let summary = fs::read_to_string(root().join("docs/src/SUMMARY.md")).expect("the summary");
    for page in PAGES.iter().filter_map(|page| page.strip_prefix("docs/src/")) {
        assert_eq!(summary.matches(&format!("({page})")).count(), 1, "{page} in docs/src/SUMMARY.md");
    }
}

/// Links of the README, the guide and the page of the architecture to files and pages of the project.
#[test]
fn links_lead_somewhere() {
    for path in PAGES.iter().chain(&["ARCHITECTURE.md", "BENCHMARKS.md", "CHANGELOG.md"]) {
        let text = fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
        let folder = root().join(path).parent().expect("a page lies in a folder").to_path_buf();
        for (number, line) in text.lines().enumerate() {
            for target in line.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
                let file = target.split('#').next().unwrap_or_default();
                if target.contains("://") || file.is_empty() {
                    continue;
                }
                assert!(folder.join(file).exists(), "{path}:{}: there is no {file}", number + 1);
            }
        }
    }
}

/// Files and folders of the project that the documents name.
#[test]
fn files_that_the_documents_name_exist() {
    const ROOTS: [&str; 8] = ["server/", "research/", "client/", "proto/", "tests/", "migrations/", "docs/", "deploy/"];
    let mut checked = 0;
    for page in PAGES.iter().chain(&["ARCHITECTURE.md", "BENCHMARKS.md"]) {
        let text = fs::read_to_string(root().join(page)).unwrap_or_else(|error| panic!("{page}: {error}"));
        let quoted = text.split('`').filter(|quote| ROOTS.iter().any(|root| quote.starts_with(root)));
        for path in quoted.filter(|quote| !quote.contains(char::is_whitespace)) {
            assert!(root().join(path).exists(), "{page}: there is no {path}");
            checked += 1;
        }
    }
    assert!(checked > 20, "{checked} paths");
}

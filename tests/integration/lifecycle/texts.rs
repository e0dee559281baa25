//! Texts that the programs make of themselves: completions of shells, man pages, config files.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use tempfile::tempdir;
use tidemap_tests::binaries;

fn run(program: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(program);
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TIDEMAP_")) {
        command.env_remove(name);
    }
    command.args(args).output().expect("the program runs")
}

/// The words to which Bash completes the last of these words.
fn completed(program: &Path, name: &str, words: &[&str]) -> String {
    let script = run(program, &["completions", "bash"]);
    assert!(script.status.success());
    let last = words.len();
    let word = words.last().copied().unwrap_or_default();
    let folder = tempdir().expect("a folder");
    let file = folder.path().join("completions");
    fs::write(&file, script.stdout).expect("the script");
    let text = format!(
        "source {}; COMP_WORDS=({name} {}); COMP_CWORD={last}; _{name} {name} '{word}' x; echo \"${{COMPREPLY[@]}}\"",
        file.display(),
        words.join(" "),
    );
    let shown = Command::new("bash").args(["--norc", "-c", &text]).output().expect("bash runs");
    assert!(shown.status.success(), "{}", String::from_utf8_lossy(&shown.stderr));
    String::from_utf8(shown.stdout).expect("text").trim().to_owned()
}

#[test]
fn bash_completes_commands_and_values() {
    let (tidemap, tidemapd) = (binaries::tidemap(), binaries::tidemapd());
    assert_eq!(completed(&tidemap, "tidemap", &["map", "cr"]), "create");
    assert_eq!(completed(&tidemap, "tidemap", &["predict", "--tim"]), "--times --time");
    assert_eq!(completed(&tidemapd, "tidemapd", &["token", "rev"]), "revoke");
    for shell in ["zsh", "fish"] {
        for (program, command) in [(&tidemap, "observe"), (&tidemapd, "check")] {
            let text = String::from_utf8(run(program, &["completions", shell]).stdout).expect("text");
            assert!(text.contains(command), "{shell}: {command}");
        }
    }
    assert_eq!(run(&tidemap, &["completions", "cmd"]).status.code(), Some(2), "there is no such shell");
}

#[test]
fn every_command_has_a_man_page() {
    let folder = tempdir().expect("a folder");
    let dir = folder.path().join("man");
    for program in [binaries::tidemap(), binaries::tidemapd()] {
        let written = run(&program, &["man-pages", &dir.display().to_string()]);
        assert!(written.status.success(), "{}", String::from_utf8_lossy(&written.stderr));
    }
    for page in ["tidemap", "tidemap-map-create", "tidemap-observe", "tidemapd", "tidemapd-token-create"] {
        let text = fs::read_to_string(dir.join(format!("{page}.1"))).unwrap_or_else(|error| panic!("{page}: {error}"));
        assert!(text.contains(".TH") && text.contains("SYNOPSIS"), "{page}");
    }
    assert!(!dir.join("tidemap-man-pages.1").exists(), "hidden commands have none");
}

#[test]
fn the_settings_in_force_are_a_config_file() {
    let folder = tempdir().expect("a folder");
    let file = folder.path().join("tidemapd.toml");
    let path = file.display().to_string();
    fs::write(&file, "max_maps = 7\nsocket_mode = 0o660\n").expect("a config file");
    let before = run(&binaries::tidemapd(), &["--config", &path, "config"]);
    assert!(before.status.success(), "{}", String::from_utf8_lossy(&before.stderr));
    let text = String::from_utf8(before.stdout).expect("text");
    assert!(text.contains("\nmax_maps = 7\n") && text.contains("\nsocket_mode = 0o660\n"), "{text}");
    assert!(text.contains("\nmax_requests = 384\n"), "defaults are among them: {text}");
    fs::write(&file, &text).expect("what was printed");
    let again = run(&binaries::tidemapd(), &["--config", &path, "config"]);
    assert_eq!(String::from_utf8(again.stdout).expect("text"), text);

    fs::write(&file, "max_maps = 0").expect("a wrong config file");
    let wrong = run(&binaries::tidemapd(), &["--config", &path, "config"]);
    assert_eq!(wrong.status.code(), Some(78));
    assert!(String::from_utf8_lossy(&wrong.stderr).contains("max_maps"));
}

#[test]
fn the_example_config_has_every_setting_as_a_comment() {
    let folder = tempdir().expect("a folder");
    let example = run(&binaries::tidemapd(), &["config", "--example"]);
    assert!(example.status.success());
    let text = String::from_utf8(example.stdout).expect("text");
    assert!(text.lines().all(|line| line.is_empty() || line.starts_with('#')), "{text}");
    let file = folder.path().join("tidemapd.toml");
    // The section of a cluster has keys that must be set.
    let (text, _) = text.split_once("# --- cluster").expect("the last section");
    let keys: String = text
        .lines()
        .filter_map(|line| line.strip_prefix('#'))
        .filter(|line| !line.starts_with(' '))
        .fold(String::new(), |mut all, line| {
            all.push_str(line);
            all.push('\n');
            all
        });
    fs::write(&file, keys).expect("a config file of all defaults");
    let with = run(&binaries::tidemapd(), &["--config", &file.display().to_string(), "config"]);
    let without = run(&binaries::tidemapd(), &["config"]);
    assert!(with.status.success(), "{}", String::from_utf8_lossy(&with.stderr));
    assert_eq!(with.stdout, without.stdout, "what the example names as defaults are the defaults");
}

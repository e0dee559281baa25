//! The help: commands by task, and an example for each.
//!
//! Invariant: each command is in one group and has an example that can be parsed; tests hold this.

use std::fmt::Write as _;

use clap::Command;

/// The commands, grouped by the purpose of users.
const GROUPS: [(&str, &[&str]); 8] = [
    ("Try it", &["demo", "sample", "open"]),
    ("Make maps", &["map", "state", "location"]),
    ("Send observations and reports", &["import", "observe", "grid", "traverse", "visit"]),
    ("Learn, and examine models", &["update", "model", "evaluate"]),
    (
        "Predict, and examine the past",
        &["predict", "classify", "position", "presence", "joint", "export", "foxglove", "reconstruct", "anomalies"],
    ),
    ("Explore", &["info", "slot", "day", "tour", "reachability"]),
    ("Drive, work and search", &["topology", "landmark", "no-go", "task", "plan", "route", "policy", "search"]),
    ("Run the daemon", &["job", "producer", "stats", "backup", "erase", "cluster", "schema"]),
];

/// Examples by the words of their commands.
const EXAMPLES: &[(&str, &str)] = &[
    ("demo", "tidemap demo --keep"),
    ("sample", "tidemap sample office"),
    ("open", "tidemap open office"),
    ("map create", "tidemap map create office --time-zone Europe/London --grid resolution=0.1"),
    ("map list", "tidemap map list --output json"),
    ("map show", "tidemap map show office"),
    ("map set", "tidemap map set office --charger 1.5,-2"),
    ("map delete", "tidemap map delete office --yes"),
    ("state list", "tidemap state list office"),
    ("state add", "tidemap state add office visitors --kind count"),
    ("location set", "tidemap location set office pantry kitchen storage-door"),
    ("location list", "tidemap location list office"),
    ("location delete", "tidemap location delete office pantry"),
    ("observe", "tidemap observe office monday.csv --producer robot-1 --refused wrong.csv"),
    ("import", "tidemap import office monday.bag --list"),
    ("grid observe", "tidemap grid observe office scan.pcd --at 2025-03-18T10:00:00Z --pose 0,0,0.5,0,0,0,1"),
    ("grid predict", "tidemap grid predict office --at 2025-03-18T10:00:00Z --z 0.1:1.8 --picture ten.png"),
    ("grid compare", "tidemap grid compare office ros-map.yaml --at 2025-03-18T10:00:00Z"),
    ("grid changed", "tidemap grid changed office --region=-5:5,0:8 --z 0.1:1.8"),
    ("traverse", "tidemap traverse office runs.csv --producer robot-1"),
    ("visit", "tidemap visit office 1,-1 --reached false"),
    ("reachability list", "tidemap reachability list office"),
    ("update", "tidemap update office"),
    ("model show", "tidemap model show office kitchen --picture"),
    ("evaluate", "tidemap evaluate office next-week.csv --models auto,mean,latest"),
    (
        "predict",
        "tidemap predict office kitchen --from 2025-02-18T00:00:00Z --to 2025-02-19T00:00:00Z --step 30m --picture",
    ),
    ("classify", "tidemap classify home activity --likelihood sleep=0.2,eat=0.7 --place kitchen --learn"),
    ("position", "tidemap position office anna --at 2025-01-28T10:00:00Z --picture"),
    ("presence", "tidemap presence office --at now"),
    ("joint", "tidemap joint office cup plate --from now"),
    ("export", "tidemap export office week.mcap --from 2025-03-17T00:00:00Z --to 2025-03-24T00:00:00Z --step 1h"),
    ("foxglove", "tidemap foxglove office --ahead 14d"),
    ("reconstruct", "tidemap reconstruct office kitchen --from 2025-01-06T00:00:00Z --to 2025-01-13T00:00:00Z"),
    ("anomalies", "tidemap anomalies office kitchen --confidence 0.9 --from 2025-01-06T00:00:00Z --to now"),
    ("info", "tidemap info office --at now --state kitchen --state storage-door"),
    ("slot", "tidemap slot office --at now"),
    ("day", "tidemap day office --date 2025-02-18 --slot 30m --explore 6 --picture"),
    ("tour", "tidemap tour office --at now --count 4 --start 0,0 --picture tour.svg"),
    ("topology load", "tidemap topology load office topology.yaml"),
    ("topology show", "tidemap topology show office --edges"),
    ("topology failures", "tidemap topology failures office --limit 10"),
    ("topology predict", "tidemap topology predict office --at now --picture office.svg"),
    ("topology reachable", "tidemap topology reachable office kitchen --at now"),
    ("topology edit add-node", "tidemap topology edit add-node office pantry --position 3,4"),
    ("topology edit set-node", "tidemap topology edit set-node office pantry --position 3,4.5"),
    ("topology edit remove-node", "tidemap topology edit remove-node office pantry"),
    ("topology edit rename-node", "tidemap topology edit rename-node office pantry larder"),
    ("topology edit link", "tidemap topology edit link office kitchen pantry 12"),
    ("topology edit set-link", "tidemap topology edit set-link office kitchen pantry 14"),
    ("topology edit unlink", "tidemap topology edit unlink office kitchen pantry"),
    ("landmark add", "tidemap landmark add office landmarks.csv --descriptors orb"),
    ("landmark observe", "tidemap landmark observe office sightings.csv --producer robot-1"),
    ("landmark list", "tidemap landmark list office kitchen"),
    ("landmark predict", "tidemap landmark predict office kitchen --at now --count 10"),
    ("landmark locate", "tidemap landmark locate office features.csv --at now"),
    ("landmark remove", "tidemap landmark remove office kitchen 12 17"),
    ("landmark prune", "tidemap landmark prune office --below 0.1 --dry-run"),
    ("no-go add", "tidemap no-go add office stairs 0,0:2,0:2,3:0,3"),
    ("no-go list", "tidemap no-go list office"),
    ("no-go remove", "tidemap no-go remove office stairs"),
    ("task add", "tidemap task add office clean kitchen --from 18:00 --until 20:00 --duration 15m --days mon-fri"),
    ("task list", "tidemap task list office"),
    ("task remove", "tidemap task remove office clean kitchen"),
    (
        "task report",
        "tidemap task report office clean kitchen --start 2025-02-18T18:10:00Z --end 2025-02-18T18:24:00Z --success true",
    ),
    ("task weeks", "tidemap task weeks office --hours 08:00-20:00 --days mon-fri"),
    ("plan show", "tidemap plan show office --date 2025-02-18"),
    ("route", "tidemap route office entrance kitchen --at now --objective time"),
    ("policy", "tidemap policy office kitchen --at now"),
    ("search", "tidemap search office --start corridor --at now"),
    ("job list", "tidemap job list"),
    ("job watch", "tidemap job watch 7"),
    ("producer list", "tidemap producer list office"),
    ("producer forget", "tidemap producer forget office robot-2"),
    ("stats", "tidemap stats office"),
    ("backup create", "tidemap backup create /backups/tidemap"),
    ("erase", "tidemap erase office --producer robot-2 --from 2025-02-18T09:00:00Z --to 2025-02-18T10:00:00Z"),
    ("cluster status", "tidemap cluster status"),
    ("cluster maps", "tidemap cluster maps --output json"),
    ("cluster move", "tidemap cluster move office north"),
    ("cluster forget", "tidemap cluster forget north"),
    ("cluster drain", "tidemap cluster drain north"),
    ("cluster verify", "tidemap cluster verify office"),
    ("cluster heal", "tidemap cluster heal office"),
    ("schema", "tidemap schema map show"),
    ("completions", "tidemap completions bash"),
    ("man-pages", "tidemap man-pages ./man"),
];

/// Adds an example to the command of these words.
fn with_example(command: Command, words: &[&str], example: &'static str) -> Command {
    match words {
        [] => command.after_help(format!("Example:\n  {example}")),
        [first, rest @ ..] => {
            let is_known = command.find_subcommand(first).is_some();
            if is_known { command.mut_subcommand(first, |inner| with_example(inner, rest, example)) } else { command }
        }
    }
}

/// The command line with an example in the help of each command.
pub(super) fn with_examples(command: Command) -> Command {
    EXAMPLES.iter().fold(command, |command, (words, example)| {
        with_example(command, &words.split(' ').collect::<Vec<_>>(), example)
    })
}

/// The command line with its commands by task.
pub(super) fn grouped(command: Command) -> Command {
    let mut groups = String::new();
    let width = GROUPS.iter().flat_map(|(_, names)| *names).map(|name| name.len()).max().unwrap_or(0);
    for (heading, names) in GROUPS {
        let _ = writeln!(groups, "{heading}:");
        for name in names {
            // `make demo` builds without some.
            let Some(known) = command.find_subcommand(name) else { continue };
            let about = known.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(groups, "  {name:<width$}  {about}");
        }
        groups.push('\n');
    }
    command
        .help_template(format!(
            "{{before-help}}{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{groups}Options:\n{{options}}{{after-help}}"
        ))
        .after_help("tidemap COMMAND --help shows the arguments of a command, and an example.")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use clap::CommandFactory as _;

    use super::{super::CommandLine, *};

    /// The words of all commands without commands of their own.
    fn leaves(command: &Command, words: &str, found: &mut BTreeSet<String>) {
        for inner in command.get_subcommands().filter(|inner| inner.get_name() != "help") {
            let words = format!("{words} {}", inner.get_name()).trim().to_owned();
            if !inner.has_subcommands() {
                found.insert(words.clone());
            }
            leaves(inner, &words, found);
        }
    }

    #[test]
    fn every_command_is_in_one_group() {
        let command = CommandLine::command();
        let known: BTreeSet<&str> =
            command.get_subcommands().filter(|inner| !inner.is_hide_set()).map(Command::get_name).collect();
        let all: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| *names).copied().collect();
        assert_eq!(all.iter().copied().collect::<BTreeSet<_>>(), known);
        assert_eq!(all.len(), known.len());
        let help = grouped(CommandLine::command()).render_long_help().to_string();
        assert!(help.contains("\nExplore:\n  info ") && help.contains("--server"), "{help}");
    }

    #[test]
    fn every_command_has_an_example_that_can_be_parsed() {
        let mut found = BTreeSet::new();
        leaves(&CommandLine::command(), "", &mut found);
        let shown: BTreeSet<String> = EXAMPLES.iter().map(|(words, _)| (*words).to_owned()).collect();
        assert_eq!(found.difference(&shown).collect::<Vec<_>>(), Vec::<&String>::new(), "give these an example");
        for (words, example) in EXAMPLES {
            assert!(example.starts_with(&format!("tidemap {words}")), "{example}");
            let parsed = CommandLine::command().try_get_matches_from(example.split(' '));
            assert!(parsed.is_ok(), "{example}: {}", parsed.err().map(|error| error.to_string()).unwrap_or_default());
        }
        let mut command = with_examples(CommandLine::command());
        let help = command.find_subcommand_mut("predict").map(|predict| predict.render_long_help().to_string());
        assert!(help.is_some_and(|help| help.contains("Example:\n  tidemap predict office")));
    }
}

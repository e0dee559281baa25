//! The next steps of a user who sends a file: the commands that messages advise.
//!
//! Invariant: an advised command keeps the options that state how the file is read and what its rows are.

use std::path::Path;

use tidemap_client::observe::ProducerOptions;

use super::{super::shell_word::quoted, base_name};

/// The options of a file, each with a blank before it.
#[derive(Clone, Debug, Default)]
pub(crate) struct FileWords {
    /// The options for reading the file, and for the reporting of its states.
    pub(crate) words: String,
    /// The kinds of its states.
    pub(crate) kinds: String,
}

/// The commands that send a file again.
#[derive(Clone, Debug)]
pub(super) struct NextSteps<'a> {
    map: &'a str,
    shown: &'a str,
    /// The command without its file.
    again: String,
    /// The label, if it is not the label of the file.
    label: String,
    /// The command that sends the file in place of the data that was sent; stdin cannot be sent again.
    replace: Option<String>,
    /// The command of `replace`, without the options for kinds.
    replace_without_kinds: Option<String>,
}

impl<'a> NextSteps<'a> {
    pub(super) fn new(options: &'a ProducerOptions, command: &str, of_file: &FileWords, shown: &'a str) -> Self {
        let ProducerOptions { map, producer, label, .. } = options;
        let FileWords { words, kinds } = of_file;
        let without_kinds = format!("tidemap {command} {} --producer {}{words}", quoted(map), quoted(producer));
        let again = format!("{without_kinds}{kinds}");
        let label =
            if base_name(Path::new(shown)) == *label { String::new() } else { format!(" --label {}", quoted(label)) };
        let replace = |command_line: &str| format!("{command_line} {}{label} --replace", quoted(shown));
        let [replace, replace_without_kinds] =
            [&again, &without_kinds].map(|line| (command == "observe" && shown != "stdin").then(|| replace(line)));
        Self { map, shown, again, label, replace, replace_without_kinds }
    }

    /// The command that sends another file.
    pub(super) fn again(&self) -> &str {
        &self.again
    }

    /// After rows were refused.
    pub(super) fn refused(&self) -> Option<String> {
        let Self { again, shown, label, .. } = self;
        let replaced = self.replace.as_ref().map_or_else(String::new, |replace| {
            format!("; or correct them in {shown}, and send all of it anew in place of this: {replace}")
        });
        (*shown != "stdin").then(|| {
            format!(
                "to correct the refused rows: {again} {}{label} --refused FILE writes them to a file of their own, and \
                 sends nothing twice{replaced}",
                quoted(shown)
            )
        })
    }

    /// After values were refused that are no probabilities.
    pub(super) fn no_probabilities(&self) -> String {
        format!(
            "values that are not between 0 and 1 need states of another kind: {} --kinds 'PATTERN=continuous', or \
             count. A state keeps its kind: erase one that exists first, with tidemap erase {} --state NAME",
            self.replace_without_kinds.as_deref().unwrap_or("send them with"),
            quoted(self.map)
        )
    }

    /// Before a state can be reported otherwise, or be of another kind.
    pub(super) fn erase_first(&self, name: &str) -> String {
        let erase = format!("erase it first, with tidemap erase {} --state {}", quoted(self.map), quoted(name));
        format!("{erase}, and send the file anew: {}", self.replace.as_deref().unwrap_or("with another --label"))
    }

    /// The advice after rows were sent as readings that are probably changes.
    pub(super) fn as_changes(&self, first: &str) -> String {
        self.otherwise(first, "--changes")
    }

    /// The advice after rows were sent as changes that are probably events.
    pub(super) fn as_events(&self, first: &str) -> String {
        self.otherwise(first, "--events in place of --changes")
    }

    fn otherwise(&self, first: &str, option: &str) -> String {
        let erase = format!("tidemap erase {} --state {}", quoted(self.map), quoted(first));
        match (&self.replace, &self.replace_without_kinds, option) {
            (Some(replace), _, "--changes") => {
                format!("erase the state ({erase}), and send the file anew: {replace} --changes")
            }
            // Events have a kind of their own.
            (_, Some(replace), _) => {
                let replace = replace.replace(" --changes", " --events");
                format!("erase the state ({erase}), and send the file anew: {replace}")
            }
            (.., option) => format!("erase the state ({erase}), and send the rows with {option} and another --label"),
        }
    }

    /// After rows that were sent before, of states that the map does not have.
    pub(super) fn absent(&self, states: &str) -> String {
        let what = match &self.replace {
            Some(replace) => format!("To send them anew: {replace}"),
            None => "To send them anew, give them another --label".to_owned(),
        };
        format!(
            "the map has nothing of {states}: these rows were sent before, and were refused then or erased since. {what}"
        )
    }

    /// The advice after the file differs from the data that was sent. `another`: a free label.
    pub(super) fn differs(&self, another: &str) -> String {
        let corrected = self.replace.as_ref().map_or_else(
            || {
                "Corrected rows of the same file go into a file of their own (--refused FILE writes them); with \
                 another label, all rows would count again."
                    .to_owned()
            },
            |replace| {
                format!(
                    "If it was corrected, this withdraws the rows sent before, and sends the file anew: {replace}. \
                     (Rows that are only added at the end are sent without that; with another label, all rows would \
                     count again.)"
                )
            },
        );
        format!("{corrected} Another file needs another label, such as --label {another}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advised_commands_keep_the_options_of_the_file() {
        let options = ProducerOptions::new("hub", "export.csv", "home");
        let words = " --changes --local --columns time=last_changed".to_owned();
        let words = FileWords { words, kinds: String::new() };
        let steps = NextSteps::new(&options, "observe", &words, "data/export.csv");
        let anew = "tidemap observe home --producer hub --changes --local --columns time=last_changed data/export.csv \
                    --replace";
        for text in [steps.refused().unwrap_or_default(), steps.absent("\"door\""), steps.differs("b")] {
            assert!(text.contains(anew), "{text}");
        }
        assert!(steps.as_events("the door").contains("--state 'the door'"));
        assert!(steps.as_events("door").contains("--producer hub --events --local"));
        // Options that would be refused beside the advised option are left out.
        let kinds = FileWords { kinds: " --kinds 'a*=probability'".to_owned(), ..words };
        let steps = NextSteps::new(&options, "observe", &kinds, "x.csv");
        assert_eq!(steps.no_probabilities().matches("--kinds").count(), 1);
        assert!(!steps.as_events("door").contains("--kinds") && steps.again().contains("--kinds 'a*=probability'"));
        let labelled = ProducerOptions::new("hub", "a b", "home");
        assert!(
            NextSteps::new(&labelled, "observe", &FileWords::default(), "x.csv")
                .differs("c")
                .contains("x.csv --label 'a b' --replace")
        );
        let piped = NextSteps::new(&options, "observe", &FileWords::default(), "stdin");
        assert!(piped.refused().is_none() && piped.absent("x").contains("another --label"));
    }
}

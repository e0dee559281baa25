//! `tidemap schema`: the JSON schema of the output of commands with --output json.
//!
//! Invariant: `schema/output.json` has a definition for each command, by its words; `tests/integration/json_output.rs`
//! validates the output of the commands against it.

use std::{collections::BTreeMap, process::ExitCode};

use clap::Args;
use serde_json::Value;

use super::UsageError;
use crate::output;

/// The schema of all commands, draft 2020-12.
const SCHEMA: &str = include_str!("schema/output.json");
const DEFINITION: &str = "#/$defs/";

#[derive(Debug, Args)]
pub(crate) struct SchemaArgs {
    /// The words of a command, such as `map show`, or `error` [default: all]
    #[arg(value_name = "COMMAND")]
    words: Vec<String>,
}

/// Prints the schema of one command or of all.
pub(crate) fn run(args: &SchemaArgs) -> anyhow::Result<ExitCode> {
    let text = if args.words.is_empty() { SCHEMA.to_owned() } else { of_command(&args.words.join(" "))? };
    output::print(&format!("{}\n", text.trim_end()))?;
    Ok(ExitCode::SUCCESS)
}

/// The schema of one command, with the definitions that it needs.
fn of_command(words: &str) -> anyhow::Result<String> {
    let schema: Value = serde_json::from_str(SCHEMA)?;
    let all = &schema["$defs"];
    if all.get(words).is_none() {
        let text = format!("no command {words:?} has a schema: `tidemap --help` lists the commands");
        return Err(UsageError(text).into());
    }
    let (mut needed, mut waiting) = (BTreeMap::new(), vec![words.to_owned()]);
    while let Some(name) = waiting.pop() {
        if let Some(definition) = all.get(&name).filter(|_| !needed.contains_key(&name)) {
            names_in(definition, &mut waiting);
            needed.insert(name, definition.clone());
        }
    }
    let whole = serde_json::json!({
        "$schema": schema["$schema"],
        "title": format!("tidemap {words} --output json"),
        "$ref": format!("{DEFINITION}{}", words.replace(' ', "%20")),
        "$defs": needed,
    });
    Ok(serde_json::to_string_pretty(&whole)?)
}

/// Collects the names of the definitions that a schema refers to.
fn names_in(schema: &Value, names: &mut Vec<String>) {
    match schema {
        Value::Object(members) => {
            let name = members.get("$ref").and_then(Value::as_str).and_then(|path| path.strip_prefix(DEFINITION));
            names.extend(name.map(|name| name.replace("%20", " ")));
            members.values().for_each(|member| names_in(member, names));
        }
        Value::Array(items) => items.iter().for_each(|item| names_in(item, names)),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use clap::{Command, CommandFactory as _};

    use super::{super::CommandLine, *};

    /// Commands whose output is not a result: a page in a browser, a demo, a shell's completions, a schema.
    const WITHOUT: [&str; 5] = ["open", "demo", "completions", "man-pages", "schema"];

    fn leaves(command: &Command, words: &str, found: &mut Vec<String>) {
        for inner in command.get_subcommands().filter(|inner| inner.get_name() != "help") {
            let words = format!("{words} {}", inner.get_name()).trim().to_owned();
            leaves(inner, &words, found);
            if !inner.has_subcommands() {
                found.push(words);
            }
        }
    }

    #[test]
    fn every_command_has_a_schema() -> anyhow::Result<()> {
        let schema: Value = serde_json::from_str(SCHEMA)?;
        let mut commands = Vec::new();
        leaves(&CommandLine::command(), "", &mut commands);
        commands.retain(|words| !WITHOUT.contains(&words.as_str()));
        assert!(commands.len() > 40, "{commands:?}");
        for words in &commands {
            assert!(schema["$defs"].get(words).is_some(), "{words} has no definition in schema/output.json");
        }
        let known = ["error", "time", "time_or_null", "component", "model_error"];
        for name in schema["$defs"].as_object().into_iter().flat_map(|all| all.keys()) {
            assert!(known.contains(&name.as_str()) || commands.contains(name), "{name} is no command");
        }
        Ok(())
    }

    #[test]
    fn one_command_has_the_definitions_that_it_needs() -> anyhow::Result<()> {
        let schema: Value = serde_json::from_str(&of_command("state add")?)?;
        assert_eq!(schema["$ref"], "#/$defs/state%20add");
        let names: Vec<&String> = schema["$defs"].as_object().into_iter().flat_map(|all| all.keys()).collect();
        assert_eq!(names, ["state add", "state list", "time_or_null"].iter().collect::<Vec<_>>());
        assert!(of_command("sing").is_err());
        Ok(())
    }
}

//! Texts that are made of the command line and the settings: completions of shells, man pages, config files.
//!
//! Invariant: the texts describe what this program accepts; they contain no hidden commands.

use std::{
    fs,
    io::{self, Write as _},
    path::Path,
    process::ExitCode,
};

use clap::CommandFactory as _;
use tidemap_base::config::{Flags, OfflineCommand, Settings, config_text};

/// Runs a command that only prints or writes such a text; `None` for other commands.
pub(crate) fn run(flags: &Flags) -> Option<ExitCode> {
    let done = match flags.command.as_ref()? {
        OfflineCommand::Completions { shell } => {
            let mut text = Vec::new();
            clap_complete::generate(*shell, &mut Flags::command(), "tidemapd", &mut text);
            print(&text)
        }
        OfflineCommand::ManPages { dir } => man_pages(dir),
        OfflineCommand::Config { example: true } => config_text::example().and_then(|text| print(text.as_bytes())),
        OfflineCommand::Config { example: false } => match Settings::load(flags) {
            Ok(settings) => config_text::in_force(&settings).and_then(|text| print(text.as_bytes())),
            Err(error) => {
                eprintln!("tidemapd: {error:#}");
                return Some(ExitCode::from(78));
            }
        },
        _ => return None,
    };
    Some(match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("tidemapd: {error:#}");
            ExitCode::FAILURE
        }
    })
}

/// A closed stdout is no error: its reader has stopped reading on purpose.
fn print(text: &[u8]) -> anyhow::Result<()> {
    match io::stdout().write_all(text) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

fn man_pages(dir: &Path) -> anyhow::Result<()> {
    use anyhow::Context as _;
    let written = fs::create_dir_all(dir).and_then(|()| clap_mangen::generate_to(Flags::command(), dir));
    written.with_context(|| format!("man pages in {}", dir.display()))
}

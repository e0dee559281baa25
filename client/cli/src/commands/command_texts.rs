//! `tidemap completions` and `tidemap man-pages`: texts for shells and for `man`, made from the command line itself.
//!
//! Invariant: both texts describe exactly the arguments that this program accepts; hidden commands are in neither.

use std::{fs, path::PathBuf, process::ExitCode};

use anyhow::Context as _;
use clap::{Args, CommandFactory as _};
use clap_complete::Shell;

use super::help;
use crate::{commands::CommandLine, output};

/// Arguments of `tidemap completions`.
#[derive(Debug, Args)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
}

/// Arguments of `tidemap man-pages`.
#[derive(Debug, Args)]
pub(crate) struct ManPagesArgs {
    /// Folder for the pages, one for each command
    #[arg(value_name = "DIR")]
    dir: PathBuf,
}

/// Prints the completions of a shell.
pub(crate) fn completions(args: &CompletionsArgs) -> anyhow::Result<ExitCode> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut CommandLine::command(), "tidemap", &mut text);
    std::io::Write::write_all(&mut output::stdout(), &text)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the man pages into a folder, which is made if it does not exist.
pub(crate) fn man_pages(args: &ManPagesArgs) -> anyhow::Result<ExitCode> {
    let written = fs::create_dir_all(&args.dir)
        .and_then(|()| clap_mangen::generate_to(help::with_examples(CommandLine::command()), &args.dir));
    written.with_context(|| format!("man pages in {}", args.dir.display()))?;
    Ok(ExitCode::SUCCESS)
}

//! `tidemapd token`: makes, lists and revokes tokens in the file that the daemon reads.
//!
//! Invariant: a token is printed once, on stdout, when it is made; nothing else ever shows it.

use std::{
    io::{self, Write as _},
    path::Path,
    process::ExitCode,
};

use anyhow::{Context as _, bail};
use clap::{Args, Subcommand};
use tidemap_map::time::format_rfc3339;

use super::{
    MapPattern, Role,
    token_file::{self, NOTE_BYTES_MAX, Token},
};
use crate::clock::{Clock as _, SystemClock};

/// What to do with tokens.
#[derive(Clone, Debug, Subcommand)]
pub(crate) enum TokenCommand {
    /// Make a token and print it, this once; a running daemon takes it within seconds.
    Create(CreateArgs),
    /// List the tokens: id, roles, maps, when each was made, and its note.
    List,
    /// Revoke a token; a running daemon refuses it within seconds, and ends its streams.
    Revoke {
        /// The id of the token, its part between the first two underscores.
        #[arg(value_name = "ID")]
        id: String,
    },
}

/// What a new token allows.
#[derive(Clone, Debug, Args)]
pub(crate) struct CreateArgs {
    /// What the token allows; give it several times for several roles.
    #[arg(long = "role", value_name = "ROLE", required = true)]
    roles: Vec<Role>,
    /// A map that the token is for, or the beginning of names and * (lab-*); give it several times for several
    /// [default: all maps].
    #[arg(long = "map", value_name = "MAP")]
    maps: Vec<MapPattern>,
    /// Who gets the token.
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
}

/// Runs a command on a token file.
///
/// # Errors
/// The file is not configured, or cannot be read or changed; there is no such token.
pub(crate) fn run(command: &TokenCommand, path: &Path) -> anyhow::Result<ExitCode> {
    if path.as_os_str().is_empty() {
        bail!("setting tokens_file is not set: name the file of tokens, for example --tokens-file tokens.toml");
    }
    let mut out = io::stdout().lock();
    match command {
        TokenCommand::Create(args) => {
            if args.note.len() > NOTE_BYTES_MAX || args.note.chars().any(char::is_control) {
                bail!("the note must be up to {NOTE_BYTES_MAX} bytes without control characters");
            }
            let mut roles = args.roles.clone();
            roles.sort_unstable();
            roles.dedup();
            let all = || vec![MapPattern::all()];
            let maps = if args.maps.is_empty() { all() } else { args.maps.clone() };
            let created_secs = SystemClock.now_nanos().div_euclid(1_000_000_000);
            let (token, text) = token_file::generate(roles, maps, args.note.clone(), created_secs).context("token")?;
            token_file::change(path, |tokens| {
                tokens.push(token);
                Ok(())
            })?;
            writeln!(out, "{text}")?;
        }
        TokenCommand::List => {
            writeln!(out, "id,roles,maps,created,note")?;
            for token in token_file::read(path)? {
                writeln!(out, "{}", line(&token))?;
            }
        }
        TokenCommand::Revoke { id } => {
            let is_gone = token_file::change(path, |tokens| {
                let before = tokens.len();
                tokens.retain(|token| token.id != *id);
                Ok(tokens.len() < before)
            })?;
            if !is_gone {
                // Whoever gives the whole token by mistake does not find it in a log.
                bail!("there is no token of this id: `tidemapd token list` shows the ids");
            }
            eprintln!("revoked; a running daemon refuses it within seconds");
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn line(token: &Token) -> String {
    let roles: Vec<&str> = token.roles.iter().map(|role| role.name()).collect();
    let maps: Vec<String> = token.maps.iter().map(ToString::to_string).collect();
    let created = format_rfc3339(token.created_secs.saturating_mul(1_000_000_000));
    let note = if token.note.contains([',', '"']) { format!("{:?}", token.note) } else { token.note.clone() };
    format!("{},{},{},{created},{note}", token.id, roles.join(" "), maps.join(" "))
}

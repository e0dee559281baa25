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
use tidemap_model::time::{format_rfc3339, parse_duration, parse_time};

use super::{
    MapPattern, ProducerPattern, Role,
    token_file::{self, NOTE_BYTES_MAX, Token},
};
use crate::clock::{Clock as _, SystemClock};

const NANOS_PER_SEC: i64 = 1_000_000_000;

/// Manage tokens.
#[derive(Clone, Debug, Subcommand)]
pub enum TokenCommand {
    /// Create a token and print it once; a running daemon accepts it within seconds.
    Create(CreateArgs),
    /// List the tokens: id, roles, maps, creation time, note, expiry time, and producers.
    List,
    /// Revoke a token; a running daemon refuses it within seconds, and ends its streams.
    Revoke {
        /// The id of the token, its part between the first two underscores.
        #[arg(value_name = "ID")]
        id: String,
    },
}

/// The permissions of a new token.
#[derive(Clone, Debug, Args)]
pub struct CreateArgs {
    /// Role of the token; repeat the option for several roles.
    #[arg(long = "role", value_name = "ROLE", required = true)]
    roles: Vec<Role>,
    /// Map of the token, or the beginning of names and * (lab-*); repeat the option for several [default: all maps].
    #[arg(long = "map", value_name = "MAP")]
    maps: Vec<MapPattern>,
    /// Producer as which the token may send observations, or the beginning of names and * (robot-*); repeat the option
    /// for several [default: all producers].
    #[arg(long = "producer", value_name = "PRODUCER")]
    producers: Vec<ProducerPattern>,
    /// Expiry of the token: after a duration such as 90d or 12h, or at a time such as 2027-01-01T00:00:00Z [default:
    /// never].
    #[arg(long, value_name = "WHEN")]
    expires: Option<String>,
    /// Note about the owner of the token.
    #[arg(long, value_name = "TEXT", default_value = "")]
    note: String,
}

/// Runs a command on a token file.
///
/// # Errors
/// The file is not configured, or cannot be read or changed; there is no such token.
pub fn run(command: &TokenCommand, path: &Path) -> anyhow::Result<ExitCode> {
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
            let of_all = || vec![ProducerPattern::all()];
            let producers = if args.producers.is_empty() { of_all() } else { args.producers.clone() };
            let now = SystemClock.now_nanos();
            let expires_secs = args.expires.as_deref().map(|when| expiry_secs(when, now)).transpose()?;
            let created_secs = now.div_euclid(NANOS_PER_SEC);
            let made = token_file::generate(roles, maps, producers, args.note.clone(), created_secs, expires_secs);
            let (token, text) = made.context("token")?;
            token_file::change(path, |tokens| {
                tokens.push(token);
                Ok(())
            })?;
            writeln!(out, "{text}")?;
        }
        TokenCommand::List => {
            writeln!(out, "id,roles,maps,created,note,expires,producers")?;
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
                // The message does not repeat the text, so that a whole token that is given by mistake is not in a log.
                bail!("there is no token of this id: `tidemapd token list` shows the ids");
            }
            eprintln!("revoked; a running daemon refuses it within seconds");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Parses the end of a token, in seconds since 1970.
fn expiry_secs(when: &str, now: i64) -> anyhow::Result<i64> {
    let expires = match parse_duration(when) {
        Ok(duration) => now.saturating_add(duration),
        Err(_) => parse_time(when).map_err(|_| {
            anyhow::anyhow!(
                "--expires is {when:?}: it must be a duration such as 90d, or a time such as 2027-01-01T00:00:00Z"
            )
        })?,
    };
    if expires <= now {
        bail!("--expires is {when:?}, which has passed: the token would never be valid");
    }
    Ok(expires.div_euclid(NANOS_PER_SEC))
}

fn line(token: &Token) -> String {
    let roles: Vec<&str> = token.roles.iter().map(|role| role.name()).collect();
    let maps: Vec<String> = token.maps.iter().map(ToString::to_string).collect();
    let producers: Vec<String> = token.producers.iter().map(ToString::to_string).collect();
    // A name may have any printable character.
    let producers = producers.join(" ");
    let producers = if producers.contains([',', '"']) { format!("{producers:?}") } else { producers };
    let time = |secs: i64| format_rfc3339(secs.saturating_mul(NANOS_PER_SEC));
    let created = time(token.created_secs);
    let expires = token.expires_secs.map(time).unwrap_or_default();
    let note = if token.note.contains([',', '"']) { format!("{:?}", token.note) } else { token.note.clone() };
    format!("{},{},{},{created},{note},{expires},{producers}", token.id, roles.join(" "), maps.join(" "))
}

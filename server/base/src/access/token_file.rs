//! The file of tokens: their hashes, roles, maps and producers, as TOML.
//!
//! Invariant: the file holds hashes only, and is replaced in one step. Only its owner may read it; if it belongs to
//! root, its group may read it too, as files of secrets in containers require. Messages name the entry that is wrong,
//! never its content.

use std::{
    fmt::Write as _,
    fs::{self, File, OpenOptions},
    io::{self, Read as _, Write as _},
    os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _, fchown},
    path::{Path, PathBuf},
};

use figment::{
    Figment,
    providers::{Format as _, Toml},
};
use ring::rand::{SecureRandom as _, SystemRandom};
use serde::Deserialize;

use super::{MapPattern, ProducerPattern, Role};
use crate::secret_file::is_private;

/// The beginning of every token, by which secrets are found in logs and repositories.
pub(super) const PREFIX: &str = "tm_";
const ID_BYTES: usize = 6;
const SECRET_BYTES: usize = 32;
const HEADER: &str = "# Tokens of tidemapd: hashes, roles, maps and producers. Written by `tidemapd token`; it is read again when it changes.\n";
/// Maximum size of a note, in bytes.
pub(super) const NOTE_BYTES_MAX: usize = 128;
/// Maximum number of tokens.
const TOKENS_MAX: usize = 10_000;

/// The SHA-256 of a token.
pub(super) type TokenHash = [u8; 32];

/// A token, without its secret.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// The public part of the token, which logs and lists show.
    pub id: String,
    /// The hash of the whole token.
    pub hash: TokenHash,
    /// The roles of the token.
    pub roles: Vec<Role>,
    /// The maps that the token is for.
    pub maps: Vec<MapPattern>,
    /// The producers that the token may send as.
    pub producers: Vec<ProducerPattern>,
    /// The holder of the token, in the operator's words.
    pub note: String,
    /// The time when the token was made, in seconds since 1970.
    pub created_secs: i64,
    /// The time from which the token is refused, in seconds since 1970; `None`: never.
    pub expires_secs: Option<i64>,
}

impl Token {
    /// Whether the token is refused at a time, in nanoseconds since 1970.
    pub(super) fn has_expired(&self, now_nanos: i64) -> bool {
        self.expires_secs.is_some_and(|expires_secs| expires_secs <= now_nanos.div_euclid(1_000_000_000))
    }
}

/// The reason why the file of tokens cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenFileError {
    #[error("token file {}: {source}", .path.display())]
    Io { path: PathBuf, source: io::Error },
    #[error(
        "token file {} has permissions {mode:o}: others can read or change it. Run chmod 600 {}",
        .path.display(), .path.display()
    )]
    Open { path: PathBuf, mode: u32 },
    #[error("token file {}{entry}: {reason}", .path.display())]
    Invalid { path: PathBuf, entry: String, reason: &'static str },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entries {
    #[serde(default)]
    token: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    id: String,
    sha256: String,
    roles: Vec<String>,
    maps: Vec<String>,
    /// `None` in files of earlier versions: all producers.
    producers: Option<Vec<String>>,
    #[serde(default)]
    note: String,
    #[serde(default)]
    created: i64,
    expires: Option<i64>,
}

/// The SHA-256 of a token.
pub(super) fn hash(token: &[u8]) -> TokenHash {
    let mut hash = [0; 32];
    hash.copy_from_slice(ring::digest::digest(&ring::digest::SHA256, token).as_ref());
    hash
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex(text: &str) -> Option<TokenHash> {
    let mut hash = [0; 32];
    if text.len() != 64 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    for (byte, at) in hash.iter_mut().zip((0..64).step_by(2)) {
        *byte = u8::from_str_radix(text.get(at..at + 2)?, 16).ok()?;
    }
    Some(hash)
}

/// Makes a new token. Returns the entry that is kept, and the text that only its holder gets.
///
/// # Errors
/// The system returns no random numbers.
pub(super) fn generate(
    roles: Vec<Role>,
    maps: Vec<MapPattern>,
    producers: Vec<ProducerPattern>,
    note: String,
    created_secs: i64,
    expires_secs: Option<i64>,
) -> io::Result<(Token, String)> {
    let mut random = [0; ID_BYTES + SECRET_BYTES];
    SystemRandom::new().fill(&mut random).map_err(|_| io::Error::other("the system provides no random numbers"))?;
    let id = hex(&random[..ID_BYTES]);
    let text = format!("{PREFIX}{id}_{}", hex(&random[ID_BYTES..]));
    Ok((Token { hash: hash(text.as_bytes()), id, roles, maps, producers, note, created_secs, expires_secs }, text))
}

impl Entry {
    fn check(self) -> Result<Token, &'static str> {
        let is_id = |byte: u8| byte.is_ascii_digit() || (b'a'..=b'f').contains(&byte);
        if self.id.is_empty() || self.id.len() > 32 || !self.id.bytes().all(is_id) {
            return Err("id must be up to 32 digits of 0-9 and a-f");
        }
        let hash = from_hex(&self.sha256).ok_or("sha256 must be 64 hexadecimal digits, the hash of a token")?;
        let roles = self.roles.iter().map(|name| Role::from_name(name)).collect::<Option<Vec<Role>>>();
        let roles = roles.filter(|roles| !roles.is_empty());
        let roles = roles.ok_or("roles must be some of observer, planner, operator and admin")?;
        let maps = self.maps.iter().map(|text| text.parse::<MapPattern>()).collect::<Result<Vec<_>, _>>();
        let maps = maps.ok().filter(|maps| !maps.is_empty()).ok_or("maps must be names, beginnings (lab-*) or *")?;
        let producers = self.producers.unwrap_or_else(|| vec![ProducerPattern::all().to_string()]);
        let producers = producers.iter().map(|text| text.parse::<ProducerPattern>()).collect::<Result<Vec<_>, _>>();
        let producers = producers.ok().filter(|producers| !producers.is_empty());
        let producers = producers.ok_or("producers must be names, beginnings (robot-*) or *")?;
        if self.note.len() > NOTE_BYTES_MAX || self.note.chars().any(char::is_control) {
            return Err("note must be up to 128 bytes without control characters");
        }
        Ok(Token {
            id: self.id,
            hash,
            roles,
            maps,
            producers,
            note: self.note,
            created_secs: self.created,
            expires_secs: self.expires,
        })
    }
}

/// Reads the tokens of a file.
///
/// # Errors
/// See [`TokenFileError`].
pub(super) fn read(path: &Path) -> Result<Vec<Token>, TokenFileError> {
    let io = |source| TokenFileError::Io { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(io)?;
    let metadata = file.metadata().map_err(io)?;
    let mode = metadata.permissions().mode() & 0o777;
    if !is_private(mode, metadata.uid()) {
        return Err(TokenFileError::Open { path: path.to_owned(), mode });
    }
    let invalid = |entry: String, reason| TokenFileError::Invalid { path: path.to_owned(), entry, reason };
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(io)?;
    // The parser's own message could quote the content of the file.
    let entries: Entries = Figment::from(Toml::string(&text)).extract().map_err(|error| {
        let at = if error.path.is_empty() { String::new() } else { format!(", {}", error.path.join(".")) };
        invalid(at, "not a list of [[token]] with id, sha256, roles and maps")
    })?;
    if entries.token.len() > TOKENS_MAX {
        return Err(invalid(String::new(), "more than 10,000 tokens"));
    }
    let mut tokens: Vec<Token> = Vec::with_capacity(entries.token.len());
    for (index, entry) in entries.token.into_iter().enumerate() {
        let at = format!(", token {}", index + 1);
        let token = entry.check().map_err(|reason| invalid(at.clone(), reason))?;
        if tokens.iter().any(|other| other.id == token.id) {
            return Err(invalid(at, "an earlier token has the same id"));
        }
        tokens.push(token);
    }
    Ok(tokens)
}

fn render(tokens: &[Token]) -> String {
    let mut text = HEADER.to_owned();
    let list = |words: Vec<String>| words.iter().map(|word| format!("{word:?}")).collect::<Vec<_>>().join(", ");
    for token in tokens {
        let roles = list(token.roles.iter().map(|role| role.name().to_owned()).collect());
        let maps = list(token.maps.iter().map(ToString::to_string).collect());
        let producers = list(token.producers.iter().map(ToString::to_string).collect());
        let note = token.note.replace('\\', "\\\\").replace('"', "\\\"");
        // Writing to a text cannot fail.
        let _ = write!(
            text,
            "\n[[token]]\nid = \"{}\"\nsha256 = \"{}\"\nroles = [{roles}]\nmaps = [{maps}]\nproducers = [{producers}]\nnote = \"{note}\"\ncreated = {}\n",
            token.id,
            hex(&token.hash),
            token.created_secs,
        );
        if let Some(expires_secs) = token.expires_secs {
            let _ = writeln!(text, "expires = {expires_secs}");
        }
    }
    text
}

/// Changes the tokens of a file, which is made if it does not exist. Two changes at once wait for each other.
///
/// # Errors
/// See [`TokenFileError`]; the file is then as it was.
pub(super) fn change<T>(
    path: &Path,
    change: impl FnOnce(&mut Vec<Token>) -> Result<T, TokenFileError>,
) -> Result<T, TokenFileError> {
    let io = |source| TokenFileError::Io { path: path.to_owned(), source };
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder_file = File::open(folder).map_err(io)?;
    folder_file.lock().map_err(io)?;
    let before = match fs::metadata(path) {
        Ok(metadata) => Some(metadata),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(io(error)),
    };
    let mut tokens = if before.is_some() { read(path)? } else { Vec::new() };
    let outcome = change(&mut tokens)?;
    let new = path.with_extension("new");
    // An interrupted change may have left a file.
    let _ = fs::remove_file(&new);
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&new).map_err(io)?;
    // Root makes tokens for the user under which the daemon runs: the owner of the file, or of its folder.
    let folder_metadata = folder_file.metadata().map_err(io)?;
    let owner = before.unwrap_or(folder_metadata);
    let own = file.metadata().map_err(io)?;
    if (own.uid(), own.gid()) != (owner.uid(), owner.gid()) && own.uid() == 0 {
        fchown(&file, Some(owner.uid()), Some(owner.gid())).map_err(io)?;
    }
    file.write_all(render(&tokens).as_bytes()).map_err(io)?;
    file.sync_all().map_err(io)?;
    fs::rename(&new, path).map_err(io)?;
    folder_file.sync_all().map_err(io)?;
    Ok(outcome)
}

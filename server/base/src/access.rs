//! Permissions of callers: tokens with roles and maps, and one table of the role that each RPC needs.
//!
//! Invariant: everything that is not allowed is refused. A method without a row in [`table`] is refused to everybody,
//! and work that does not know its caller may see no map. Tokens are kept as hashes, and no message, log or `Debug`
//! shows one.

pub mod keyring;
pub mod peer_secret;
pub mod places;
pub mod table;
pub mod token_command;
pub(crate) mod token_file;

use std::{fmt, future::Future, str::FromStr, sync::Arc};

use tidemap_map::name::ProducerKey;

use self::token_file::Token;

/// The permissions of a token. An operator may do what observers and planners may, and an admin everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Role {
    /// Sends observations, traversals and visits.
    Observer,
    /// Requests predictions, plans and routes.
    Planner,
    /// Runs updates, and edits topologies, locations and chargers.
    Operator,
    /// Creates and deletes maps.
    Admin,
}

impl Role {
    /// The name of the role on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Observer => "observer",
            Self::Planner => "planner",
            Self::Operator => "operator",
            Self::Admin => "admin",
        }
    }

    /// The role of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        [Self::Observer, Self::Planner, Self::Operator, Self::Admin].into_iter().find(|role| role.name() == name)
    }

    /// Whether this role allows what `other` allows.
    fn includes(self, other: Self) -> bool {
        self == other || self == Self::Admin || (self == Self::Operator && other != Self::Admin)
    }
}

/// Which maps a token is for: all (`*`), those whose names begin alike (`lab-*`), or one (`office`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapPattern(String);

/// The reason why a text is no pattern of maps.
#[derive(Debug, thiserror::Error)]
#[error("not a pattern of maps: use a name, the beginning of names and * (lab-*), or * for all maps")]
pub struct InvalidPattern;

impl FromStr for MapPattern {
    type Err = InvalidPattern;

    fn from_str(text: &str) -> Result<Self, InvalidPattern> {
        let name = text.strip_suffix('*').unwrap_or(text);
        let is_name = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_' || byte == b'-';
        let is_valid = !text.is_empty() && name.len() <= 63 && name.bytes().all(is_name);
        if is_valid { Ok(Self(text.to_owned())) } else { Err(InvalidPattern) }
    }
}

impl fmt::Display for MapPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl MapPattern {
    /// All maps.
    fn all() -> Self {
        Self("*".to_owned())
    }

    fn matches(&self, map: &str) -> bool {
        match self.0.strip_suffix('*') {
            Some(beginning) => map.starts_with(beginning),
            None => map == self.0,
        }
    }
}

/// Which producers a token may send as: all (`*`), those whose names begin alike (`robot-*`), or one (`robot-7`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProducerPattern(String);

/// The reason why a text is no pattern of producers.
#[derive(Debug, thiserror::Error)]
#[error("not a pattern of producers: use a name, the beginning of names and * (robot-*), or * for all producers")]
pub struct InvalidProducerPattern;

impl FromStr for ProducerPattern {
    type Err = InvalidProducerPattern;

    fn from_str(text: &str) -> Result<Self, InvalidProducerPattern> {
        let name = text.strip_suffix('*').unwrap_or(text);
        let is_valid = text == "*" || (!name.contains('*') && ProducerKey::new(name, "").is_ok());
        if is_valid { Ok(Self(text.to_owned())) } else { Err(InvalidProducerPattern) }
    }
}

impl fmt::Display for ProducerPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl ProducerPattern {
    /// All producers.
    fn all() -> Self {
        Self("*".to_owned())
    }

    fn matches(&self, producer: &str) -> bool {
        match self.0.strip_suffix('*') {
            Some(beginning) => producer.starts_with(beginning),
            None => producer == self.0,
        }
    }
}

/// The caller of a request.
#[derive(Clone, Debug)]
pub enum Caller {
    /// Somebody, where no tokens are configured: everything is allowed.
    Anybody,
    /// Somebody on a port for reading, where no tokens are configured: nothing that changes anything is allowed.
    Reader,
    /// Somebody without a token, where tokens are configured: nothing is allowed beyond what is open.
    Stranger,
    /// Another daemon of the cluster: only what is for daemons is allowed.
    Peer,
    /// The holder of a token.
    Holder(Arc<Token>),
}

tokio::task_local! {
    /// The caller of the request that the task works on.
    static CALLER: Caller;
}

impl Caller {
    /// The caller of the request that this task works on. A task that was spawned by the work on a request has no
    /// caller, unless it was started with [`Caller::scope`].
    pub fn current() -> Self {
        Self::known().unwrap_or(Self::Stranger)
    }

    /// The caller in the form of [`Caller::current`]; `None`: the task has no caller.
    pub fn known() -> Option<Self> {
        CALLER.try_with(Clone::clone).ok()
    }

    /// Does work for this caller.
    pub fn scope<F: Future>(self, work: F) -> impl Future<Output = F::Output> {
        CALLER.scope(self, work)
    }

    /// The caller, for the log.
    pub fn shown(&self) -> &str {
        match self {
            Self::Anybody | Self::Reader => "anybody",
            Self::Stranger => "stranger",
            Self::Peer => "another daemon",
            Self::Holder(token) => &token.id,
        }
    }

    /// The public part of the caller's token, if there is one.
    pub fn token_id(&self) -> Option<&str> {
        match self {
            Self::Holder(token) => Some(&token.id),
            Self::Anybody | Self::Reader | Self::Stranger | Self::Peer => None,
        }
    }

    /// Whether the caller may do what a role may.
    pub fn has(&self, role: Role) -> bool {
        match self {
            Self::Anybody => true,
            Self::Reader => role == Role::Planner,
            Self::Stranger | Self::Peer => false,
            Self::Holder(token) => token.roles.iter().any(|held| held.includes(role)),
        }
    }

    /// Whether the caller may use the map of this name, if there is one.
    pub fn covers(&self, map: &str) -> bool {
        match self {
            Self::Anybody | Self::Reader => true,
            Self::Stranger | Self::Peer => false,
            Self::Holder(token) => token.maps.iter().any(|pattern| pattern.matches(map)),
        }
    }

    /// Whether the caller may send observations as this producer.
    pub fn may_send_as(&self, producer: &str) -> bool {
        match self {
            Self::Anybody => true,
            Self::Reader | Self::Stranger | Self::Peer => false,
            Self::Holder(token) => token.producers.iter().any(|pattern| pattern.matches(producer)),
        }
    }

    /// Whether the caller may use all maps.
    pub fn covers_all(&self) -> bool {
        match self {
            Self::Anybody | Self::Reader => true,
            Self::Stranger | Self::Peer => false,
            Self::Holder(token) => token.maps.iter().any(|pattern| pattern.0 == "*"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roles_include_each_other_as_documented() {
        use Role::{Admin, Observer, Operator, Planner};
        let all = [Observer, Planner, Operator, Admin];
        for (role, included) in [
            (Observer, vec![Observer]),
            (Planner, vec![Planner]),
            (Operator, vec![Observer, Planner, Operator]),
            (Admin, all.to_vec()),
        ] {
            let found: Vec<Role> = all.into_iter().filter(|other| role.includes(*other)).collect();
            assert_eq!(found, included, "{role:?}");
            assert_eq!(Role::from_name(role.name()), Some(role));
        }
    }

    #[test]
    fn patterns_are_names_or_beginnings() {
        for (pattern, map, matches) in [
            ("*", "office", true),
            ("office", "office", true),
            ("office", "office-2", false),
            ("lab-*", "lab-1", true),
            ("lab-*", "lab", false),
            ("lab-*", "office", false),
        ] {
            assert_eq!(pattern.parse::<MapPattern>().expect("a pattern").matches(map), matches, "{pattern} {map}");
        }
        for (pattern, producer, matches) in [
            ("*", "robot-7", true),
            ("robot-7", "robot-7", true),
            ("robot-7", "robot-71", false),
            ("robot-*", "robot-7", true),
            ("robot-*", "camera", false),
        ] {
            let pattern = pattern.parse::<ProducerPattern>().expect("a pattern");
            assert_eq!(pattern.matches(producer), matches, "{pattern} {producer}");
        }
        for text in ["", "**", "*a", "r*t", "a\nb"] {
            assert!(text.parse::<ProducerPattern>().is_err(), "{text:?}");
        }
        for text in ["", "**", "*a", "Office", "a b", "../x", "o*e", "ä"] {
            assert!(text.parse::<MapPattern>().is_err(), "{text:?}");
        }
    }
}

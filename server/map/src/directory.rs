//! The directory of the states of a map: names to indices and back.
//!
//! Invariant: an index is assigned once, and its state keeps it after a rename. A clone of the directory is cheap: it
//! is a handful of pointers, and adding a name copies only the shard and the chunk in which it is stored, when a view
//! still holds them.

use std::{
    collections::HashMap,
    hash::{BuildHasher, RandomState},
    sync::Arc,
};

use crate::{
    event::{Dimensions, Reporting, StateKind, StateSensor, StateShape},
    ids::StateId,
    name::{StateName, referred_name},
};

const SHARDS: usize = 256;
const CHUNK: usize = 256;

type Shard = HashMap<StateName, StateId>;

/// The fixed properties of a state, and its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateInfo {
    /// The name of the state, unique within the map.
    pub name: StateName,
    /// The kind of values that the state has; never changes.
    pub kind: StateKind,
    /// The sensor that reads the state, where it is known; never changes.
    pub sensor: Option<StateSensor>,
    /// How the rows of the state are reported; never changes.
    pub reporting: Reporting,
}

/// The states of a map by name and by index.
#[derive(Clone, Debug)]
pub(crate) struct Directory {
    hasher: RandomState,
    shards: Arc<Vec<Arc<Shard>>>,
    chunks: Arc<Vec<Arc<Vec<StateInfo>>>>,
    /// For each categorical state, the first label and the number of labels.
    categorical: Arc<HashMap<StateName, (StateId, u8)>>,
    len: usize,
}

impl Directory {
    pub(crate) fn new() -> Self {
        Self {
            hasher: RandomState::new(),
            shards: Arc::new((0..SHARDS).map(|_| Arc::default()).collect()),
            chunks: Arc::new(Vec::new()),
            categorical: Arc::default(),
            len: 0,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.len
    }

    fn shard(&self, name: &str) -> usize {
        usize::try_from(self.hasher.hash_one(name) % SHARDS as u64).unwrap_or(0)
    }

    pub(crate) fn find(&self, name: &str) -> Option<StateId> {
        let name = referred_name(name);
        self.shards[self.shard(name)].get(name).copied()
    }

    /// The shape of the observations of a name, with the id of its state, or of its first axis or label.
    pub(crate) fn shape(&self, name: &str) -> Option<(StateId, StateShape)> {
        if let Some(id) = self.find(name) {
            return Some((id, StateShape::Scalar(self.info(id)?.kind)));
        }
        // A vector has a plain name: `edge/A/B/x` is an edge with the action x. An angle has a plain name too.
        if name.contains('/') {
            return None;
        }
        if let Some(&(first, labels)) = self.categorical.get(name) {
            return Some((first, StateShape::Categorical(labels)));
        }
        if let Some(cos) = self.find(&format!("{name}/cos")) {
            return Some((cos, StateShape::Angle));
        }
        let first = self.find(&format!("{name}/x"))?;
        let beyond = self.info(StateId(first.0.saturating_add(2)));
        let has_z = beyond.and_then(|info| info.name.as_axis()) == Some((name, 2));
        Some((first, StateShape::Vector(if has_z { Dimensions::Three } else { Dimensions::Two })))
    }

    /// The names of the categorical states.
    pub(crate) fn categorical_states(&self) -> impl Iterator<Item = &StateName> {
        self.categorical.keys()
    }

    /// The states that are labels of one state, or cosine and sine of one angle: the first state of each, and how many
    /// there are.
    pub(crate) fn parts(&self) -> Vec<(StateId, usize)> {
        let whole = |info: &StateInfo| {
            let label = info.name.as_label().map(|(state, _)| state.to_owned());
            label.or_else(|| info.name.as_angle_axis().map(|(angle, _)| angle.to_owned()))
        };
        let mut found: Vec<(StateId, usize, String)> = Vec::new();
        for (id, info) in (0..).map(StateId).zip(self.iter()) {
            match (whole(info), found.last_mut()) {
                (Some(whole), Some((first, count, last)))
                    if first.0 as usize + *count == id.0 as usize && whole == *last =>
                {
                    *count += 1;
                }
                (Some(whole), _) => found.push((id, 1, whole)),
                (None, _) => {}
            }
        }
        found.into_iter().map(|(first, count, _)| (first, count)).collect()
    }

    pub(crate) fn info(&self, id: StateId) -> Option<&StateInfo> {
        let index = id.0 as usize;
        self.chunks.get(index / CHUNK)?.get(index % CHUNK)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &StateInfo> {
        self.chunks.iter().flat_map(|chunk| chunk.iter())
    }

    /// Renames a state. Changes nothing if the state does not exist or the name is taken.
    pub(crate) fn rename(&mut self, id: StateId, name: StateName) {
        let index = id.0 as usize;
        if self.info(id).is_none() || self.shape(name.as_str()).is_some() {
            return;
        }
        let info = &mut Arc::make_mut(&mut Arc::make_mut(&mut self.chunks)[index / CHUNK])[index % CHUNK];
        let old = std::mem::replace(&mut info.name, name.clone());
        let (from, to) = (self.shard(old.as_str()), self.shard(name.as_str()));
        let shards = Arc::make_mut(&mut self.shards);
        Arc::make_mut(&mut shards[from]).remove(&old);
        Arc::make_mut(&mut shards[to]).insert(name, id);
    }

    /// Appends a state; its index is the number of states before.
    pub(crate) fn push(&mut self, info: StateInfo) -> StateId {
        let id = StateId(u32::try_from(self.len).unwrap_or(u32::MAX));
        let shard = self.shard(info.name.as_str());
        if let Some((state, _)) = info.name.as_label()
            && let Ok(state) = StateName::new(state)
        {
            // The labels of a state follow one another.
            let (_, labels) = Arc::make_mut(&mut self.categorical).entry(state).or_insert((id, 0));
            *labels = labels.saturating_add(1);
        }
        Arc::make_mut(&mut Arc::make_mut(&mut self.shards)[shard]).insert(info.name.clone(), id);
        let chunks = Arc::make_mut(&mut self.chunks);
        match chunks.last_mut() {
            Some(chunk) if chunk.len() < CHUNK => Arc::make_mut(chunk).push(info),
            _ => chunks.push(Arc::new(vec![info])),
        }
        self.len += 1;
        id
    }
}

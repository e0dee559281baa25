//! The events of a map. The observation log stores events, and applying them is the only way in which a map changes.
//!
//! A position is a vector of two or three coordinates. The map keeps the axes of a position: continuous states
//! `NAME/x`, `NAME/y` and `NAME/z` with consecutive ids ([`NewState::states`]), so that log, checkpoints, history,
//! updates and models contain no vectors. A plain name has no `/`, so no producer can send to a single axis. A position
//! is accepted or refused as a whole, and its axes are observed in one event. In the same way, an angle is the states
//! `NAME/cos` and `NAME/sin`; a categorical state is a probability for each label, `NAME/LABEL`, all observed in one
//! event.
//!
//! Invariant: an event holds everything that its effect depends on, such as the UTC offsets used and the time of
//! receipt, so that a replay gives the same map even after the time zone database or the clock has changed.

use std::{collections::HashSet, fmt};

use tidemap_model::{ANGLE_AXES, ANGLE_EXPECTED, LABELS, Sample, allows_angle, time::FUTURE_MAX_NANOS};
pub use tidemap_model::{Dimensions, Hold, Position, Reporting, RowKind, StateKind, StateSensor, StatedReporting};

use tidemap_grid::scan::Scans;

use crate::{
    ids::{NewProducer, ProducerId, RefusalReason, StateId},
    name::StateName,
    site::SiteEdit,
    task::TaskRun,
    traversal::EdgeFailure,
};

/// Consecutive observations that share a UTC offset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OffsetRun {
    /// Number of observations.
    pub count: u32,
    /// Seconds to add to UTC for local civil time.
    pub offset_secs: i32,
}

/// The data of every event of a producer besides its content: its producer, the part of the producer's sequence that it
/// covers, and the refused observations or scans of that part.
#[derive(Clone, Debug, PartialEq)]
pub struct Envelope {
    /// The producer.
    pub producer: ProducerId,
    /// The producer's key and sensor, in its first event only.
    pub new_producer: Option<NewProducer>,
    /// The producer's incarnation.
    pub incarnation: u64,
    /// The part of the producer's sequence that the event covers, refused observations or scans included; not empty.
    pub span: SequenceSpan,
    /// The time at which the event was received, nanoseconds UTC of the server's clock.
    pub received_nanos: i64,
    /// Refused observations or scans: sequence number and reason, ascending.
    pub refused: Vec<(u64, RefusalReason)>,
}

impl Envelope {
    /// The latest plausible time by the clock of receipt, nanoseconds UTC; later observations wait.
    pub fn plausible_nanos(&self) -> i64 {
        self.received_nanos.saturating_add(FUTURE_MAX_NANOS)
    }
}

/// A part of a producer's sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceSpan {
    /// Sequence number of the first observation or scan.
    pub first: u64,
    /// Sequence number of the last one; less than `first` in an empty part.
    pub last: u64,
    /// Running CRC-32C over all that the producer has sent, from 1 up to `last`.
    pub content_crc: u32,
}

impl SequenceSpan {
    /// Whether the span has no sequence number.
    pub fn is_empty(self) -> bool {
        self.last < self.first
    }
}

/// Observations that became durable together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observations {
    /// States that appear for the first time; the ids continue those of the map.
    pub new_states: Vec<NewState>,
    /// The state of each accepted observation. A position is an observation of each of its axes, one after the other,
    /// with one sequence number; a traversal is one of the one or two states of its edge in the same way.
    pub states: Vec<StateId>,
    /// The time of each accepted observation, in nanoseconds UTC, at least 0.
    pub times_nanos: Vec<i64>,
    /// The value of each accepted observation, which the state's kind allows. NaN for a state that does not report
    /// samples means that its sensor knows no value from then on.
    pub values: Vec<f64>,
    /// UTC offsets of the accepted observations; the counts add up to their number.
    pub offsets: Vec<OffsetRun>,
    /// Traversals that failed, each with an observation of its edge's state among the observations above.
    pub failures: Vec<EdgeFailure>,
    /// Reports of tasks, each with an observation of its state among the observations above.
    pub runs: Vec<TaskRun>,
}

impl Observations {
    /// Appends an accepted observation.
    pub fn push(&mut self, state: StateId, sample: Sample) {
        let Sample { utc_nanos, offset_secs, value } = sample;
        match self.offsets.last_mut() {
            Some(run) if run.offset_secs == offset_secs => run.count += 1,
            _ => self.offsets.push(OffsetRun { count: 1, offset_secs }),
        }
        self.states.push(state);
        self.times_nanos.push(utc_nanos);
        self.values.push(value);
    }

    /// The accepted observations with their states.
    pub fn samples(&self) -> impl Iterator<Item = (StateId, Sample)> {
        let offsets = self.offsets.iter().flat_map(|run| std::iter::repeat_n(run.offset_secs, run.count as usize));
        self.states
            .iter()
            .zip(&self.times_nanos)
            .zip(&self.values)
            .zip(offsets)
            .map(|(((&state, &utc_nanos), &value), offset_secs)| (state, Sample { utc_nanos, offset_secs, value }))
    }
}

/// A state, or a vector of states, that appears for the first time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NewState {
    /// The id of the state; for a vector, an angle or a categorical state, the id of the first axis or label, followed
    /// by the others.
    pub id: StateId,
    /// The name, which no other state of the map has.
    pub name: StateName,
    /// The shape of its observations.
    pub shape: StateShape,
    /// The names of the states of its labels, as [`StateName::label`] returns them; only for a categorical state.
    pub labels: Vec<StateName>,
    /// The sensor that reads the state, where it is known; only for a shape that may have one.
    pub sensor: Option<StateSensor>,
    /// How the rows of the state are reported; only a form that its shape allows.
    pub reporting: Reporting,
}

impl NewState {
    /// A state that reports samples of an unknown sensor.
    pub fn sampled(id: StateId, name: StateName, shape: impl Into<StateShape>) -> NewState {
        NewState { id, name, shape: shape.into(), labels: Vec::new(), sensor: None, reporting: Reporting::Samples }
    }

    /// A categorical state; `None` for too few labels, too many, or labels that do not belong to the name.
    #[must_use]
    pub fn categorical(id: StateId, name: StateName, labels: Vec<StateName>) -> Option<NewState> {
        let shape = StateShape::Categorical(u8::try_from(labels.len()).ok()?);
        let is_own = |label: &StateName| label.as_label().is_some_and(|(state, _)| state == name.as_str());
        let is_sound = LABELS.contains(&labels.len())
            && labels.iter().all(is_own)
            && labels.iter().collect::<HashSet<_>>().len() == labels.len();
        is_sound.then(|| NewState { labels, ..NewState::sampled(id, name, shape) })
    }

    /// The states that this adds to a map: the state itself, one continuous state per axis, or a probability per label.
    pub fn states(&self) -> impl Iterator<Item = (StateId, StateName, StateKind)> + use<'_> {
        let (count, kind) = (self.shape.states(), self.shape.kind());
        (0..count).map(move |axis| {
            let id = StateId(self.id.0.saturating_add(u32::try_from(axis).unwrap_or(u32::MAX)));
            let name = match self.shape {
                StateShape::Scalar(_) => self.name.clone(),
                StateShape::Vector(_) => self.name.axis(axis),
                StateShape::Angle => self.name.angle_axis(axis),
                StateShape::Categorical(_) => self.labels.get(axis).unwrap_or(&self.name).clone(),
            };
            (id, name, kind)
        })
    }
}

/// The shape of the observations of a name: values of a kind, positions, angles, or labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StateShape {
    /// Each observation is a value.
    Scalar(StateKind),
    /// Each observation is a position. The map keeps each axis as a state of continuous values ([`StateName::axis`]).
    Vector(Dimensions),
    /// Each observation is an angle in radians. The map keeps cosine and sine as states of continuous values
    /// ([`StateName::angle_axis`]).
    Angle,
    /// Each observation is one of this many labels, or a share of each. The map keeps each label as a probability
    /// ([`StateName::label`]).
    Categorical(u8),
}

impl StateShape {
    /// The name of the shape as people write it.
    pub fn name(self) -> &'static str {
        match self {
            StateShape::Scalar(kind) => kind.name(),
            StateShape::Vector(Dimensions::Two) => "vector of 2 coordinates",
            StateShape::Vector(Dimensions::Three) => "vector of 3 coordinates",
            StateShape::Angle => "angle",
            StateShape::Categorical(_) => "categorical",
        }
    }

    /// The name of the shape as people write it, with its article.
    #[must_use]
    pub fn with_article(self) -> String {
        match self {
            StateShape::Angle => "an angle".to_owned(),
            StateShape::Categorical(_) => "a categorical state".to_owned(),
            StateShape::Scalar(_) | StateShape::Vector(_) => format!("a {}", self.name()),
        }
    }

    /// The coordinates of a vector; `None` for others.
    pub fn dimensions(self) -> Option<Dimensions> {
        match self {
            StateShape::Scalar(_) | StateShape::Angle | StateShape::Categorical(_) => None,
            StateShape::Vector(dimensions) => Some(dimensions),
        }
    }

    /// Number of states of the map.
    pub fn states(self) -> usize {
        match self {
            StateShape::Scalar(_) => 1,
            StateShape::Vector(dimensions) => dimensions.count(),
            StateShape::Angle => 2,
            StateShape::Categorical(labels) => usize::from(labels),
        }
    }

    /// Kind of these states.
    pub fn kind(self) -> StateKind {
        match self {
            StateShape::Scalar(kind) => kind,
            StateShape::Vector(_) | StateShape::Angle => StateKind::Continuous,
            StateShape::Categorical(_) => StateKind::Probability,
        }
    }

    /// Whether an observation is one number, not a position or a label.
    #[must_use]
    pub fn is_single(self) -> bool {
        !matches!(self, StateShape::Vector(_) | StateShape::Categorical(_))
    }

    /// Whether a user may state a sensor for its readings: they are 0 and 1.
    #[must_use]
    pub fn may_have_sensor(self) -> bool {
        self == StateShape::Scalar(StateKind::Probability)
    }

    /// Whether its rows may be reported in this form: positions, angles and labels are sampled, and only counts have
    /// events.
    #[must_use]
    pub fn may_report(self, reporting: Reporting) -> bool {
        match reporting {
            Reporting::Samples => true,
            Reporting::Changes(_) => matches!(self, StateShape::Scalar(_)),
            Reporting::Events(_) => self == StateShape::Scalar(StateKind::Count),
        }
    }

    /// Whether an observation that is one number may have this value.
    #[must_use]
    pub fn allows(self, value: f64) -> bool {
        match self {
            StateShape::Scalar(kind) => kind.allows(value),
            StateShape::Vector(_) | StateShape::Categorical(_) => false,
            StateShape::Angle => allows_angle(value),
        }
    }

    /// The values that [`StateShape::allows`], in words, for a message that ends "… is not".
    #[must_use]
    pub fn expected(self) -> &'static str {
        match self {
            StateShape::Angle => ANGLE_EXPECTED,
            StateShape::Categorical(_) => "a label or a share of each label, in [0, 1] and with the sum 1",
            StateShape::Scalar(_) | StateShape::Vector(_) => self.kind().expected(),
        }
    }

    /// Names of the axes that make up a name with this shape, in order of their ids. None for a single state, and none
    /// for a categorical one, which has labels of its own.
    #[must_use]
    pub fn axes(self) -> &'static [&'static str] {
        match self {
            StateShape::Scalar(_) | StateShape::Categorical(_) => &[],
            StateShape::Vector(dimensions) => dimensions.axes(),
            StateShape::Angle => &ANGLE_AXES,
        }
    }
}

impl From<StateKind> for StateShape {
    fn from(kind: StateKind) -> Self {
        Self::Scalar(kind)
    }
}

impl Default for StateShape {
    /// The default: a probability.
    fn default() -> Self {
        StateKind::default().into()
    }
}

/// The cause of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum UpdateCause {
    /// A request.
    Request,
    /// The map's local midnight, by the server's clock.
    Midnight,
    /// The map's local midnight, in the time of imported data.
    DataTime,
    /// More observations were pending than the limit allows.
    PendingLimit,
}

/// The start of an update. Its log position determines which observations the update takes: those at earlier positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpdateStart {
    /// Number of the generation that the update publishes; 1 for the first.
    pub generation: u64,
    /// Observations before this instant are learned; later ones stay pending. Never decreases.
    pub cut_nanos: i64,
    /// The cause of the update.
    pub cause: UpdateCause,
}

/// A digest of a generation's data: two maps that have applied one log up to the start of an update have equal digests
/// if their bits are equal. The upper half is the digest of all but the grid, the lower half that of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Digest(pub u64);

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// A daemon becomes the writer of a log that daemons share. Everything after this event in the log is from this writer,
/// up to the next epoch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Epoch {
    /// Counts the writers of the log, from 1.
    pub epoch: u64,
    /// Name of the daemon.
    pub writer: String,
    /// Version of the daemon.
    pub version: String,
    /// Number of the maths of the writer's updates: updates with one number make equal bits.
    pub maths: u32,
}

/// The writer of a shared log has ended an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UpdateDone {
    /// The generation that the update published.
    pub generation: u64,
    /// Checksum of the result of the update.
    pub digest: Digest,
    /// Number of the maths of the update.
    pub maths: u32,
}

/// One entry of a map's log.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Observations became durable.
    Observations(Envelope, Observations),
    /// Scans became durable.
    Scans(Envelope, Scans),
    /// An update starts.
    UpdateStart(UpdateStart),
    /// A state or vector was added before its first observation.
    AddState(NewState),
    /// The site was changed.
    EditSite(SiteEdit),
    /// Another daemon writes the log from here on; changes nothing else.
    Epoch(Epoch),
    /// The writer has ended an update; changes nothing else, because every replica runs the update itself.
    UpdateDone(UpdateDone),
    /// Producers that will not come back give their places up. The numbers of their observations stay.
    ForgetProducers(Vec<ProducerId>),
}

impl Event {
    /// The envelope, where the event is of a producer.
    pub fn envelope(&self) -> Option<&Envelope> {
        match self {
            Event::Observations(envelope, _) | Event::Scans(envelope, _) => Some(envelope),
            Event::UpdateStart(_)
            | Event::AddState(_)
            | Event::EditSite(_)
            | Event::Epoch(_)
            | Event::UpdateDone(_)
            | Event::ForgetProducers(_) => None,
        }
    }
}

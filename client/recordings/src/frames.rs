//! Frames of a robot and the transforms between them: the tree of tf.
//!
//! Invariant: a static transform holds for all time; another one only between its first and its last sample. Between
//! two samples it is interpolated: the translation along a line, the rotation along the shorter arc. It is unknown
//! between two that differ and are far apart in time, or too far in space for their time. The number of samples is
//! bounded.

mod doubt;

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Maximum number of samples of all transforms, 64 bytes each.
pub const SAMPLES_MAX: usize = 600_000;
/// Between two samples that differ, a transform is unknown if they are further apart than this, nanoseconds, unless
/// [`Frames::set_gap`] states another time.
pub const GAP_NANOS: i64 = 2_000_000_000;
/// Two poses are alike up to this distance, metres, and angle, radians.
const ALIKE_M: f64 = 1e-3;
const ALIKE_RAD: f64 = 1e-3;
/// Maximum number of frames.
const FRAMES_MAX: usize = 10_000;
/// Maximum number of parents of a frame, and of frames that are named as conflicts.
const PARENTS_MAX: usize = 4;
const CONFLICTS_MAX: usize = 10;
/// Maximum number of bytes of a frame's name.
pub const FRAME_BYTES_MAX: usize = 256;
/// Maximum number of links from a frame to the root.
const DEPTH_MAX: usize = 256;

/// A transform of a recording: the pose of a frame within its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct Transform {
    /// The parent.
    pub parent: String,
    /// The frame.
    pub child: String,
    /// The time for which it holds, nanoseconds since 1970.
    pub time_nanos: i64,
    /// The pose of the frame within its parent.
    pub pose: Isometry3<f64>,
}

/// Why there is no pose of a frame within another one at a time.
#[derive(Clone, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum FrameError {
    /// The recording has no transform of the frame.
    #[error("frame {0:?} is not known")]
    Unknown(String),
    /// No links connect the frames.
    #[error("no transforms connect {frame:?} with {within:?}")]
    NotConnected {
        /// The frame.
        frame: String,
        /// The frame in which the pose was requested.
        within: String,
    },
    /// The time lies before the first sample of a link.
    #[error("the time is before the first transform from {parent:?} to {child:?}")]
    Before {
        /// Parent of the link.
        parent: String,
        /// Child of the link.
        child: String,
    },
    /// The samples before and after the time are far apart, and differ.
    #[error(
        "the transforms from {parent:?} to {child:?} before and after it are more than {} s apart and differ; \
         --transform-gap allows more", *.gap_nanos as f64 / 1e9
    )]
    Gap {
        /// Parent of the link.
        parent: String,
        /// Child of the link.
        child: String,
        /// The longest time between samples, nanoseconds.
        gap_nanos: i64,
    },
    /// The samples before and after the time are further apart than anything drives.
    #[error("the transforms from {parent:?} to {child:?} jump from one place to another there")]
    Jump {
        /// Parent of the link.
        parent: String,
        /// Child of the link.
        child: String,
    },
    /// The transforms of a frame cannot be those of one robot.
    #[error("{0}")]
    Doubt(String),
    /// The time lies after the last sample of a link.
    #[error("the time is after the last transform from {parent:?} to {child:?}")]
    After {
        /// Parent of the link.
        parent: String,
        /// Child of the link.
        child: String,
    },
}

/// Why a transform is not taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TransformError {
    /// A number is not finite, or the quaternion is zero.
    #[error("the transform from {parent:?} to {child:?} has no valid numbers")]
    Numbers {
        /// The parent.
        parent: String,
        /// The frame.
        child: String,
    },
    /// More samples than are held.
    #[error("more than {SAMPLES_MAX} transforms")]
    TooMany,
}

#[derive(Clone, Copy, Debug)]
struct PoseSample {
    time_nanos: i64,
    pose: Isometry3<f64>,
}

#[derive(Clone, Debug)]
enum Link {
    Static {
        parent: String,
        pose: Isometry3<f64>,
    },
    /// The samples of each parent that was named for the frame; only the first counts once all are known.
    Moving(Vec<Track>),
}

#[derive(Clone, Debug)]
struct Track {
    parent: String,
    samples: Vec<PoseSample>,
    is_sorted: bool,
}

impl Link {
    fn parent(&self) -> &str {
        match self {
            Self::Static { parent, .. } => parent,
            Self::Moving(tracks) => tracks.first().map_or("", |track| &track.parent),
        }
    }
}

/// The tree of frames of a recording.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    links: HashMap<String, Link>,
    samples: usize,
    conflicts: BTreeSet<String>,
    gap_nanos: Option<i64>,
    /// Frames whose transforms hold for all time if they do not change.
    lasting: HashSet<String>,
    /// Frames whose transforms cannot be those of one robot, and why.
    doubts: BTreeMap<String, String>,
}

/// A frame's name without the leading slash of old recordings.
pub fn frame_name(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

/// A pose of seven numbers; the quaternion is made a unit one. `None` if a number is not finite or the quaternion is
/// zero.
pub fn pose([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Option<Isometry3<f64>> {
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-9)?;
    let is_finite = [x, y, z, i, j, k, w].iter().all(|number| number.is_finite());
    is_finite.then(|| Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

impl Frames {
    /// Takes a transform. If a frame has several parents, the parent with more transforms counts; static transforms
    /// count before others. Frames whose transforms disagree are among [`Frames::conflicts`].
    ///
    /// # Errors
    /// There are too many samples, or too many frames.
    pub fn add(&mut self, transform: Transform, is_static: bool) -> Result<(), TransformError> {
        let Transform { parent, child, time_nanos, pose } = transform;
        if !self.links.contains_key(&child) && self.links.len() >= FRAMES_MAX {
            return Err(TransformError::TooMany);
        }
        if is_static {
            match self.links.get(&child) {
                Some(Link::Static { parent: before, pose: old }) if *before == parent && is_near(old, &pose) => {}
                Some(_) => self.conflict(&child),
                None => {}
            }
            self.links.insert(child, Link::Static { parent, pose });
            return Ok(());
        }
        if self.samples >= SAMPLES_MAX {
            return Err(TransformError::TooMany);
        }
        let sample = PoseSample { time_nanos, pose };
        let is_conflict = match self.links.entry(child.clone()).or_insert_with(|| Link::Moving(Vec::new())) {
            // A transform that was declared to hold for all time is not replaced because of one message.
            Link::Static { parent: before, pose: old } => *before != parent || !is_near(old, &pose),
            Link::Moving(tracks) => {
                self.samples += 1;
                let count = tracks.len();
                match tracks.iter_mut().find(|track| track.parent == parent) {
                    Some(track) => {
                        track.is_sorted &= track.samples.last().is_none_or(|last| last.time_nanos < time_nanos);
                        track.samples.push(sample);
                    }
                    None if count < PARENTS_MAX => {
                        tracks.push(Track { parent, samples: vec![sample], is_sorted: true });
                    }
                    None => {}
                }
                count > 0 && tracks.len() > 1
            }
        };
        if is_conflict {
            self.conflict(&child);
        }
        Ok(())
    }

    /// Makes the transforms of a frame hold for all time if they do not change: Foxglove has no static ones.
    pub fn last(&mut self, child: &str) {
        if !self.lasting.contains(child) && self.lasting.len() < FRAMES_MAX {
            self.lasting.insert(child.to_owned());
        }
    }

    fn conflict(&mut self, child: &str) {
        if self.conflicts.len() < CONFLICTS_MAX && !self.conflicts.contains(child) {
            self.conflicts.insert(child.to_owned());
        }
    }

    /// Why the transforms of some frames cannot be those of one robot: they give no pose.
    pub fn doubts(&self) -> impl Iterator<Item = &str> {
        self.doubts.values().map(String::as_str)
    }

    /// A tree with the static transforms alone.
    pub fn without_moving(&self) -> Self {
        let is_static = |link: &Link| matches!(link, Link::Static { .. });
        let links = self.links.iter().filter(|(_, link)| is_static(link));
        Self {
            links: links.map(|(child, link)| (child.clone(), link.clone())).collect(),
            samples: 0,
            conflicts: self.conflicts.clone(),
            gap_nanos: self.gap_nanos,
            lasting: self.lasting.clone(),
            doubts: BTreeMap::new(),
        }
    }

    /// Frames whose parent or static pose changed, only some if there are many.
    pub fn conflicts(&self) -> impl Iterator<Item = &str> {
        self.conflicts.iter().map(String::as_str)
    }

    /// Chooses parents and sorts what came out of order; call it once after the last transform. If two samples have one
    /// time, the later one counts.
    pub fn finish(&mut self) {
        for (child, link) in &mut self.links {
            let Link::Moving(tracks) = link else { continue };
            if self.lasting.contains(child)
                && let [Track { parent, samples, .. }] = tracks.as_slice()
                && let Some(first) = samples.first()
                && samples.iter().all(|sample| is_near(&sample.pose, &first.pose))
            {
                *link = Link::Static { parent: parent.clone(), pose: first.pose };
                continue;
            }
            tracks.sort_by_key(|track| std::cmp::Reverse(track.samples.len()));
            for Track { samples, .. } in tracks.iter_mut().filter(|track| !track.is_sorted) {
                samples.sort_by_key(|sample| sample.time_nanos);
            }
            if let Some(why) = doubt::reason(child, tracks) {
                self.doubts.insert(child.clone(), why);
            }
            tracks.truncate(1);
            for Track { samples, is_sorted, .. } in tracks.iter_mut().filter(|track| !track.is_sorted) {
                samples.reverse();
                samples.dedup_by_key(|sample| sample.time_nanos);
                samples.reverse();
                *is_sorted = true;
            }
        }
    }

    /// Forgets the transforms of a frame, static ones too.
    pub fn remove(&mut self, child: &str) {
        if let Some(Link::Moving(tracks)) = self.links.remove(child) {
            let samples: usize = tracks.iter().map(|track| track.samples.len()).sum();
            self.samples = self.samples.saturating_sub(samples);
        }
        self.conflicts.remove(child);
    }

    /// The frame that is fixed to a frame and nearest to the root: the robot, for a sensor.
    pub fn body<'f>(&'f self, frame: &'f str) -> &'f str {
        let chain = self.chain(frame);
        let moving = chain.iter().position(|name| self.moves(name));
        moving.and_then(|index| chain.get(index)).or(chain.last()).copied().unwrap_or(frame)
    }

    /// Sets the longest time between two samples that differ, nanoseconds; it is [`GAP_NANOS`] before.
    pub fn set_gap(&mut self, gap_nanos: i64) {
        self.gap_nanos = Some(gap_nanos);
    }

    /// Whether a frame moves within its parent.
    pub fn moves(&self, frame: &str) -> bool {
        matches!(self.links.get(frame), Some(Link::Moving(_)))
    }

    /// Whether transforms connect two frames.
    pub fn connects(&self, frame: &str, within: &str) -> bool {
        let chain = self.chain(frame);
        frame == within || self.chain(within).iter().any(|name| chain.contains(name))
    }

    /// Whether a frame may move within another one: a link between them is not static.
    pub fn may_move(&self, frame: &str, within: &str) -> bool {
        let (from, to) = (self.chain(frame), self.chain(within));
        let is_shared = |name: &&str| from.contains(name) && to.contains(name);
        from.iter().chain(&to).any(|name| !is_shared(name) && self.moves(name))
    }

    /// Whether there are no transforms.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// The frames from one to its root, itself first.
    pub fn chain<'f>(&'f self, frame: &'f str) -> Vec<&'f str> {
        let mut chain = vec![frame];
        let mut at = frame;
        while let Some(link) = self.links.get(at) {
            at = link.parent();
            if chain.len() > DEPTH_MAX || chain.contains(&at) {
                break;
            }
            chain.push(at);
        }
        chain
    }

    /// The names of all frames, in no order, some twice.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.links.iter().flat_map(|(child, link)| [child.as_str(), link.parent()])
    }

    /// Whether a frame is the child or the parent of a transform.
    pub fn knows(&self, frame: &str) -> bool {
        self.links.contains_key(frame) || self.links.values().any(|link| link.parent() == frame)
    }

    /// The pose of a frame within another one at a time.
    ///
    /// # Errors
    /// The frames are not connected, or the time lies outside the samples of a link between them.
    pub fn pose(&self, frame: &str, within: &str, time_nanos: i64) -> Result<Isometry3<f64>, FrameError> {
        if frame == within {
            return Ok(Isometry3::identity());
        }
        let (from, to) = (self.chain(frame), self.chain(within));
        let shared = from.iter().find(|name| to.contains(name));
        let Some(&shared) = shared else {
            if !self.knows(frame) {
                return Err(FrameError::Unknown(frame.to_owned()));
            }
            if !self.knows(within) {
                return Err(FrameError::Unknown(within.to_owned()));
            }
            return Err(FrameError::NotConnected { frame: frame.to_owned(), within: within.to_owned() });
        };
        let upwards = |chain: &[&str]| {
            let mut links = chain.iter().take_while(|name| **name != shared);
            links.try_fold(Isometry3::identity(), |below, child| Ok(self.link(child, time_nanos)? * below))
        };
        Ok(upwards(&to)?.inverse() * upwards(&from)?)
    }

    fn link(&self, child: &str, time_nanos: i64) -> Result<Isometry3<f64>, FrameError> {
        match self.links.get(child) {
            None => Err(FrameError::Unknown(child.to_owned())),
            Some(Link::Static { pose, .. }) => Ok(*pose),
            Some(Link::Moving(_)) if self.doubts.contains_key(child) => {
                Err(FrameError::Doubt(self.doubts.get(child).cloned().unwrap_or_default()))
            }
            Some(Link::Moving(tracks)) => {
                let Some(Track { parent, samples, .. }) = tracks.first() else {
                    return Err(FrameError::Unknown(child.to_owned()));
                };
                let after = samples.partition_point(|sample| sample.time_nanos < time_nanos);
                let names = || (parent.clone(), child.to_owned());
                match (after.checked_sub(1).and_then(|before| samples.get(before)), samples.get(after)) {
                    (_, Some(sample)) if sample.time_nanos == time_nanos => Ok(sample.pose),
                    (Some(before), Some(after)) => {
                        let gap_nanos = self.gap_nanos.unwrap_or(GAP_NANOS);
                        let apart = i128::from(after.time_nanos) - i128::from(before.time_nanos);
                        if apart > i128::from(gap_nanos) && !is_within(&before.pose, &after.pose, ALIKE_M, ALIKE_RAD) {
                            let (parent, child) = names();
                            return Err(FrameError::Gap { parent, child, gap_nanos });
                        }
                        if doubt::is_jump(before, after) {
                            let (parent, child) = names();
                            return Err(FrameError::Jump { parent, child });
                        }
                        Ok(between(before, after, time_nanos))
                    }
                    (None, _) => {
                        let (parent, child) = names();
                        Err(FrameError::Before { parent, child })
                    }
                    (_, None) => {
                        let (parent, child) = names();
                        Err(FrameError::After { parent, child })
                    }
                }
            }
        }
    }
}

/// Whether two poses are equal except for rounding.
fn is_near(one: &Isometry3<f64>, other: &Isometry3<f64>) -> bool {
    is_within(one, other, 1e-6, 1e-6)
}

/// Whether two poses differ by less than a distance, metres, and an angle, radians.
fn is_within(one: &Isometry3<f64>, other: &Isometry3<f64>, distance_m: f64, angle_rad: f64) -> bool {
    let apart = one.translation.vector - other.translation.vector;
    apart.norm() < distance_m && one.rotation.angle_to(&other.rotation) < angle_rad
}

/// The pose between two samples.
fn between(before: &PoseSample, after: &PoseSample, time_nanos: i64) -> Isometry3<f64> {
    let elapsed = |to: i64| i128::from(to) - i128::from(before.time_nanos);
    let share = elapsed(time_nanos) as f64 / elapsed(after.time_nanos) as f64;
    let (from, to) = (before.pose.translation.vector, after.pose.translation.vector);
    let translation: Vector3<f64> = from + (to - from) * share;
    let (start, end) = (before.pose.rotation, after.pose.rotation);
    Isometry3::from_parts(translation.into(), between_rotations(start, end, share))
}

/// The rotation at a share of the shorter arc from one to another. It uses the functions of a library, not of the
/// system: a recording must give the same observations on every system, so that it can be sent again.
fn between_rotations(start: UnitQuaternion<f64>, end: UnitQuaternion<f64>, share: f64) -> UnitQuaternion<f64> {
    let cos = start.coords.dot(&end.coords);
    // A quaternion and its negative are the same rotation.
    let (cos, end) = if cos < 0.0 { (-cos, -end.coords) } else { (cos, end.coords) };
    let angle = libm::acos(cos.min(1.0));
    let sin = libm::sin(angle);
    if sin < 1e-9 {
        return if share < 0.5 { start } else { UnitQuaternion::new_unchecked(Quaternion::from(end)) };
    }
    let part = |share: f64| libm::sin(share * angle) / sin;
    let coords = start.coords * part(1.0 - share) + end * part(share);
    UnitQuaternion::new_normalize(Quaternion::from(coords))
}

#[cfg(test)]
mod tests;

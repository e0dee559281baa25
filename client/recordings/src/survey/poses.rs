//! Poses of a robot that are taken in place of transforms.
//!
//! Invariant: the number of kept poses is bounded. A pose that cannot be used is counted, with the first reason.

use crate::{
    frames::{Frames, SAMPLES_MAX, Transform, frame_name},
    known::{self, POSE_TYPES},
    message::Value,
};

/// The topic whose poses are taken, as a user names it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PoseSource {
    /// Name of the topic.
    pub topic: String,
    /// The frame that has these poses; that of the messages if absent.
    pub child: Option<String>,
}

impl PoseSource {
    /// Reads `TOPIC`, or `TOPIC=FRAME`.
    pub fn read(text: &str) -> Self {
        let (topic, child) = text.split_once('=').map_or((text, None), |(topic, child)| (topic, Some(child)));
        let child = child.map(|child| frame_name(child).to_owned()).filter(|child| !child.is_empty());
        Self { topic: topic.to_owned(), child }
    }
}

/// The poses of a recording that were taken in place of transforms.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TakenPoses {
    /// The frame that has these poses.
    pub child: String,
    /// Number of poses.
    pub taken: u64,
    /// Number of poses that cannot be used.
    pub unused: u64,
    /// Why the first of them cannot be used.
    pub problem: Option<String>,
}

/// Collects poses.
#[derive(Debug)]
pub(super) struct Poses {
    pub(super) source: PoseSource,
    /// Each with its time of recording.
    kept: Vec<(i64, Transform)>,
    taken: TakenPoses,
    pub(super) has_too_many: bool,
}

impl Poses {
    pub(super) fn new(source: PoseSource) -> Self {
        Self { source, kept: Vec::new(), taken: TakenPoses::default(), has_too_many: false }
    }

    /// Takes a message of the topic.
    pub(super) fn add(&mut self, type_name: &str, message: &Value<'_>, recorded_nanos: i64) {
        let Some(type_name) = POSE_TYPES.iter().find(|known| **known == type_name) else { return };
        match known::pose_transform(message, type_name) {
            Ok(_) if self.kept.len() >= SAMPLES_MAX => self.has_too_many = true,
            Ok(mut pose) => {
                if pose.time_nanos == 0 {
                    pose.time_nanos = recorded_nanos;
                }
                self.taken.taken += 1;
                self.kept.push((recorded_nanos, pose));
            }
            Err(error) => {
                self.taken.unused += 1;
                self.taken.problem.get_or_insert_with(|| error.to_string());
            }
        }
    }

    /// Puts the poses in place of the transforms of the frame that has them. `sensor`: the frame of a sensor; poses
    /// that name no frame are those of the body to which it is fixed. `is_taken`: whether poses of a time of recording
    /// are taken.
    pub(super) fn put_into(self, frames: &mut Frames, sensor: &str, is_taken: impl Fn(i64) -> bool) -> TakenPoses {
        let Self { source, kept, mut taken, .. } = self;
        let kept: Vec<Transform> =
            kept.into_iter().filter(|(recorded, _)| is_taken(*recorded)).map(|(_, pose)| pose).collect();
        taken.taken = kept.len() as u64;
        let named = kept.iter().map(|pose| pose.child.clone()).find(|child| !child.is_empty());
        let child = match source.child {
            Some(child) => child,
            None => named.clone().unwrap_or_else(|| frames.body(sensor).to_owned()),
        };
        if child.is_empty() {
            taken.unused += std::mem::take(&mut taken.taken);
            taken.problem.get_or_insert_with(|| "it names no frame, and no sensor does".to_owned());
            return taken;
        }
        frames.remove(&child);
        for pose in kept {
            // The poses of another robot, or of the frame in itself.
            let is_other = !pose.child.is_empty() && pose.child != child && Some(&pose.child) != named.as_ref();
            let is_own = frames.chain(&pose.parent).contains(&child.as_str());
            if is_other || is_own || frames.add(Transform { child: child.clone(), ..pose }, false).is_err() {
                taken.taken -= 1;
                taken.unused += 1;
                taken.problem.get_or_insert_with(|| {
                    if is_own {
                        format!("its frame hangs below {child:?}")
                    } else {
                        "it is of another frame".to_owned()
                    }
                });
            }
        }
        taken.child = child;
        taken
    }
}

//! The topic whose poses are taken in place of transforms.

use super::PlanError;
use crate::{
    known::POSE_TYPES,
    survey::{PoseSource, Surveyed, TopicSurvey},
};

/// The topics whose messages are poses of a robot.
pub fn pose_topics(surveyed: &Surveyed) -> impl Iterator<Item = &TopicSurvey> {
    surveyed.topics.iter().filter(|topic| topic.messages > 0 && POSE_TYPES.contains(&topic.type_name.as_str()))
}

/// The index of the topic.
///
/// # Errors
/// There is no such topic, or it has no poses.
pub(super) fn topic(surveyed: &Surveyed, source: &PoseSource) -> Result<usize, PlanError> {
    let name = &source.topic;
    let fault = |problem: String| {
        let others: Vec<&str> =
            pose_topics(surveyed).map(|topic| topic.name.as_str()).filter(|other| other != name).collect();
        let candidates = match others.as_slice() {
            [] => "no other topic of the recording has poses".to_owned(),
            others => format!("topics with poses are {}", others.join(", ")),
        };
        PlanError::NoPoses { problem, candidates }
    };
    let mut named = surveyed.topics.iter().enumerate().filter(|(_, topic)| topic.name == *name);
    let first = named.clone().next();
    let of_poses = named.find(|(_, topic)| POSE_TYPES.contains(&topic.type_name.as_str()));
    let Some((index, _)) = of_poses else {
        return Err(fault(match first {
            None => format!("the recording has no topic {name:?} to take poses from"),
            Some((_, topic)) => {
                let types = POSE_TYPES.join(", ");
                format!("{name} has messages of {}, which are no poses: poses are {types}", topic.type_name)
            }
        }));
    };
    match &surveyed.poses {
        Some(poses) if poses.taken == 0 => {
            let why = poses.problem.as_deref().unwrap_or("it has no messages");
            Err(fault(format!("no pose can be taken from {name}: {why}")))
        }
        _ => Ok(index),
    }
}

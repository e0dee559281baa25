//! The frame in which the scans, clouds, grids and positions of a recording are placed.
//!
//! Invariant: the frame is one that a transform or a message names.

use nalgebra::Vector3;

use super::{GridUse, PlanError, TopicPlan, has_moving_link};
use crate::survey::{Surveyed, TopicSurvey};

/// The reason for the choice of the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameChoice {
    /// The user chose it.
    Requested,
    /// By its name: `map`, else `odom`.
    Usual,
    /// The frame is the root above the sensors.
    Root,
    /// No transforms are needed: it is the frame of the messages.
    OfMessages,
    /// There is no frame.
    #[default]
    None,
}

/// The number of times at which sensors are checked, and the cosine of the angle from which on a sensor counts as
/// leaning, 5 degrees.
const CHECKED_TIMES: u32 = 50;
const LEVEL_COSINE: f64 = 0.996_2;

/// Names of frames that do not move, the best first.
const USUAL: [&str; 2] = ["map", "odom"];

pub(super) fn choose(
    surveyed: &Surveyed,
    plans: &[TopicPlan],
    requested: Option<&str>,
) -> Result<(Option<String>, FrameChoice), PlanError> {
    let placed =
        || surveyed.topics.iter().zip(plans).filter(|(_, plan)| plan.grid.is_some() || !plan.positions.is_empty());
    let frames = &surveyed.frames;
    if let Some(requested) = requested {
        let requested = crate::frames::frame_name(requested);
        if frames.knows(requested) || placed().any(|(topic, _)| topic.frame == requested) {
            return Ok((Some(requested.to_owned()), FrameChoice::Requested));
        }
        return Err(PlanError::NoFrame { frame: requested.to_owned(), frames: names(surveyed) });
    }
    // Sensors move: the frame must be another one than their own frame. Sensors come first, because without a place no
    // observation is made of their messages.
    let moves = |plan: &TopicPlan| matches!(plan.grid, Some(GridUse::Scans | GridUse::Clouds));
    for is_sensor in [true, false] {
        let topics = || placed().filter(|(_, plan)| moves(plan) == is_sensor).map(|(topic, _)| topic);
        for usual in USUAL {
            if frames.knows(usual) && topics().any(|topic| frames.connects(&topic.frame, usual)) {
                return Ok((Some(usual.to_owned()), FrameChoice::Usual));
            }
        }
        let root = topics()
            .filter(|topic| is_sensor && has_moving_link(surveyed, &topic.frame))
            .find_map(|topic| frames.chain(&topic.frame).last().map(|root| (*root).to_owned()));
        if let Some(root) = root {
            return Ok((Some(root), FrameChoice::Root));
        }
    }
    let of_messages = placed().find(|(topic, plan)| !moves(plan) && !topic.frame.is_empty());
    Ok(match of_messages {
        Some((topic, _)) => {
            let chain = frames.chain(&topic.frame);
            (chain.last().map(|root| (*root).to_owned()), FrameChoice::OfMessages)
        }
        None => (None, FrameChoice::None),
    })
}

/// Whether the z axis of a sensor points up at some times spread over its messages. Times without a transform do not
/// count.
pub(super) fn is_level(surveyed: &Surveyed, topic: &TopicSurvey, frame: Option<&str>) -> bool {
    let (Some(frame), Some(stamps)) = (frame, topic.stamps) else { return true };
    let length = i128::from(stamps.last_nanos) - i128::from(stamps.first_nanos);
    (0..=CHECKED_TIMES).all(|number| {
        let elapsed = length * i128::from(number) / i128::from(CHECKED_TIMES);
        let time_nanos = stamps.first_nanos.saturating_add(i64::try_from(elapsed).unwrap_or(i64::MAX));
        let pose = surveyed.frames.pose(&topic.frame, frame, time_nanos);
        // A scanner that hangs upside down is level, too.
        pose.map_or(true, |pose| (pose.rotation * Vector3::z()).z.abs() > LEVEL_COSINE)
    })
}

/// Frames of a recording, for a message.
fn names(surveyed: &Surveyed) -> String {
    let mut names: Vec<&str> = surveyed.topics.iter().map(|topic| topic.frame.as_str()).collect();
    names.extend(surveyed.frames.names());
    names.retain(|name| !name.is_empty());
    names.sort_unstable();
    names.dedup();
    match names.len() {
        0 => "none".to_owned(),
        1..=30 => names.join(", "),
        count => format!("{} and {} more", names.iter().take(30).copied().collect::<Vec<_>>().join(", "), count - 30),
    }
}

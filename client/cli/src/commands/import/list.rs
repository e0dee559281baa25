//! The output of an import: the topics, the observations made of them, and notices for the user.
//!
//! Invariant: each topic is one row, in the order of the recording.

use tidemap_formats::table::Cell;
use tidemap_recordings::{
    plan::{FrameChoice, GridUse, TopicPlan, pose_topics},
    survey::{TakenPart, TakenPoses},
};

use super::{Planned, counts::TopicCounts};
use crate::{commands::Session, progress::status_line};

const COLUMNS: [&str; 7] = ["topic", "type", "messages", "becomes", "accepted", "skipped", "refused"];

/// Prints what would become of the topics.
pub(super) fn print(session: &Session, planned: &Planned) -> anyhow::Result<()> {
    let rows = rows(planned).map(|row| [row, vec![Cell::Empty; 3]].concat());
    session.print(&COLUMNS, rows)?;
    report(planned);
    for (topic, plan) in planned.surveyed.topics.iter().zip(&planned.plan.topics) {
        if let Some(why) = &plan.skipped {
            status_line(&format!("{}: {why}", topic.name));
        }
    }
    Ok(())
}

/// Prints what became of the topics.
pub(super) fn print_counts(session: &Session, planned: &Planned, counts: &TopicCounts) -> anyhow::Result<()> {
    let all = rows(planned).zip(counts.topics()).map(|(row, counts)| {
        let counted = [counts.accepted, counts.skipped, counts.refused].map(Cell::from).to_vec();
        [row, counted].concat()
    });
    session.print(&COLUMNS, all)?;
    Ok(())
}

fn rows(planned: &Planned) -> impl Iterator<Item = Vec<Cell>> {
    planned.surveyed.topics.iter().zip(&planned.plan.topics).map(|(topic, plan)| {
        vec![
            Cell::Text(topic.name.clone()),
            Cell::Text(topic.type_name.clone()),
            topic.messages.into(),
            Cell::Text(plan.becomes()),
        ]
    })
}

/// Whether all possible observations are scans and clouds, and none of their places is known.
pub(super) fn is_all_without_place(planned: &Planned) -> bool {
    let mut observed = planned.plan.topics.iter().filter(|plan| plan.is_observed());
    let is_unplaced = |plan: &TopicPlan| {
        matches!(plan.grid, Some(GridUse::Scans | GridUse::Clouds))
            && plan.states.is_empty()
            && plan.positions.is_empty()
            && plan.traversals.is_none()
    };
    planned.plan.frame.is_none() && observed.all(is_unplaced)
}

/// Reports what the rows do not contain: frames, transforms, times.
pub(super) fn report(planned: &Planned) {
    let Planned { surveyed, plan, .. } = planned;
    let places = |choice: FrameChoice, frame: &str| match choice {
        FrameChoice::Requested => format!("everything is placed in frame {frame:?}, as requested"),
        FrameChoice::Usual => format!("everything is placed in frame {frame:?}; --frame names another"),
        FrameChoice::Root => format!("everything is placed in frame {frame:?}, the root above the sensors"),
        FrameChoice::OfMessages | FrameChoice::None => format!("the messages are in frame {frame:?}"),
    };
    if let Some(frame) = &plan.frame {
        status_line(&places(plan.choice, frame));
    }
    let unplaced = surveyed.topics.iter().zip(&plan.topics).find(|(topic, topic_plan)| {
        let within = plan.frame.as_deref().is_some_and(|frame| surveyed.frames.connects(&topic.frame, frame));
        matches!(topic_plan.grid, Some(GridUse::Scans | GridUse::Clouds)) && !topic.frame.is_empty() && !within
    });
    if let Some((topic, _)) = unplaced {
        let poses: Vec<&str> = pose_topics(surveyed).map(|topic| topic.name.as_str()).take(5).collect();
        let poses = match poses.first() {
            Some(first) if surveyed.poses.is_none() => {
                format!("; --pose-from {first} takes the poses of that topic (there are {})", poses.join(", "))
            }
            _ => String::new(),
        };
        status_line(&format!(
            "the recording has no transforms that give the position of {:?} of {}, so its messages have no place: \
             if it stood still, add --frame {}{poses}",
            topic.frame, topic.name, topic.frame
        ));
    }
    if let Some(poses) = &surveyed.poses {
        let TakenPoses { child, taken, unused, problem } = poses;
        status_line(&format!("{taken} poses give the place of frame {child:?}, in place of its transforms"));
        if *unused > 0 {
            let why = problem.as_deref().unwrap_or_default();
            status_line(&format!("{unused} poses are not used: {why}"));
        }
    }
    let conflicts: Vec<&str> = surveyed.frames.conflicts().collect();
    if !conflicts.is_empty() {
        status_line(&format!(
            "several transforms contradict each other about {}: a parent that changes, a fixed one that moves, or two \
             robots in one recording. skip: in a mapping leaves out a topic of transforms",
            conflicts.join(", ")
        ));
    }
    for doubt in surveyed.frames.doubts() {
        status_line(&format!("nothing is placed by these transforms: {doubt}"));
    }
    if let Some(TakenPart { times_back, back_nanos, .. }) = surveyed.part {
        let times = if times_back == 1 { "once".to_owned() } else { format!("{times_back} times") };
        status_line(&format!(
            "the robot's clock goes back {times}, by up to {:.1} s, such as that of a simulation that starts again: the \
             part with the most messages is taken. Cut the recording there, and import each part by itself",
            back_nanos as f64 / 1e9
        ));
    }
    if let Some((count, first)) = &surveyed.passed_over {
        let more = if *count > 1 { format!(", and {} more like it", count - 1) } else { String::new() };
        status_line(&format!("passed over: {first}{more}"));
    }
    if surveyed.has_too_many_transforms {
        status_line(
            "the recording has more transforms than can be held: the last ones are missing, and so are the scans after \
             them. Split the recording, for example with ros2 bag convert",
        );
    }
    if surveyed.bad_transforms > 0 {
        status_line(&format!(
            "{} transforms are left out: they are not finite or name no frames",
            surveyed.bad_transforms
        ));
    }
    let topics = surveyed.topics.iter().zip(&plan.topics);
    let used = topics.filter(|(_, plan)| plan.is_observed() || plan.is_transforms).map(|(topic, _)| topic);
    for topic in used.filter(|topic| topic.unread > 0) {
        let problem = topic.problem.as_deref().unwrap_or_default();
        status_line(&format!("{}: {} messages cannot be read: {problem}", topic.name, topic.unread));
    }
}

//! The lists of format 4, as texts like those of [format 3](crate::v3::lists).
//!
//! Invariant: a text that is read is the text that its content gives when it is written again.

use crate::v3::lists::TextList;

/// File of [`CheckpointList`] in the folder of a map.
pub const CHECKPOINTS_FILE: &str = "CHECKPOINTS";
/// File of [`LossList`] in the data directory.
pub const LOSSES_FILE: &str = "LOSSES";

/// The checkpoints of a map, and where its log begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CheckpointList {
    /// The record with which the first segment of the log begins; an earlier segment may still be there.
    pub first_record: u64,
    /// Positions of the checkpoints that must exist, ascending; a further one may be there.
    pub checkpoints: Vec<u64>,
}

impl Default for CheckpointList {
    /// That of a new map.
    fn default() -> CheckpointList {
        CheckpointList { first_record: 1, checkpoints: Vec::new() }
    }
}

/// What was accepted as lost, in the order of its acceptance.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LossList {
    /// The losses.
    pub losses: Vec<Loss>,
}

/// Something that is lost, and accepted as lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// When an operator accepted it, nanoseconds UTC.
    pub accepted_nanos: i64,
    /// The file or folder, within the data directory; without spaces.
    pub file: String,
    /// What was wrong with it; one line.
    pub problem: String,
}

impl TextList for CheckpointList {
    const FIRST_LINE: &'static str = "tidemap checkpoints";

    fn lines(&self) -> Vec<String> {
        let checkpoints = self.checkpoints.iter().map(|position| format!("checkpoint {position}"));
        std::iter::once(format!("first {}", self.first_record)).chain(checkpoints).collect()
    }

    fn parse(lines: &[&str]) -> Option<CheckpointList> {
        let (first, checkpoints) = lines.split_first()?;
        let position = |line: &&str| line.strip_prefix("checkpoint ")?.parse().ok();
        let checkpoints = checkpoints.iter().map(position).collect::<Option<_>>()?;
        Some(CheckpointList { first_record: first.strip_prefix("first ")?.parse().ok()?, checkpoints })
    }
}

impl TextList for LossList {
    const FIRST_LINE: &'static str = "tidemap losses";

    fn lines(&self) -> Vec<String> {
        let line = |loss: &Loss| format!("loss {} {} {}", loss.accepted_nanos, loss.file, loss.problem);
        self.losses.iter().map(line).collect()
    }

    fn parse(lines: &[&str]) -> Option<LossList> {
        let loss = |line: &&str| {
            let mut fields = line.strip_prefix("loss ")?.splitn(3, ' ');
            let accepted_nanos = fields.next()?.parse().ok()?;
            let [file, problem] = [fields.next()?, fields.next()?].map(str::to_owned);
            Some(Loss { accepted_nanos, file, problem })
        };
        Some(LossList { losses: lines.iter().map(loss).collect::<Option<_>>()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v3::lists::tests::check;

    #[test]
    fn the_lists_are_read_as_written_and_written_like_this_for_ever() {
        let list = CheckpointList { first_record: 101, checkpoints: vec![120, 140] };
        check(&list);
        check(&CheckpointList::default());
        let text = "tidemap checkpoints\nfirst 101\ncheckpoint 120\ncheckpoint 140\ncrc32c ";
        assert!(list.to_text().starts_with(text));
        let file = "maps/00000001/HISTORY".to_owned();
        let loss = Loss { accepted_nanos: 5, file, problem: "it is missing".to_owned() };
        let list = LossList { losses: vec![loss.clone(), Loss { accepted_nanos: -7, ..loss }] };
        check(&list);
        assert!(list.to_text().starts_with("tidemap losses\nloss 5 maps/00000001/HISTORY it is missing\nloss -7 "));
    }
}

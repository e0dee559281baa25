//! How to bring a data directory from its format to the current one.
//!
//! Invariant: a plan only leads to newer formats, one at a time, and never past [`FORMAT`](crate::FORMAT).

use std::{io, path::Path};

use crate::{
    v3::{
        self,
        lists::{HISTORY_FILE, MAPS_FILE, NEWEST_FILE},
    },
    v4::{self, lists::CHECKPOINTS_FILE},
};

/// One step from a format to the next.
///
/// A step must be safe to run again after an interruption at any point: it writes copies beside the old files, makes
/// them durable and renames them, and the manifest names the new format only afterwards.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The format that the step starts from; it leads to the next one.
    pub from: u32,
    /// Description for the log.
    pub summary: &'static str,
    /// Runs the step in the data directory.
    pub run: fn(&Path) -> io::Result<()>,
}

/// All steps, ascending.
pub const STEPS: &[Step] = &[
    Step {
        from: 1,
        summary: "existing files do not change; new maps may have grids, which older versions cannot read",
        run: |_| Ok(()),
    },
    Step {
        from: 2,
        summary: "existing files do not change; lists of the files that must exist are made",
        run: |_| Ok(()),
    },
    Step {
        from: 3,
        summary: "existing files do not change; lists of the checkpoints that must exist are made",
        run: |_| Ok(()),
    },
];

/// Whether a data directory of a format has a list of what must exist from its creation on. The store makes those that
/// a step adds, before the manifest names the new format.
pub fn has_list(format: u32, file_name: &str) -> bool {
    let since = match file_name {
        MAPS_FILE | HISTORY_FILE | NEWEST_FILE => v3::FORMAT,
        CHECKPOINTS_FILE => v4::FORMAT,
        _ => return false,
    };
    format >= since
}

/// What to do with a data directory.
#[derive(Clone, Debug)]
pub enum Plan {
    /// Nothing: it has the format that this version uses.
    Current,
    /// Run these steps in order, writing the manifest after each.
    Migrate(Vec<Step>),
    /// Change nothing: a newer version wrote it.
    TooNew {
        /// The format of the directory.
        found: u32,
        /// The newest that this version knows.
        supported: u32,
    },
    /// Change nothing: there is no step from this format.
    NoWay {
        /// The format that has no step.
        from: u32,
    },
}

/// The plan from format `found` to format `supported` by `steps`.
pub fn plan(found: u32, supported: u32, steps: &[Step]) -> Plan {
    if found > supported {
        return Plan::TooNew { found, supported };
    }
    let mut way = Vec::new();
    for from in found..supported {
        let Some(step) = steps.iter().find(|step| step.from == from) else {
            return Plan::NoWay { from };
        };
        way.push(*step);
    }
    if way.is_empty() { Plan::Current } else { Plan::Migrate(way) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(from: u32) -> Step {
        Step { from, summary: "test", run: |_| Ok(()) }
    }

    #[test]
    fn the_way_leads_upwards_one_format_at_a_time() {
        let steps = [step(1), step(2), step(3)];
        assert!(matches!(plan(3, 3, &steps), Plan::Current));
        assert!(matches!(plan(4, 3, &steps), Plan::TooNew { found: 4, supported: 3 }));
        let Plan::Migrate(way) = plan(2, 4, &steps) else { panic!("expected steps") };
        assert_eq!(way.iter().map(|step| step.from).collect::<Vec<_>>(), [2, 3]);
    }

    #[test]
    fn a_format_without_a_step_is_left_alone() {
        assert!(matches!(plan(0, 1, STEPS), Plan::NoWay { from: 0 }));
        assert!(matches!(plan(1, 3, &[step(1)]), Plan::NoWay { from: 2 }));
    }

    #[test]
    fn the_released_steps_lead_from_format_1_to_the_present() {
        let Plan::Migrate(way) = plan(1, crate::FORMAT, STEPS) else { panic!("expected steps") };
        assert_eq!(way.iter().map(|step| step.from).collect::<Vec<_>>(), [1, 2, 3]);
        for step in way {
            (step.run)(Path::new("/nowhere")).expect("changes nothing");
        }
    }
}

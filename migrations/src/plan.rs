//! The way of a data directory from its format to the current one.
//!
//! Invariant: a plan only leads to newer formats, one at a time, and never past the format of the program. The manifest
//! names a format only when the step to it is complete.

use std::{io, path::Path};

use crate::manifest::{self, Manifest, ManifestError};

/// One step from a format to the next.
///
/// A step must be safe to run again after an interruption at any point: it writes copies beside the old files, makes
/// them durable and renames them, and the manifest names the new format only afterwards.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The format that the step starts from; it leads to the next one.
    pub from: u32,
    /// Runs the step in the data directory.
    pub run: fn(&Path) -> io::Result<()>,
}

/// All steps, ascending. There is one format so far.
pub const STEPS: &[Step] = &[];

/// The plan for a data directory.
#[derive(Clone, Debug)]
pub enum Plan {
    /// Nothing: it has the format that this version uses.
    Current,
    /// Run these steps in order, writing the manifest after each.
    Migrate(Vec<Step>),
    /// Change nothing: a newer version wrote it.
    TooNew,
    /// Change nothing: there is no step from this format.
    NoWay {
        /// The format that has no step.
        from: u32,
    },
}

/// The plan from format `found` to format `supported` by `steps`.
pub fn plan(found: u32, supported: u32, steps: &[Step]) -> Plan {
    if found > supported {
        return Plan::TooNew;
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

/// Why a data directory cannot be brought to the current format. Its manifest names the last format that was reached.
#[derive(Debug, thiserror::Error)]
pub enum MigrateError {
    /// A newer version wrote it, or its manifest cannot be written.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// There is no step from this format.
    #[error("it has disk format {from}, from which this version cannot migrate")]
    NoWay {
        /// The format that has no step.
        from: u32,
    },
    /// A step has failed. The next start runs it again.
    #[error("the step from disk format {from} has failed: {source}")]
    Step {
        /// The format that the step starts from.
        from: u32,
        /// Why.
        source: io::Error,
    },
}

/// Brings a data directory with this manifest to format `supported` by `steps`, and gives its new manifest. The
/// manifest names the format that a step has reached before the next step begins.
///
/// # Errors
/// [`MigrateError`]. Where no step was possible, nothing is changed.
pub fn migrate(
    directory: &Path,
    mut manifest: Manifest,
    supported: u32,
    steps: &[Step],
) -> Result<Manifest, MigrateError> {
    match plan(manifest.format, supported, steps) {
        Plan::Current => Ok(manifest),
        Plan::Migrate(way) => {
            for step in way {
                (step.run)(directory).map_err(|source| MigrateError::Step { from: step.from, source })?;
                manifest.format = step.from + 1;
                manifest::write(directory, &manifest)?;
            }
            Ok(manifest)
        }
        Plan::TooNew => {
            let file = directory.join(manifest::FILE_NAME);
            Err(ManifestError::TooNew { file, found: manifest.format, supported }.into())
        }
        Plan::NoWay { from } => Err(MigrateError::NoWay { from }),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn step(from: u32) -> Step {
        Step { from, run: |_| Ok(()) }
    }

    #[test]
    fn the_way_leads_upwards_one_format_at_a_time() {
        let steps = [step(1), step(2), step(3)];
        assert!(matches!(plan(3, 3, &steps), Plan::Current));
        assert!(matches!(plan(4, 3, &steps), Plan::TooNew));
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
        let way = match plan(1, crate::FORMAT, STEPS) {
            Plan::Migrate(way) => way,
            Plan::Current => Vec::new(),
            other => panic!("{other:?}"),
        };
        assert_eq!(way.iter().map(|step| step.from).collect::<Vec<_>>(), (1..crate::FORMAT).collect::<Vec<_>>());
        assert_eq!(way.len(), STEPS.len());
    }

    /// An invented step from format 1 to 2: each line of the file `DATA` gets a `!` at its end.
    const INVENTED: Step = Step {
        from: 1,
        run: |directory| {
            let (file, copy) = (directory.join("DATA"), directory.join("DATA.new"));
            let text = fs::read_to_string(&file)?;
            // A step that was cut off before the manifest was written has done its work already.
            let lines = text.lines().map(|line| format!("{}!\n", line.trim_end_matches('!')));
            fs::write(&copy, lines.collect::<String>())?;
            if directory.join("DISK_FAILS").exists() {
                return Err(io::Error::other("the disk has failed"));
            }
            fs::rename(copy, file)
        },
    };
    /// An invented step from format 2 to 3, which fails while the file `SECOND_FAILS` is there.
    const SECOND: Step = Step {
        from: 2,
        run: |directory| match directory.join("SECOND_FAILS").exists() {
            true => Err(io::Error::other("the disk has failed")),
            false => fs::write(directory.join("MORE"), "more"),
        },
    };

    /// A data directory of format 1 and its manifest.
    fn format_1() -> (tempfile::TempDir, Manifest) {
        let directory = tempfile::tempdir().expect("temporary directory");
        let manifest = Manifest { format: 1, store_id: "00112233445566778899aabbccddeeff".to_owned() };
        manifest::write(directory.path(), &manifest).expect("writable");
        fs::write(directory.path().join("DATA"), "one\ntwo\n").expect("writable");
        (directory, manifest)
    }

    fn format(directory: &Path) -> u32 {
        manifest::read(directory, 9).expect("readable").expect("it is there").format
    }

    #[test]
    fn a_step_changes_the_files_and_then_the_manifest() {
        let (directory, manifest) = format_1();
        let migrated = migrate(directory.path(), manifest.clone(), 2, &[INVENTED]).expect("migrates");
        assert_eq!(migrated, Manifest { format: 2, ..manifest });
        assert_eq!(manifest::read(directory.path(), 2).expect("readable"), Some(migrated.clone()));
        assert_eq!(fs::read_to_string(directory.path().join("DATA")).expect("readable"), "one!\ntwo!\n");
        assert_eq!(migrate(directory.path(), migrated.clone(), 2, &[INVENTED]).expect("nothing to do"), migrated);
    }

    #[test]
    fn a_step_that_fails_half_way_is_made_again_by_the_next_start() {
        let (directory, manifest) = format_1();
        let fault = directory.path().join("DISK_FAILS");
        fs::write(&fault, "").expect("writable");
        let error = migrate(directory.path(), manifest.clone(), 2, &[INVENTED]).expect_err("it fails");
        assert!(matches!(error, MigrateError::Step { from: 1, .. }), "{error}");
        assert_eq!(format(directory.path()), 1);
        assert_eq!(fs::read_to_string(directory.path().join("DATA")).expect("readable"), "one\ntwo\n");
        fs::remove_file(fault).expect("removable");
        // Cut off after its work, before the manifest.
        (INVENTED.run)(directory.path()).expect("runs");
        migrate(directory.path(), manifest, 2, &[INVENTED]).expect("migrates");
        assert_eq!(format(directory.path()), 2);
        assert_eq!(fs::read_to_string(directory.path().join("DATA")).expect("readable"), "one!\ntwo!\n");
    }

    #[test]
    fn a_later_step_that_fails_leaves_the_format_that_was_reached() {
        let (directory, manifest) = format_1();
        let fault = directory.path().join("SECOND_FAILS");
        fs::write(&fault, "").expect("writable");
        let steps = [INVENTED, SECOND];
        let error = migrate(directory.path(), manifest, 3, &steps).expect_err("the second fails");
        assert!(matches!(error, MigrateError::Step { from: 2, .. }), "{error}");
        assert_eq!(format(directory.path()), 2);
        fs::remove_file(fault).expect("removable");
        let reached = manifest::read(directory.path(), 3).expect("readable").expect("it is there");
        assert_eq!(migrate(directory.path(), reached, 3, &steps).expect("migrates").format, 3);
        assert_eq!(fs::read_to_string(directory.path().join("DATA")).expect("readable"), "one!\ntwo!\n");
        assert!(directory.path().join("MORE").exists());
    }

    #[test]
    fn a_directory_of_a_newer_format_or_without_a_way_is_left_alone() {
        let (directory, manifest) = format_1();
        let newer = Manifest { format: 3, ..manifest.clone() };
        let error = migrate(directory.path(), newer, 2, &[INVENTED]).expect_err("too new");
        let too_new = |error: &MigrateError| {
            matches!(error, MigrateError::Manifest(ManifestError::TooNew { found: 3, supported: 2, .. }))
        };
        assert!(too_new(&error), "{error}");
        let error = migrate(directory.path(), manifest.clone(), 3, &[INVENTED]).expect_err("no way to 3");
        assert!(matches!(error, MigrateError::NoWay { from: 2 }), "{error}");
        assert_eq!(format(directory.path()), 1);
        assert_eq!(fs::read_to_string(directory.path().join("DATA")).expect("readable"), "one\ntwo\n");
    }
}

//! `tidemapd check DIR` and `tidemapd backup restore BACKUP DIR`: what an operator does with folders that no daemon
//! uses.
//!
//! Invariant: the exit status is 0 where all is sound or done, 1 where something is damaged or not done, and 2 where
//! nothing can be checked. Results go to stdout, everything else to stderr.

use std::{io::Write, path::Path, process::ExitCode};

use tidemap_store::{BackupError, Checked, check};

use crate::daemon::random_id;

/// Checks a data folder, and prints what is wrong.
pub(crate) fn run_check(directory: &Path, repair: bool) -> ExitCode {
    let checked = match check(directory, repair) {
        Ok(checked) => checked,
        Err(error) => return refuse(&error.to_string(), 2),
    };
    // A reader that goes away is no error.
    let printed = print(&checked, &mut std::io::stdout().lock());
    let is_sound = checked.findings.iter().all(|finding| finding.is_repaired);
    if printed.is_ok() && is_sound { ExitCode::SUCCESS } else { ExitCode::from(1) }
}

fn print(checked: &Checked, out: &mut impl Write) -> std::io::Result<()> {
    for finding in &checked.findings {
        let file = finding.file.display();
        let advice = if finding.is_repaired { "repaired" } else { finding.advice };
        writeln!(out, "{file}: {}\n    {advice}", finding.problem)?;
    }
    let Checked { maps, files, log_records, findings } = checked;
    let repaired = findings.iter().filter(|finding| finding.is_repaired).count();
    let left = findings.len() - repaired;
    writeln!(out, "{maps} maps, {files} files, {log_records} records of logs: {left} problems, {repaired} repaired")
}

/// Restores a backup to an empty folder.
pub(crate) fn run_restore(backup: &Path, directory: &Path) -> ExitCode {
    let id = match random_id() {
        Ok(id) => id,
        Err(error) => return refuse(&error.to_string(), 1),
    };
    match tidemap_store::restore(backup, directory, &id) {
        Ok(report) => {
            println!("{} maps, {} files, {} bytes", report.maps, report.copied_files, report.copied_bytes);
            ExitCode::SUCCESS
        }
        Err(error @ (BackupError::NotEmpty(_) | BackupError::Open(_))) => refuse(&error.to_string(), 2),
        Err(error) => refuse(&error.to_string(), 1),
    }
}

fn refuse(text: &str, status: u8) -> ExitCode {
    eprintln!("tidemapd: {text}");
    ExitCode::from(status)
}

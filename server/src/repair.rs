//! `tidemapd check DIR` and `tidemapd backup restore BACKUP DIR`: the commands of an operator for folders that no
//! daemon uses.
//!
//! Invariant: the exit status is 0 where everything is sound or done, 1 where something is damaged or not done, and 2
//! where the check is impossible. Results go to stdout, all other output to stderr.

use std::{io::Write, path::Path, process::ExitCode};

use tidemap_base::{
    clock::{Clock as _, SystemClock},
    random_id::random_id,
};
use tidemap_ingest::catalog::try_restore;
use tidemap_model::time::format_rfc3339;
use tidemap_store::{BackupError, Checked, Mode, Outcome, check_with};

/// Checks a data folder, and prints the faults.
pub(crate) fn run_check(directory: &Path, repair: bool, accept_loss: bool) -> ExitCode {
    let mode = match (repair, accept_loss) {
        (_, true) => Mode::AcceptLoss { now_nanos: SystemClock.now_nanos() },
        (true, false) => Mode::Repair,
        (false, false) => Mode::Look,
    };
    let checked = match check_with(directory, mode, &try_restore) {
        Ok(checked) => checked,
        Err(error) => return refuse(&error.to_string(), 2),
    };
    // A reader that goes away is no error.
    let printed = print(&checked, &mut std::io::stdout().lock());
    let is_sound = checked.findings.iter().all(|finding| finding.outcome != Outcome::Open);
    if printed.is_ok() && is_sound { ExitCode::SUCCESS } else { ExitCode::from(1) }
}

fn print(checked: &Checked, out: &mut impl Write) -> std::io::Result<()> {
    let Checked { format, newest_format, store_id, maps, files, log_records, findings, losses } = checked;
    for finding in findings {
        let advice = match finding.outcome {
            Outcome::Open => finding.advice,
            Outcome::Repaired => "repaired",
            Outcome::Accepted => "accepted as lost",
        };
        writeln!(out, "{}: {}\n    {advice}", finding.file.display(), finding.problem)?;
    }
    for loss in losses {
        let at = format_rfc3339(loss.accepted_nanos);
        writeln!(out, "{}: {}\n    accepted as lost on {at}", loss.file, loss.problem)?;
    }
    writeln!(out, "store id {store_id}")?;
    if format < newest_format {
        writeln!(out, "disk format {format}: the next start migrates it to format {newest_format}")?;
    }
    let count = |outcome| findings.iter().filter(|finding| finding.outcome == outcome).count();
    let (left, repaired) = (count(Outcome::Open), count(Outcome::Repaired));
    write!(out, "{maps} maps, {files} files, {log_records} records of logs: {left} problems, {repaired} repaired")?;
    match losses.len() {
        0 => writeln!(out),
        accepted => writeln!(out, ", {accepted} accepted as lost"),
    }
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

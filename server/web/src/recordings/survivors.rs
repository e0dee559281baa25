//! Programs that an earlier daemon started to import, and that are still there.
//!
//! Invariant: a program is ended only if it is `tidemap import` and works in the folder of recordings of this data
//! folder. A program ends with its daemon by itself; this is for a program that could not.

use std::{fs, io, path::Path};

use rustix::{
    io::Errno,
    process::{Pid, Signal, kill_process},
};
use tracing::warn;

/// Ends the programs that work in a folder.
///
/// # Errors
/// A program cannot be ended.
pub(super) fn end_all(folder: &Path) -> io::Result<()> {
    let Ok(folder) = folder.canonicalize() else { return Ok(()) };
    for process in fs::read_dir("/proc")?.filter_map(Result::ok) {
        let pid = process.file_name().to_str().and_then(|name| name.parse().ok()).and_then(Pid::from_raw);
        if let Some(pid) = pid
            && is_import_in(&process.path(), &folder)
        {
            warn!(pid = pid.as_raw_nonzero(), "a program that imports for an earlier daemon is ended");
            match kill_process(pid, Signal::KILL) {
                // The program has ended meanwhile.
                Ok(()) | Err(Errno::SRCH) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }
    Ok(())
}

fn is_import_in(process: &Path, folder: &Path) -> bool {
    // A process of another user cannot be read, and was not started by a daemon of this data folder.
    let Ok(works_in) = fs::read_link(process.join("cwd")) else { return false };
    let arguments = fs::read(process.join("cmdline")).unwrap_or_default();
    let mut arguments = arguments.split(|byte| *byte == 0);
    let program = arguments.next().and_then(|path| path.rsplit(|byte| *byte == b'/').next());
    works_in.starts_with(folder) && program == Some(super::PROGRAM.as_bytes()) && arguments.next() == Some(b"import")
}

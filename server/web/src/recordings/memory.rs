//! The amount of memory that a program may take that reads recordings.
//!
//! Invariant: where the daemon runs in a control group with a limit of memory, such as a container of Kubernetes, the
//! memory of all programs together fits into the memory that the group has left. When the memory of such a group is
//! used up, the kernel ends all its processes, including the daemon.

use std::{
    fs,
    path::{Component, Path, PathBuf},
};

/// Address space of the program, which needs a tenth of it. A hostile file cannot take the daemon's memory.
const PROGRAM_BYTES: u64 = 2 << 30;
/// With less address space the program cannot read a usual recording.
const PROGRAM_BYTES_MIN: u64 = 512 << 20;
/// The memory that the daemon itself may take meanwhile.
const KEPT_BYTES: u64 = 128 << 20;
/// The folder of the control groups.
const GROUPS: &str = "/sys/fs/cgroup";

/// There is too little memory left for one more program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "an import needs {needed} bytes of memory, and this daemon's control group (memory.max of its container) has {left} \
     left, of which {promised} are for other imports: give it more, try again later, or use tidemap import from another \
     machine"
)]
pub(super) struct NoMemory {
    left: u64,
    promised: u64,
    needed: u64,
}

/// The memory that one more program may take. `promised` is the number of bytes that others may take.
///
/// # Errors
/// There is too little memory left.
pub(super) fn for_program(promised: u64) -> Result<u64, NoMemory> {
    let own = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    share_of(left_in(Path::new(GROUPS), &own), promised)
}

fn share_of(left: Option<u64>, promised: u64) -> Result<u64, NoMemory> {
    let Some(left) = left else { return Ok(PROGRAM_BYTES) };
    let free = left.saturating_sub(promised).saturating_sub(KEPT_BYTES);
    if free < PROGRAM_BYTES_MIN {
        return Err(NoMemory { left, promised, needed: PROGRAM_BYTES_MIN + KEPT_BYTES });
    }
    Ok(free.min(PROGRAM_BYTES))
}

/// The memory that the control group of a process, and the groups above it, have left; `None`: no limit. `own` has the
/// groups of the process, in the form of `/proc/PID/cgroup`.
fn left_in(groups: &Path, own: &str) -> Option<u64> {
    // Lines of control groups of version 1 have other numbers.
    let path = own.lines().find_map(|line| line.strip_prefix("0::"))?;
    // If a path leads out of the part that the process sees, its group is the root.
    let below: PathBuf = Path::new(path).components().filter(|part| matches!(part, Component::Normal(_))).collect();
    below.ancestors().filter_map(|group| left_of(&groups.join(group))).min()
}

fn left_of(group: &Path) -> Option<u64> {
    let number = |name: &str| fs::read_to_string(group.join(name)).ok()?.trim().parse::<u64>().ok();
    // The word "max" is no limit.
    let max = number("memory.max")?;
    let current = number("memory.current")?;
    // This is the size of files that were read or written lately, which the kernel drops first.
    let stat = fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
    let dropped = stat.lines().find_map(|line| line.strip_prefix("inactive_file ")?.trim().parse().ok()).unwrap_or(0);
    Some(max.saturating_sub(current.saturating_sub(dropped)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(root: &Path, name: &str, files: [(&str, &str); 3]) {
        let folder = root.join(name);
        fs::create_dir_all(&folder).expect("a folder");
        for (file, text) in files {
            fs::write(folder.join(file), text).expect("written");
        }
    }

    #[test]
    fn the_smallest_rest_of_all_groups_above_counts() {
        let root = tempfile::tempdir().expect("a folder");
        let files = |max, current, stat| [("memory.max", max), ("memory.current", current), ("memory.stat", stat)];
        group(root.path(), "pod", files("1000\n", "900\n", "anon 300\ninactive_file 400\n"));
        group(root.path(), "pod/main", files("max\n", "100\n", ""));
        assert_eq!(left_in(root.path(), "0::/pod/main\n"), Some(500), "the files of the pod are dropped first");
        assert_eq!(left_in(root.path(), "4:memory:/a\n0::/pod\n"), Some(500));
        assert_eq!(left_in(root.path(), "0::/other\n"), None);
        assert_eq!(left_in(root.path(), "4:memory:/pod\n"), None, "of version 1");
        // A container sees its own group as the root.
        group(root.path(), "", files("2000\n", "1900\n", ""));
        assert_eq!(left_in(root.path(), "0::/\n"), Some(100));
        assert_eq!(left_in(root.path(), "0::/pod\n"), Some(100));
    }

    #[test]
    fn programs_share_what_is_left() {
        let least = PROGRAM_BYTES_MIN + KEPT_BYTES;
        assert_eq!(share_of(None, PROGRAM_BYTES).ok(), Some(PROGRAM_BYTES));
        assert_eq!(share_of(Some(100 << 30), 0).ok(), Some(PROGRAM_BYTES));
        assert_eq!(share_of(Some(least), 0).ok(), Some(PROGRAM_BYTES_MIN));
        let refused = share_of(Some(least), 1).expect_err("too little").to_string();
        assert!(refused.contains(&least.to_string()) && refused.contains("tidemap import"), "{refused}");
    }
}

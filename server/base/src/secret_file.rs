//! Checks by the permissions of a file with secrets who may read it.
//!
//! Invariant: it only checks; the reader of the file decides what to do about an open file.

/// Whether only the owner can change or read a file. For files of root, the group may also read, as for secrets that
/// are mounted in containers.
pub(crate) fn is_private(mode: u32, owner: u32) -> bool {
    let of_others = if owner == 0 { 0o037 } else { 0o077 };
    mode & of_others == 0
}

/// Whether everybody on the machine can read or change a file.
pub(crate) fn is_open_to_all(mode: u32) -> bool {
    mode & 0o007 != 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_group_may_read_a_file_of_root_and_of_nobody_else() {
        for (mode, owner, is_fine) in [
            (0o600, 0, true),
            (0o400, 1000, true),
            (0o440, 0, true),
            (0o640, 0, true),
            (0o640, 1000, false),
            (0o660, 0, false),
            (0o604, 0, false),
            (0o610, 0, false),
        ] {
            assert_eq!(is_private(mode, owner), is_fine, "{mode:o} of {owner}");
        }
        assert!(is_open_to_all(0o604) && is_open_to_all(0o644) && !is_open_to_all(0o660));
    }
}

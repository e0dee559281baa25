//! Who may read a file with secrets, by its permissions.
//!
//! Invariant: only looks; what is done about an open file is for its reader to say.

/// Whether nobody but the owner can change a file or read it; of root's files, the group may read, as of secrets that
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

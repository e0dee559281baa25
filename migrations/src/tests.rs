//! What format 2 keeps of format 1.

pub(crate) mod format_1;

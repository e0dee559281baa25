//! Routes against the enumeration of all simple ways, and what is refused.

mod oracle;
mod questions;
mod streets;
mod worlds;

use super::*;

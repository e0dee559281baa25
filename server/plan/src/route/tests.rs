//! Routes against the enumeration of all simple ways, and what is refused.

mod oracle;
mod questions;
mod worlds;

use super::*;

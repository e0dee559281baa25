//! Routes against the enumeration of all simple paths, and refused input.

mod oracle;
mod questions;
mod streets;
mod worlds;

use super::{departure::plan_routes_with, *};

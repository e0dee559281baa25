//! Policies against value iteration over all states, and refused input.

mod oracle;
mod questions;

use super::*;
use crate::route::EdgeForecast;

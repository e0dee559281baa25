//! Policies against value iteration over all states, and what is refused.

mod oracle;
mod questions;

use super::*;
use crate::route::EdgeForecast;

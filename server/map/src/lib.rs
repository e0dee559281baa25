//! Space: the many states of one map. Contains the definition of a map, the way of observations to its states, the
//! update of the states, and the immutable view that queries read.
//!
//! Invariant: no I/O, no clock, no hidden randomness. Every change of a map is an [`event::Event`]; applying the same
//! events in the same order gives the same map, whether they arrive live or are replayed from a log.

pub mod anomaly;
pub mod edge_forecast;
pub mod erasure;
pub mod event;
pub mod history;
pub mod ids;
pub mod interval;
pub mod label_places;
pub mod landmark;
pub mod landmark_forecast;
pub mod live_map;
pub mod live_state;
pub mod name;
pub mod no_go;
pub mod predict;
pub mod reachability;
pub mod report;
pub mod report_sample;
pub mod row_samples;
pub mod sighting;
pub mod site;
pub mod snapshot;
pub mod spec;
pub mod task;
pub mod topology;
pub mod training;
pub mod traversal;
pub mod update;
pub mod view;

mod directory;
mod edge_prior;
mod pending;
mod prior_models;
mod update_worth;

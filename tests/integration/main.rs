//! The daemon from outside, and the rules that hold the work tree together. One binary, so that it links once.

mod bad_input;
mod daemon;
mod durability;
mod exploration;
mod grid;
mod kinds;
mod main_job;
mod model_test;
mod routes;
mod search;
mod tidy;
mod traversals;
mod vectors;

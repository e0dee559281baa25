//! The daemon from outside. One binary, so that it links once.

mod acceptance;
mod alerts;
mod backups;
mod bad_input;
mod crowds;
mod deploy;
mod durability;
mod erasures;
mod evaluation;
mod examples;
mod exploration;
mod floods;
mod grid;
mod json_output;
mod kinds;
mod lifecycle;
mod page;
mod random_operations;
mod reports;
mod routes;
mod search;
mod security;
mod traces;
mod traversals;
mod vectors;
mod web;

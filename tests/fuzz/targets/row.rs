//! Rows of the index and the description of a map.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tidemap_store::fuzz::row(bytes));

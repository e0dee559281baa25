//! The lists of what must exist.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tidemap_store::fuzz::list(bytes));

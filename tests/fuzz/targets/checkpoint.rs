//! A checkpoint, record by record or as it is.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| tidemap_store::fuzz::checkpoint(bytes));

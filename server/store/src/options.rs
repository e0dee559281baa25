//! The options with which a store is opened.
//!
//! Invariant: the defaults are valid; only the identity of a new store must be given.

/// Options of a store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoreOptions {
    /// Length of a log's segment after which a new one is created.
    pub segment_bytes: u64,
    /// Memory that sled may use for the index.
    pub index_cache_bytes: u64,
    /// Approximate memory for the models and sums of each map's tiles; further tiles are read from a checkpoint.
    pub tile_cache_bytes: u64,
    /// Memory for the sums of each map's states; further sums are read from a checkpoint.
    pub spectrum_cache_bytes: u64,
    /// Number of checkpoints of a map that are kept, at least 1.
    pub checkpoints_kept: usize,
    /// Identity of the store if it is created now: 16 random bytes as 32 lower-case hexadecimal digits.
    pub new_store_id: String,
    /// The identity that the store must have. No other store is opened then, and none is created.
    pub expected_store_id: Option<String>,
}

impl Default for StoreOptions {
    fn default() -> Self {
        StoreOptions {
            segment_bytes: 64 << 20,
            index_cache_bytes: 64 << 20,
            tile_cache_bytes: 1 << 30,
            spectrum_cache_bytes: 64 << 20,
            checkpoints_kept: 2,
            new_store_id: String::new(),
            expected_store_id: None,
        }
    }
}

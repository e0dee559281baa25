//! Rows of numbers aligned to cache lines, for vector kernels.
//!
//! Invariant: each row begins at a cache line, so that no vector lies across two, and a row takes an odd number of
//! lines, so that the same positions of many rows do not compete for the same cache sets.

/// Number of values in a cache line, which is 64 bytes.
const LINE: usize = 8;

/// Rows of equal length.
#[derive(Debug)]
pub(crate) struct AlignedRows {
    /// Padding up to the first cache line, then the rows.
    entries: Vec<f64>,
    start: usize,
    stride: usize,
    length: usize,
}

impl AlignedRows {
    /// Rows of zeros.
    pub(crate) fn zeros(rows: usize, length: usize) -> AlignedRows {
        let stride = (length.div_ceil(LINE) | 1) * LINE;
        let entries = vec![0.0_f64; rows * stride + LINE - 1];
        let start = entries.as_ptr().align_offset(LINE * size_of::<f64>()).min(LINE - 1);
        AlignedRows { entries, start, stride, length }
    }

    /// Number of rows.
    pub(crate) fn count(&self) -> usize {
        (self.entries.len() - (LINE - 1)) / self.stride
    }

    /// Heap memory, in bytes.
    pub(crate) fn bytes(&self) -> usize {
        self.entries.capacity() * size_of::<f64>()
    }

    /// Row `i`, which must exist.
    #[inline(always)]
    pub(crate) fn row(&self, i: usize) -> &[f64] {
        &self.entries[self.start + i * self.stride..][..self.length]
    }

    /// Row `i`, which must exist.
    #[inline(always)]
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.entries[self.start + i * self.stride..][..self.length]
    }
}

impl Clone for AlignedRows {
    fn clone(&self) -> AlignedRows {
        let mut clone = AlignedRows::zeros(self.count(), self.length);
        for i in 0..self.count() {
            clone.row_mut(i).copy_from_slice(self.row(i));
        }
        clone
    }
}

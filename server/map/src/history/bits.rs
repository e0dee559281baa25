//! A row with a bit per scan, 64 to a word: runs are filled and compared a word at a time.
//!
//! Invariant: bits beyond the length are 0.

/// A row of bits.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Bits {
    words: Vec<u64>,
    len: usize,
}

impl Bits {
    /// Empties the row and makes room.
    pub(super) fn reset(&mut self, len: usize) {
        self.words.clear();
        self.words.resize(len.div_ceil(64), 0);
        self.len = len;
    }

    /// Fills the row with the value `first`, which changes at each toggle. Toggles beyond the length are ignored.
    pub(super) fn fill(&mut self, len: usize, first: bool, toggles: &[u32]) {
        self.reset(len);
        for &toggle in toggles {
            if let Some(word) = self.words.get_mut(toggle as usize / 64) {
                *word ^= 1 << (toggle % 64);
            }
        }
        // Each bit becomes the parity of the toggles up to it.
        let mut before = if first { u64::MAX } else { 0 };
        for word in &mut self.words {
            for shift in [1, 2, 4, 8, 16, 32] {
                *word ^= *word << shift;
            }
            *word ^= before;
            before = if *word >> 63 == 1 { u64::MAX } else { 0 };
        }
        self.trim();
    }

    /// Sets each bit to whether the value reaches the threshold.
    pub(super) fn fill_reaching(&mut self, values: &[f32], threshold: f32) {
        self.reset(values.len());
        for (word, values) in self.words.iter_mut().zip(values.chunks(64)) {
            // Values are compared in lanes, a byte each; then a multiplication moves the low bit of eight bytes into
            // one.
            let mut reaches = [0_u8; 64];
            for (reaches, &value) in reaches.iter_mut().zip(values) {
                *reaches = u8::from(value >= threshold);
            }
            for (eight, shift) in reaches.as_chunks::<8>().0.iter().zip((0..64).step_by(8)) {
                *word |= (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) << shift;
            }
        }
    }

    fn trim(&mut self) {
        debug_assert_eq!(self.words.len(), self.len.div_ceil(64), "{} bits", self.len);
        let used = self.len % 64;
        if let Some(last) = self.words.last_mut().filter(|_| used > 0) {
            *last &= (1 << used) - 1;
        }
    }

    /// Appends bits `from..to` of another row; bits beyond the length of that row count as 0.
    pub(super) fn append(&mut self, other: &Bits, from: usize, to: usize) {
        let mut at = from;
        while at < to {
            let count = (to - at).min(64 - self.len % 64);
            let word = other.get_64(at) & (u64::MAX >> (64 - count));
            if self.len.is_multiple_of(64) {
                self.words.push(word);
            } else if let Some(last) = self.words.last_mut() {
                *last |= word << (self.len % 64);
            }
            (self.len, at) = (self.len + count, at + count);
        }
    }

    /// The 64 bits from any place on.
    fn get_64(&self, at: usize) -> u64 {
        let word = |index: usize| self.words.get(index).copied().unwrap_or(0);
        match at % 64 {
            0 => word(at / 64),
            shift => word(at / 64) >> shift | word(at / 64 + 1) << (64 - shift),
        }
    }

    /// Makes this row: a bit is set where exactly one of two rows is set, and a third is too.
    pub(super) fn set_differing(&mut self, one: &Bits, other: &Bits, within: &Bits) {
        self.len = within.len;
        self.words.clear();
        let words = one.words.iter().zip(&other.words).zip(&within.words);
        self.words.extend(words.map(|((one, other), within)| (one ^ other) & within));
        self.words.resize(self.len.div_ceil(64), 0);
    }

    /// Number of bits.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Whether a bit is set; false for a bit beyond the length.
    pub(super) fn get(&self, at: usize) -> bool {
        self.words.get(at / 64).is_some_and(|word| word >> (at % 64) & 1 == 1)
    }

    /// The last bit.
    pub(super) fn last(&self) -> bool {
        self.len > 0 && self.get(self.len - 1)
    }

    /// For each word, the bits that differ from the bit before; the first bit of all does not count.
    fn changes(&self) -> impl Iterator<Item = u64> {
        let mut before = u64::from(self.get(0));
        let (last, used) = (self.words.len().saturating_sub(1), self.len % 64);
        self.words.iter().enumerate().map(move |(index, &word)| {
            let changes = word ^ (word << 1 | before);
            before = word >> 63;
            if index == last && used > 0 { changes & ((1 << used) - 1) } else { changes }
        })
    }

    /// The places of the bits that differ from the bit before, ascending.
    pub(super) fn toggles(&self) -> impl Iterator<Item = u32> {
        self.changes().zip(0_u32..).flat_map(|(word, index)| set_bits(word).map(move |bit| index * 64 + bit))
    }

    /// The places of the bits that are set, ascending.
    pub(super) fn ones(&self) -> impl Iterator<Item = u32> {
        self.words.iter().zip(0_u32..).flat_map(|(&word, index)| set_bits(word).map(move |bit| index * 64 + bit))
    }
}

fn set_bits(word: u64) -> impl Iterator<Item = u32> {
    std::iter::successors((word != 0).then_some(word), |rest| {
        let rest = rest & (rest - 1);
        (rest != 0).then_some(rest)
    })
    .map(u64::trailing_zeros)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn bits(values: &[bool]) -> Bits {
        let mut bits = Bits::default();
        let floats: Vec<f32> = values.iter().map(|&value| if value { 0.5 } else { 0.499 }).collect();
        bits.fill_reaching(&floats, 0.5);
        bits
    }

    fn listed(bits: &Bits) -> Vec<bool> {
        (0..bits.len).map(|at| bits.get(at)).collect()
    }

    proptest! {
        #[test]
        fn rows_of_bits_are_rows_of_bits(
            one in proptest::collection::vec(any::<bool>(), 0..300),
            seed in any::<u64>(),
            cuts in proptest::collection::vec(0..300_usize, 0..8),
        ) {
            let row = bits(&one);
            prop_assert_eq!(listed(&row), one.clone());
            prop_assert_eq!(row.last(), one.last().copied().unwrap_or(false));
            prop_assert!(!row.get(one.len()));
            let toggles: Vec<u32> = row.toggles().collect();
            let expected: Vec<u32> = (1..one.len()).filter(|&i| one[i] != one[i - 1]).map(|i| i as u32).collect();
            prop_assert_eq!(&toggles, &expected);
            let ones: Vec<u32> = row.ones().collect();
            prop_assert_eq!(ones, (0..one.len()).filter(|&i| one[i]).map(|i| i as u32).collect::<Vec<_>>());
            let mut again = Bits::default();
            again.fill(one.len(), one.first().copied().unwrap_or(false), &toggles);
            prop_assert_eq!(&again, &row);

            let other: Vec<bool> = (0..one.len()).map(|i| seed.rotate_left(i as u32) & 3 == 1).collect();
            let within: Vec<bool> = (0..one.len()).map(|i| seed.rotate_right(i as u32) & 1 == 1).collect();
            again.set_differing(&row, &bits(&other), &bits(&within));
            let expected: Vec<bool> = (0..one.len()).map(|i| (one[i] != other[i]) && within[i]).collect();
            prop_assert_eq!(listed(&again), expected);

            let mut parts = Bits::default();
            let mut expected = Vec::new();
            for pair in cuts.chunks_exact(2) {
                let (from, to) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
                parts.append(&row, from, to);
                expected.extend((from..to).map(|i| one.get(i).copied().unwrap_or(false)));
            }
            prop_assert_eq!(listed(&parts), expected);
        }
    }
}

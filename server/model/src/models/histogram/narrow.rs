//! Cells of sums in the narrowest numbers that hold them exactly.
//!
//! Most sums are small whole numbers, such as counts of readings of 0 and 1: a byte holds them. Invariant: every number
//! is read back bit by bit; cells that have once become wider stay wide.

/// Cells of `N` sums each.
#[derive(Clone, Debug)]
pub(super) enum Narrow<const N: usize> {
    /// Whole numbers up to 255.
    Bytes(Box<[[u8; N]]>),
    /// Numbers that single precision holds, such as halves and quarters.
    Singles(Box<[[f32; N]]>),
    /// Any numbers.
    Doubles(Box<[[f64; N]]>),
}

fn as_byte(number: f64) -> Option<u8> {
    // Casts saturate. The cast back shows whether the number is held exactly.
    let byte = number as u8;
    (f64::from(byte).to_bits() == number.to_bits()).then_some(byte)
}

fn as_single(number: f64) -> Option<f32> {
    let single = number as f32;
    (f64::from(single).to_bits() == number.to_bits()).then_some(single)
}

/// The cell in other numbers; `None` if one of them is not held exactly.
fn cast<T: Copy + Default, const N: usize>(cell: [f64; N], number: fn(f64) -> Option<T>) -> Option<[T; N]> {
    let mut narrow = [T::default(); N];
    for (narrow, wide) in narrow.iter_mut().zip(cell) {
        *narrow = number(wide)?;
    }
    Some(narrow)
}

impl<const N: usize> Narrow<N> {
    /// Cells of zeros.
    pub(super) fn zeros(len: usize) -> Narrow<N> {
        Narrow::Bytes(vec![[0; N]; len].into())
    }

    /// The given cells, in the narrowest numbers that hold them exactly.
    pub(super) fn of(cells: &[[f64; N]]) -> Narrow<N> {
        let mut narrow = Narrow::zeros(cells.len());
        cells.iter().enumerate().for_each(|(index, &cell)| narrow.set(index, cell));
        narrow
    }

    pub(super) fn len(&self) -> usize {
        match self {
            Narrow::Bytes(cells) => cells.len(),
            Narrow::Singles(cells) => cells.len(),
            Narrow::Doubles(cells) => cells.len(),
        }
    }

    /// The cell at an index; `None` beyond the last.
    #[inline]
    pub(super) fn get(&self, index: usize) -> Option<[f64; N]> {
        match self {
            Narrow::Bytes(cells) => cells.get(index).map(|cell| cell.map(f64::from)),
            Narrow::Singles(cells) => cells.get(index).map(|cell| cell.map(f64::from)),
            Narrow::Doubles(cells) => cells.get(index).copied(),
        }
    }

    /// All cells.
    pub(super) fn iter(&self) -> impl Iterator<Item = [f64; N]> + Clone + '_ {
        (0..self.len()).map_while(|index| self.get(index))
    }

    /// Replaces a cell; an index beyond the last changes nothing.
    pub(super) fn set(&mut self, index: usize, cell: [f64; N]) {
        let is_set = match self {
            Narrow::Bytes(cells) => set(cells, index, cast(cell, as_byte)),
            Narrow::Singles(cells) => set(cells, index, cast(cell, as_single)),
            Narrow::Doubles(cells) => set(cells, index, Some(cell)),
        };
        if !is_set {
            // This happens at most twice: bytes, single, double.
            *self = self.wider(cell);
            self.set(index, cell);
        }
    }

    /// These cells in wider numbers, which can also hold `cell`.
    fn wider(&self, cell: [f64; N]) -> Narrow<N> {
        // Single precision holds every byte, but other numbers need not fit.
        match self {
            Narrow::Bytes(cells) if cast(cell, as_single).is_some() => {
                Narrow::Singles(cells.iter().map(|cell| cell.map(f32::from)).collect())
            }
            _ => Narrow::Doubles(self.iter().collect()),
        }
    }

    /// Changes all cells.
    pub(super) fn change(&mut self, change: impl Fn(&mut [f64; N])) {
        for index in 0..self.len() {
            if let Some(mut cell) = self.get(index) {
                change(&mut cell);
                self.set(index, cell);
            }
        }
    }
}

fn set<T, const N: usize>(cells: &mut [[T; N]], index: usize, cell: Option<[T; N]>) -> bool {
    match (cells.get_mut(index), cell) {
        (Some(place), Some(cell)) => *place = cell,
        (Some(_), None) => return false,
        (None, _) => {}
    }
    true
}

impl<const N: usize> PartialEq for Narrow<N> {
    /// Whether the numbers are equal, whatever their width.
    fn eq(&self, other: &Narrow<N>) -> bool {
        self.len() == other.len() && self.iter().eq(other.iter())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn number() -> impl Strategy<Value = f64> {
        let whole = (0..300u16).prop_map(f64::from);
        prop_oneof![whole, (0..64u8).prop_map(|quarters| f64::from(quarters) / 4.0), any::<f64>(), Just(-0.0)]
    }

    proptest! {
        #[test]
        fn every_bit_comes_back(sets in prop::collection::vec((0..5usize, [number(), number()]), 0..40)) {
            let (mut narrow, mut plain) = (Narrow::zeros(5), [[0.0f64; 2]; 5]);
            for (index, cell) in sets {
                narrow.set(index, cell);
                plain[index] = cell;
                let read: Vec<[u64; 2]> = narrow.iter().map(|cell| cell.map(f64::to_bits)).collect();
                prop_assert_eq!(read, plain.map(|cell| cell.map(f64::to_bits)).to_vec());
            }
        }
    }

    #[test]
    fn counts_take_a_byte_each_and_halves_four() {
        assert!(matches!(Narrow::of(&[[255.0, 0.0]]), Narrow::Bytes(_)));
        assert!(matches!(Narrow::of(&[[256.0, 0.5]]), Narrow::Singles(_)));
        assert!(matches!(Narrow::of(&[[1.0, 1.0 / 3.0]]), Narrow::Doubles(_)));
    }
}

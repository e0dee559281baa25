//! The stored fields of learned states. Each type has one list of its fields, which a writer and a reader visit.
//!
//! A field has a tag, which is its number on the disk, and a name for errors. `tidemap-store` has the two visitors.
//! Invariant: a number that a reader accepts lies in the range of its field; a writer accepts every value.

use std::ops::RangeInclusive;

use crate::{InvalidParts, LocalDay};

/// Every finite number.
pub const FINITE: RangeInclusive<f64> = f64::MIN..=f64::MAX;
/// Every finite number from 0 on.
pub const NOT_NEGATIVE: RangeInclusive<f64> = 0.0..=f64::MAX;

/// A type that is stored as a message of fields.
pub trait StoredFields {
    /// Visits all fields in the order of their tags. A reader replaces them, a writer leaves them as they are.
    ///
    /// # Errors
    /// What the visitor returns: a reader refuses a field of another form or length, or outside its range.
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused>;

    /// Checks how fields depend on each other, and computes what follows from them, after a reader has visited them.
    ///
    /// # Errors
    /// [`InvalidParts`] where fields contradict each other.
    fn finish(&mut self) -> Result<(), InvalidParts> {
        Ok(())
    }
}

impl<T: StoredFields> StoredFields for Box<T> {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        T::fields(self, visitor)
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        T::finish(self)
    }
}

/// A reading: UTC nanoseconds and value.
impl StoredFields for (i64, f64) {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "time of a reading", &mut self.0)?;
        visitor.number(2, "value of a reading", FINITE, &mut self.1)
    }
}

/// A writer or a reader of fields.
pub trait Visitor {
    /// The reason for which a field is refused; a writer has none.
    type Refused;

    /// Visits one value, which must lie in `range` if it is a floating-point number. A value that is not optional and
    /// is 0 is not written.
    ///
    /// # Errors
    /// A reader refuses another form, or a number outside the range.
    fn number<S: StoredScalar>(
        &mut self,
        tag: u32,
        name: &'static str,
        range: RangeInclusive<f64>,
        value: &mut S,
    ) -> Result<(), Self::Refused>;

    /// Visits a list of integers.
    ///
    /// # Errors
    /// A reader refuses another form, another length, or an integer outside its type.
    fn integers<S: StoredScalar>(
        &mut self,
        tag: u32,
        name: &'static str,
        slots: &mut impl Slots<S>,
    ) -> Result<(), Self::Refused>;

    /// Visits lists of fixed lengths, which are stored one behind the other.
    ///
    /// # Errors
    /// A reader refuses another length, or a number outside the range.
    fn lists<P: Packed>(
        &mut self,
        tag: u32,
        name: &'static str,
        range: RangeInclusive<f64>,
        lists: &mut [&mut [P]],
    ) -> Result<(), Self::Refused>;

    /// Visits elements of equal size.
    ///
    /// # Errors
    /// A reader refuses an incomplete element, another number of elements, or a number outside the range.
    fn list<P: Packed>(
        &mut self,
        tag: u32,
        name: &'static str,
        range: RangeInclusive<f64>,
        slots: &mut impl Slots<P>,
    ) -> Result<(), Self::Refused>;

    /// Visits messages: each of a list, or an optional one.
    ///
    /// # Errors
    /// A reader refuses another number of messages, and what a message refuses.
    fn messages<T: StoredFields + Default>(
        &mut self,
        tag: u32,
        name: &'static str,
        slots: &mut impl Slots<T>,
    ) -> Result<(), Self::Refused>;

    /// Runs `check` where a reader has visited fields, and returns its value; a writer returns `None`.
    ///
    /// # Errors
    /// What `check` refuses.
    fn accept<T>(&mut self, check: impl FnOnce() -> Result<T, InvalidParts>) -> Result<Option<T>, Self::Refused>;

    /// Visits an integer, a day or a flag.
    ///
    /// # Errors
    /// A reader refuses another form, or an integer outside its type.
    fn integer<S: StoredScalar>(&mut self, tag: u32, name: &'static str, value: &mut S) -> Result<(), Self::Refused> {
        self.number(tag, name, FINITE, value)
    }

    /// Visits a value that is stored in another form: `elements` gives its elements of equal size, `read` takes them.
    ///
    /// # Errors
    /// A reader refuses an incomplete element, and what `read` refuses.
    fn converted<T, P: Packed>(
        &mut self,
        tag: u32,
        name: &'static str,
        value: &mut T,
        elements: impl FnOnce(&T) -> Vec<P>,
        read: impl FnOnce(Vec<P>) -> Result<T, InvalidParts>,
    ) -> Result<(), Self::Refused> {
        let mut list = elements(value);
        self.list(tag, name, FINITE, &mut list)?;
        if let Some(found) = self.accept(|| read(list))? {
            *value = found;
        }
        Ok(())
    }
}

/// The form of a single value on the disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A varint.
    Varint,
    /// Four bytes.
    Single,
    /// Eight bytes.
    Double,
}

/// A single value: an integer, a day, a flag, a floating-point number, or an optional one of these.
pub trait StoredScalar: Sized {
    /// The form of the value.
    const FORM: Form;
    /// Whether a value of 0 is written.
    const IS_OPTIONAL: bool = false;

    /// The stored bits; `None` for an absent optional value.
    fn bits(&self) -> Option<u64>;

    /// The value of stored bits, where `None` is an absent field; `None` if no value has these bits.
    fn of_bits(bits: Option<u64>) -> Option<Self>;

    /// The number that must lie in the range of the field; `None` for a value without a range.
    fn ranged(&self) -> Option<f64> {
        None
    }
}

/// A value of a fixed number of bytes, little-endian.
pub trait Packed: Sized {
    /// The number of bytes.
    const BYTES: usize;

    /// Appends the bytes.
    fn put(&self, bytes: &mut Vec<u8>);

    /// Reads the value from [`Packed::BYTES`] bytes.
    fn take(bytes: &[u8]) -> Self;

    /// Refuses floating-point numbers outside a range.
    ///
    /// # Errors
    /// [`InvalidParts::OutOfRange`] with the first such number.
    fn check(&self, _name: &'static str, _range: &RangeInclusive<f64>) -> Result<(), InvalidParts> {
        Ok(())
    }
}

/// The places of a list: an array has a fixed number of them, an option at most one.
pub trait Slots<T> {
    /// The elements.
    fn all(&mut self) -> &mut [T];

    /// Replaces the elements; `false` if their number does not fit.
    fn fill(&mut self, elements: Vec<T>) -> bool;
}

impl<T> Slots<T> for Vec<T> {
    fn all(&mut self) -> &mut [T] {
        self
    }

    fn fill(&mut self, elements: Vec<T>) -> bool {
        *self = elements;
        true
    }
}

impl<T, const N: usize> Slots<T> for [T; N] {
    fn all(&mut self) -> &mut [T] {
        self
    }

    fn fill(&mut self, elements: Vec<T>) -> bool {
        let elements = elements.try_into().map(|elements| *self = elements);
        elements.is_ok()
    }
}

impl<T> Slots<T> for Option<T> {
    fn all(&mut self) -> &mut [T] {
        self.as_mut_slice()
    }

    fn fill(&mut self, mut elements: Vec<T>) -> bool {
        *self = elements.pop();
        elements.is_empty()
    }
}

impl<P: Packed, const N: usize> Packed for [P; N] {
    const BYTES: usize = N * P::BYTES;

    fn put(&self, bytes: &mut Vec<u8>) {
        self.iter().for_each(|element| element.put(bytes));
    }

    fn take(bytes: &[u8]) -> [P; N] {
        std::array::from_fn(|at| P::take(bytes.get(at * P::BYTES..(at + 1) * P::BYTES).unwrap_or_default()))
    }

    fn check(&self, name: &'static str, range: &RangeInclusive<f64>) -> Result<(), InvalidParts> {
        self.iter().try_for_each(|element| element.check(name, range))
    }
}

/// Implements [`Packed`] for numbers; `$ranged`: whether they have a range.
macro_rules! packed {
    ($($number:ty, $ranged:literal;)*) => {$(
        impl Packed for $number {
            const BYTES: usize = size_of::<$number>();

            // Inlined in the visitors of another crate: states have thousands of numbers.
            #[inline]
            fn put(&self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }

            #[inline]
            fn take(bytes: &[u8]) -> $number {
                bytes.first_chunk().map_or_else(<$number>::default, |bytes| <$number>::from_le_bytes(*bytes))
            }

            #[inline]
            fn check(&self, name: &'static str, range: &RangeInclusive<f64>) -> Result<(), InvalidParts> {
                if $ranged { InvalidParts::check(name, *self as f64, range.clone()) } else { Ok(()) }
            }
        }
    )*};
}

packed! {
    f32, true;
    f64, true;
    i64, false;
    u16, false;
    u32, false;
    u64, false;
    u8, false;
    i8, false;
}

/// Implements [`StoredScalar`] for types in one form; `$from` gives `None` for bits that no value has.
macro_rules! scalar {
    ($($value:ty, $form:ident, $bits:expr, $from:expr;)*) => {$(
        impl StoredScalar for $value {
            const FORM: Form = Form::$form;

            fn bits(&self) -> Option<u64> {
                Some($bits(*self))
            }

            fn of_bits(bits: Option<u64>) -> Option<$value> {
                $from(bits.unwrap_or(0))
            }
        }
    )*};
}

/// The zigzag form of protocol buffers, in which numbers near 0 are short.
const fn zigzag(number: i64) -> u64 {
    ((number << 1) ^ (number >> 63)).cast_unsigned()
}

const fn of_zigzag(bits: u64) -> i64 {
    (bits >> 1).cast_signed() ^ -(bits & 1).cast_signed()
}

// As in protocol buffers, integers of 32 bits are the lower bits of what is read.
scalar! {
    bool, Varint, u64::from, |bits| Some(bits != 0);
    u8, Varint, u64::from, |bits| u8::try_from(bits as u32).ok();
    u32, Varint, u64::from, |bits| Some(bits as u32);
    u64, Varint, u64::from, Some;
    i64, Varint, zigzag, |bits| Some(of_zigzag(bits));
    i32, Varint, |number: i32| zigzag(number.into()), |bits| Some(of_zigzag(bits & 0xFFFF_FFFF) as i32);
    LocalDay, Varint, |day: LocalDay| zigzag(day.0.into()), |bits| Some(LocalDay(of_zigzag(bits & 0xFFFF_FFFF) as i32));
}

/// Implements [`StoredScalar`] for floating-point numbers.
macro_rules! float {
    ($($number:ty, $form:ident, $bits:ty;)*) => {$(
        impl StoredScalar for $number {
            const FORM: Form = Form::$form;

            fn bits(&self) -> Option<u64> {
                Some(self.to_bits().into())
            }

            fn of_bits(bits: Option<u64>) -> Option<$number> {
                <$bits>::try_from(bits.unwrap_or(0)).ok().map(<$number>::from_bits)
            }

            fn ranged(&self) -> Option<f64> {
                Some((*self).into())
            }
        }
    )*};
}

float! {
    f32, Single, u32;
    f64, Double, u64;
}

impl<S: StoredScalar> StoredScalar for Option<S> {
    const FORM: Form = S::FORM;
    const IS_OPTIONAL: bool = true;

    fn bits(&self) -> Option<u64> {
        self.as_ref().and_then(S::bits)
    }

    fn of_bits(bits: Option<u64>) -> Option<Option<S>> {
        bits.map_or(Some(None), |bits| S::of_bits(Some(bits)).map(Some))
    }

    fn ranged(&self) -> Option<f64> {
        self.as_ref().and_then(S::ranged)
    }
}

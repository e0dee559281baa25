//! Learned states as protocol buffer messages, and back: the writer and the reader of their fields.
//!
//! A list of numbers is one field of bytes, as a packed list is. A value of 0 and an empty list are not written.
//! Invariant: every number is read back bit by bit. The reader skips fields with unknown tags; of two fields with one
//! tag it takes the later.

use std::{convert::Infallible, ops::RangeInclusive, slice::ChunksExact};

use prost::encoding::{
    DecodeContext, WireType, decode_key, decode_varint, encode_key, encode_varint, encoded_len_varint, skip_field,
};
use tidemap_model::{
    InvalidParts,
    fields::{Form, Packed, Slots, StoredFields, StoredScalar, Visitor},
};

/// The message of a learned state.
pub(crate) fn write(mut state: impl StoredFields) -> Vec<u8> {
    let mut writer = FieldWriter { out: Vec::new() };
    let Ok(()) = state.fields(&mut writer);
    writer.out
}

/// The learned state of a message. `empty`: a state without any data.
///
/// # Errors
/// [`InvalidParts`] where the message or a number in it is not valid.
pub(crate) fn read<T: StoredFields>(empty: T, message: &[u8]) -> Result<T, InvalidParts> {
    read_as("a learned state", empty, message)
}

/// Appends a field of elements of equal size to a message that does not have it.
pub(crate) fn append_list<P: Packed>(message: &mut Vec<u8>, tag: u32, elements: &[P]) {
    let mut writer = FieldWriter { out: std::mem::take(message) };
    writer.bytes(tag, elements.len() * P::BYTES, |out| elements.iter().for_each(|element| element.put(out)));
    *message = writer.out;
}

/// The bytes of elements of equal size.
pub(crate) fn pack<P: Packed>(elements: &[P]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(elements.len() * P::BYTES);
    elements.iter().for_each(|element| element.put(&mut bytes));
    bytes
}

/// The elements of equal size of some bytes.
///
/// # Errors
/// [`InvalidParts::Bytes`] where the last element is not complete.
pub(crate) fn unpack<P: Packed>(name: &'static str, bytes: &[u8]) -> Result<Vec<P>, InvalidParts> {
    Ok(elements_of::<P>(name, bytes)?.map(P::take).collect())
}

fn elements_of<'a, P: Packed>(name: &'static str, bytes: &'a [u8]) -> Result<ChunksExact<'a, u8>, InvalidParts> {
    let elements = bytes.chunks_exact(P::BYTES.max(1));
    if elements.remainder().is_empty() { Ok(elements) } else { Err(InvalidParts::Bytes { field: name }) }
}

fn read_as<T: StoredFields>(name: &'static str, mut state: T, message: &[u8]) -> Result<T, InvalidParts> {
    state.fields(&mut FieldReader::new(name, message)?)?;
    state.finish()?;
    Ok(state)
}

/// Appends the fields that it visits.
struct FieldWriter {
    out: Vec<u8>,
}

impl FieldWriter {
    /// Appends a field of bytes, whose number is known; nothing if there are none.
    fn bytes(&mut self, tag: u32, length: usize, put: impl FnOnce(&mut Vec<u8>)) {
        if length > 0 {
            encode_key(tag, WireType::LengthDelimited, &mut self.out);
            encode_varint(length as u64, &mut self.out);
            self.out.reserve(length);
            put(&mut self.out);
        }
    }
}

impl Visitor for FieldWriter {
    type Refused = Infallible;

    fn number<S: StoredScalar>(
        &mut self,
        tag: u32,
        _name: &'static str,
        _range: RangeInclusive<f64>,
        value: &mut S,
    ) -> Result<(), Infallible> {
        let Some(bits) = value.bits().filter(|&bits| bits != 0 || S::IS_OPTIONAL) else { return Ok(()) };
        encode_key(tag, wire_type(S::FORM), &mut self.out);
        match S::FORM {
            Form::Varint => encode_varint(bits, &mut self.out),
            Form::Single => (bits as u32).put(&mut self.out),
            Form::Double => bits.put(&mut self.out),
        }
        Ok(())
    }

    fn integers<S: StoredScalar>(
        &mut self,
        tag: u32,
        _name: &'static str,
        slots: &mut impl Slots<S>,
    ) -> Result<(), Infallible> {
        let all = slots.all();
        let bits = || all.iter().filter_map(S::bits);
        self.bytes(tag, bits().map(encoded_len_varint).sum(), |out| bits().for_each(|bits| encode_varint(bits, out)));
        Ok(())
    }

    fn list<P: Packed>(
        &mut self,
        tag: u32,
        _name: &'static str,
        _range: RangeInclusive<f64>,
        slots: &mut impl Slots<P>,
    ) -> Result<(), Infallible> {
        let list = slots.all();
        self.bytes(tag, list.len() * P::BYTES, |out| list.iter().for_each(|element| element.put(out)));
        Ok(())
    }

    fn lists<P: Packed>(
        &mut self,
        tag: u32,
        _name: &'static str,
        _range: RangeInclusive<f64>,
        lists: &mut [&mut [P]],
    ) -> Result<(), Infallible> {
        let length: usize = lists.iter().map(|list| list.len() * P::BYTES).sum();
        self.bytes(tag, length, |out| lists.iter().flat_map(|list| list.iter()).for_each(|element| element.put(out)));
        Ok(())
    }

    fn messages<T: StoredFields + Default>(
        &mut self,
        tag: u32,
        _name: &'static str,
        slots: &mut impl Slots<T>,
    ) -> Result<(), Infallible> {
        for message in slots.all() {
            let mut inner = FieldWriter { out: Vec::new() };
            message.fields(&mut inner)?;
            encode_key(tag, WireType::LengthDelimited, &mut self.out);
            encode_varint(inner.out.len() as u64, &mut self.out);
            self.out.append(&mut inner.out);
        }
        Ok(())
    }

    fn accept<T>(&mut self, _check: impl FnOnce() -> Result<T, InvalidParts>) -> Result<Option<T>, Infallible> {
        Ok(None)
    }
}

/// Replaces the fields that it visits by those of a message.
struct FieldReader<'a> {
    /// The fields in the order of the message: tag, form, and bytes without their number.
    fields: Vec<(u32, WireType, &'a [u8])>,
}

impl<'a> FieldReader<'a> {
    fn new(name: &'static str, message: &'a [u8]) -> Result<FieldReader<'a>, InvalidParts> {
        let mut fields = Vec::new();
        let mut rest = message;
        while !rest.is_empty() {
            fields.push(next_field(&mut rest).ok_or(InvalidParts::Bytes { field: name })?);
        }
        Ok(FieldReader { fields })
    }

    /// The bytes of a field; `None` if it is absent.
    fn find(&self, tag: u32, form: WireType, name: &'static str) -> Result<Option<&'a [u8]>, InvalidParts> {
        match self.fields.iter().rfind(|field| field.0 == tag) {
            Some(&(_, found, bytes)) if found == form => Ok(Some(bytes)),
            Some(_) => Err(InvalidParts::Bytes { field: name }),
            None => Ok(None),
        }
    }

    /// The bytes of the elements of a list.
    fn elements<P: Packed>(&self, tag: u32, name: &'static str) -> Result<ChunksExact<'a, u8>, InvalidParts> {
        elements_of::<P>(name, self.find(tag, WireType::LengthDelimited, name)?.unwrap_or_default())
    }
}

impl Visitor for FieldReader<'_> {
    type Refused = InvalidParts;

    fn number<S: StoredScalar>(
        &mut self,
        tag: u32,
        name: &'static str,
        range: RangeInclusive<f64>,
        value: &mut S,
    ) -> Result<(), InvalidParts> {
        let bits = match self.find(tag, wire_type(S::FORM), name)? {
            Some(mut bytes) => Some(match S::FORM {
                Form::Varint => decode_varint(&mut bytes).map_err(|_| InvalidParts::Bytes { field: name })?,
                Form::Single => u32::take(bytes).into(),
                Form::Double => u64::take(bytes),
            }),
            None => None,
        };
        *value = S::of_bits(bits).ok_or(InvalidParts::Bytes { field: name })?;
        value.ranged().map_or(Ok(()), |number| number.check(name, &range))
    }

    fn integers<S: StoredScalar>(
        &mut self,
        tag: u32,
        name: &'static str,
        slots: &mut impl Slots<S>,
    ) -> Result<(), InvalidParts> {
        let mut rest = self.find(tag, WireType::LengthDelimited, name)?.unwrap_or_default();
        let mut integers = Vec::new();
        while !rest.is_empty() {
            let integer = decode_varint(&mut rest).ok().and_then(|bits| S::of_bits(Some(bits)));
            integers.push(integer.ok_or(InvalidParts::Bytes { field: name })?);
        }
        fill(name, slots, integers)
    }

    fn list<P: Packed>(
        &mut self,
        tag: u32,
        name: &'static str,
        range: RangeInclusive<f64>,
        slots: &mut impl Slots<P>,
    ) -> Result<(), InvalidParts> {
        let list: Vec<P> = self.elements::<P>(tag, name)?.map(P::take).collect();
        list.iter().try_for_each(|element| element.check(name, &range))?;
        fill(name, slots, list)
    }

    fn lists<P: Packed>(
        &mut self,
        tag: u32,
        name: &'static str,
        range: RangeInclusive<f64>,
        lists: &mut [&mut [P]],
    ) -> Result<(), InvalidParts> {
        let elements = self.elements::<P>(tag, name)?;
        if elements.len() != lists.iter().map(|list| list.len()).sum::<usize>() {
            return Err(InvalidParts::OutOfRange { field: name, found: elements.len() as f64 });
        }
        for (place, bytes) in lists.iter_mut().flat_map(|list| list.iter_mut()).zip(elements) {
            *place = P::take(bytes);
            place.check(name, &range)?;
        }
        Ok(())
    }

    fn messages<T: StoredFields + Default>(
        &mut self,
        tag: u32,
        name: &'static str,
        slots: &mut impl Slots<T>,
    ) -> Result<(), InvalidParts> {
        let found = self.fields.iter().filter(|field| field.0 == tag);
        let message = |&(_, form, bytes): &(u32, WireType, &[u8])| {
            if form == WireType::LengthDelimited {
                read_as(name, T::default(), bytes)
            } else {
                Err(InvalidParts::Bytes { field: name })
            }
        };
        let messages = found.map(message).collect::<Result<Vec<T>, InvalidParts>>()?;
        fill(name, slots, messages)
    }

    fn accept<T>(&mut self, check: impl FnOnce() -> Result<T, InvalidParts>) -> Result<Option<T>, InvalidParts> {
        check().map(Some)
    }
}

fn wire_type(form: Form) -> WireType {
    match form {
        Form::Varint => WireType::Varint,
        Form::Single => WireType::ThirtyTwoBit,
        Form::Double => WireType::SixtyFourBit,
    }
}

fn fill<T>(name: &'static str, slots: &mut impl Slots<T>, elements: Vec<T>) -> Result<(), InvalidParts> {
    let found = elements.len() as f64;
    if slots.fill(elements) { Ok(()) } else { Err(InvalidParts::OutOfRange { field: name, found }) }
}

/// The next field of a message; `None` where the bytes are no field.
fn next_field<'a>(rest: &mut &'a [u8]) -> Option<(u32, WireType, &'a [u8])> {
    let (tag, form) = decode_key(rest).ok()?;
    let begin = *rest;
    skip_field(form, tag, rest, DecodeContext::default()).ok()?;
    let mut bytes = begin.get(..begin.len() - rest.len())?;
    if form == WireType::LengthDelimited {
        decode_varint(&mut bytes).ok()?;
    }
    Some((tag, form, bytes))
}

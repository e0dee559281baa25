//! Every repeated field of a request has a bound, and the bounds hold for whatever way elements are spread.

use std::collections::BTreeSet;

use prost::{Message as _, Name as _};
use prost_types::{FileDescriptorSet, MethodDescriptorProto};

use super::*;
use crate::v1;

/// The repeated fields that requests can hold.
fn repeated_fields() -> BTreeSet<String> {
    let set = FileDescriptorSet::decode(DESCRIPTORS).expect("the descriptors");
    let mut described = Vec::new();
    for file in &set.file {
        file.message_type.iter().for_each(|message| describe(file.package(), message, &mut described));
    }
    let methods = set.file.iter().flat_map(|file| &file.service).flat_map(|service| &service.method);
    let mut names: Vec<String> =
        methods.map(MethodDescriptorProto::input_type).map(|name| name[1..].to_owned()).collect();
    let (mut seen, mut fields) = (BTreeSet::new(), BTreeSet::new());
    while let Some(name) = names.pop() {
        let Some((_, message)) = described.iter().find(|(described, _)| *described == name) else { continue };
        if !seen.insert(name.clone()) {
            continue;
        }
        for field in &message.field {
            if field.label() == Label::Repeated {
                fields.insert(format!("{}.{}", name.trim_start_matches("tidemap.v1."), field.name()));
            }
            names.push(field.type_name().trim_start_matches('.').to_owned());
        }
    }
    fields
}

#[test]
fn every_repeated_field_of_a_request_has_a_bound_and_no_bound_is_left_over() {
    let bounded: BTreeSet<String> = BOUNDS.iter().map(|(name, _)| (*name).to_owned()).collect();
    let fields = repeated_fields();
    assert!(fields.len() > 30, "{fields:?}");
    let missing: Vec<_> = fields.difference(&bounded).collect();
    let unknown: Vec<_> = bounded.difference(&fields).collect();
    assert!(missing.is_empty() && unknown.is_empty(), "without a bound: {missing:#?}; not in a request: {unknown:#?}");
}

/// A request that holds `count` elements of a field, each empty, through the messages that lead to it: written by the
/// descriptors, so that a new field is tested as well.
fn encoded(path: &[u32], is_packed: Option<Element>, count: usize) -> Vec<u8> {
    let Some((&number, inner)) = path.split_first() else { return Vec::new() };
    let mut bytes = Vec::new();
    if inner.is_empty() {
        match is_packed {
            Some(Element::Fixed(width)) => put(&mut bytes, number, &vec![0; width * count]),
            Some(Element::Varint) => put(&mut bytes, number, &vec![0; count]),
            _ => (0..count).for_each(|_| put(&mut bytes, number, &[])),
        }
    } else {
        put(&mut bytes, number, &encoded(inner, is_packed, count));
    }
    bytes
}

fn put(bytes: &mut Vec<u8>, number: u32, payload: &[u8]) {
    prost::encoding::encode_key(number, WireType::LengthDelimited, bytes);
    prost::encoding::encode_varint(payload.len() as u64, bytes);
    bytes.extend_from_slice(payload);
}

/// Paths of field numbers from a message to each bounded field.
fn paths(message: usize, path: &mut Vec<u32>, found: &mut Vec<(Vec<u32>, Bound, Element)>) {
    if path.len() > 6 {
        return;
    }
    for (&number, field) in &ALL.messages[message] {
        path.push(number);
        if let Some(bound) = field.bound {
            found.push((path.clone(), bound, field.element));
        }
        if let Some(inner) = field.message {
            paths(inner, path, found);
        }
        path.pop();
    }
}

#[test]
fn each_bound_holds_for_every_request_that_holds_the_field() {
    let set = FileDescriptorSet::decode(DESCRIPTORS).expect("the descriptors");
    let methods = set.file.iter().flat_map(|file| &file.service).flat_map(|service| &service.method);
    let mut tested = BTreeSet::new();
    for method in methods {
        let name = &method.input_type()[1..];
        let Some(&message) = ALL.by_name.get(name) else { continue };
        let mut found = Vec::new();
        paths(message, &mut Vec::new(), &mut found);
        for (path, bound, element) in found {
            assert_eq!(check(name, &encoded(&path, Some(element), bound.max)), Ok(()), "{name}: {}", bound.name);
            let refusal = TooManyElements { field: bound.name, max: bound.max };
            assert_eq!(check(name, &encoded(&path, Some(element), bound.max + 1)), Err(refusal), "{name}");
            tested.insert(bound.name);
        }
    }
    assert_eq!(tested.len(), BOUNDS.len());
}

#[test]
fn elements_that_are_spread_over_parts_count_together() {
    let name = v1::PredictStatesRequest::full_name();
    let times = |count: usize| v1::PredictStatesRequest { times_nanos: vec![0; count], ..Default::default() };
    let mut parts = times(TIMES / 2).encode_to_vec();
    parts.extend(times(TIMES / 2).encode_to_vec());
    assert_eq!(check(&name, &parts), Ok(()));
    parts.extend(times(1).encode_to_vec());
    let refusal = check(&name, &parts).expect_err("one too many").to_string();
    assert_eq!(
        refusal,
        "PredictStatesRequest.times_nanos: more than 131072 elements in one request: send several requests"
    );
}

#[test]
fn bytes_that_are_no_message_are_left_to_the_decoder() {
    for bytes in [&[0xff; 20][..], &[0x0a, 0x05, 0x01], &[0x0b], &[0x0d, 1], &[]] {
        assert_eq!(check(&v1::PredictStatesRequest::full_name(), bytes), Ok(()));
    }
}

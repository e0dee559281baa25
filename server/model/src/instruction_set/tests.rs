//! Tests the properties of `instruction_set.rs`.

use super::*;

#[test]
fn the_best_is_used_until_another_is_chosen() {
    let best = InstructionSet::available().last().unwrap();
    assert_eq!(InstructionSet::in_use(), best);
    for set in InstructionSet::available() {
        set.choose().unwrap();
        assert_eq!(InstructionSet::in_use(), set);
    }
    assert!(InstructionSet::available().any(|set| set == InstructionSet::Scalar));
}

#[test]
fn what_the_processor_cannot_run_is_refused_with_what_it_can() {
    let cannot = InstructionSet::ALL.into_iter().find(|set| set.arch().is_none()).unwrap();
    let error = cannot.check().unwrap_err().to_string();
    assert!(error.starts_with(&format!("this processor cannot run {cannot}: it can run scalar")), "{error}");
    assert_eq!(cannot.choose().unwrap_err().to_string(), error);
}

#[test]
fn a_set_is_found_by_its_name() {
    for set in InstructionSet::ALL {
        assert_eq!(InstructionSet::named(&set.to_string()), Some(set));
    }
    assert_eq!(InstructionSet::named("sse2"), None);
}

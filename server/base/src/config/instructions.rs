//! The setting `instruction_set`: which vector instructions the kernels of the models use.
//!
//! Invariant: every set that passes the check can run on this processor.

use anyhow::bail;
use tidemap_model::InstructionSet;

/// The value for the best set that the processor has.
pub(super) const BEST: &str = "best";

/// The chosen set; `None`: the best.
///
/// # Errors
/// There is no such set, or this processor cannot run it.
pub(super) fn chosen(setting: &str) -> anyhow::Result<Option<InstructionSet>> {
    if setting == BEST {
        return Ok(None);
    }
    let Some(set) = InstructionSet::named(setting) else {
        let names: Vec<&str> = InstructionSet::ALL.into_iter().map(InstructionSet::name).collect();
        bail!("setting instruction_set is {setting:?}: it must be {BEST}, or one of {}", names.join(", "));
    };
    if let Err(error) = set.check() {
        bail!("setting instruction_set is {setting:?}, and {error}");
    }
    Ok(Some(set))
}

/// Makes the kernels of this process use the chosen set.
///
/// # Errors
/// See [`chosen`].
pub fn apply(setting: &str) -> anyhow::Result<()> {
    if let Some(set) = chosen(setting)? {
        set.choose()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_is_chosen_by_its_name_where_the_processor_can_run_it() {
        assert_eq!(chosen("best").expect("always"), None);
        assert_eq!(chosen("scalar").expect("always"), Some(InstructionSet::Scalar));
        let unknown = chosen("sse2").expect_err("not one of ours").to_string();
        assert!(unknown.contains("instruction_set") && unknown.contains("avx512"), "{unknown}");
        for set in InstructionSet::ALL {
            let can = InstructionSet::available().any(|available| available == set);
            match chosen(set.name()) {
                Ok(found) => assert!(can && found == Some(set)),
                Err(error) => assert!(!can && error.to_string().contains("it can run scalar"), "{error}"),
            }
        }
    }
}

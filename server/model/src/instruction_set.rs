//! Which vector instructions the kernels use: the best that the processor has, unless another set is chosen.
//!
//! Invariant: kernels give equal bits with each set, so that a choice changes their speed alone.

use std::{
    fmt,
    sync::atomic::{AtomicU8, Ordering},
};

use pulp::Arch;

#[cfg(test)]
mod tests;

/// The place of the chosen set in [`InstructionSet::ALL`], plus one; 0: the best.
static CHOSEN: AtomicU8 = AtomicU8::new(0);

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InstructionSet {
    /// One number at a time; available on every processor.
    Scalar,
    /// Two numbers at a time, on ARM.
    Neon,
    /// Four numbers at a time, with fused multiply-add.
    Avx2,
    /// Eight numbers at a time.
    Avx512,
}

/// The processor does not have the instructions.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("this processor cannot run {0}: it can run {available}", available = Listed)]
pub struct NoSuchInstructions(InstructionSet);

impl InstructionSet {
    /// All sets, the best last.
    pub const ALL: [InstructionSet; 4] =
        [InstructionSet::Scalar, InstructionSet::Neon, InstructionSet::Avx2, InstructionSet::Avx512];

    /// The name of the set in options.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            InstructionSet::Scalar => "scalar",
            InstructionSet::Neon => "neon",
            InstructionSet::Avx2 => "avx2",
            InstructionSet::Avx512 => "avx512",
        }
    }

    /// The set of this name, if there is one.
    #[must_use]
    pub fn named(name: &str) -> Option<InstructionSet> {
        InstructionSet::ALL.into_iter().find(|set| set.name() == name)
    }

    /// The sets that this processor can run, the best last.
    pub fn available() -> impl Iterator<Item = InstructionSet> {
        InstructionSet::ALL.into_iter().filter(|set| set.arch().is_some())
    }

    /// The set that the kernels use.
    #[must_use]
    pub fn in_use() -> InstructionSet {
        match arch() {
            Arch::Scalar => InstructionSet::Scalar,
            #[cfg(target_arch = "aarch64")]
            Arch::Neon(_) => InstructionSet::Neon,
            #[cfg(target_arch = "x86_64")]
            Arch::V3(_) => InstructionSet::Avx2,
            #[cfg(target_arch = "x86_64")]
            Arch::V4(_) => InstructionSet::Avx512,
            _ => InstructionSet::Scalar,
        }
    }

    /// Checks whether this processor can run the set.
    ///
    /// # Errors
    /// [`NoSuchInstructions`] if it cannot.
    pub fn check(self) -> Result<(), NoSuchInstructions> {
        self.arch().map(|_| ()).ok_or(NoSuchInstructions(self))
    }

    /// Makes all kernels of this process use the set from now on.
    ///
    /// # Errors
    /// [`NoSuchInstructions`] if this processor cannot run the set; nothing changes then.
    pub fn choose(self) -> Result<(), NoSuchInstructions> {
        self.check()?;
        let place = InstructionSet::ALL.iter().position(|set| *set == self).unwrap_or(0);
        CHOSEN.store(place as u8 + 1, Ordering::Relaxed);
        Ok(())
    }

    /// The set for the kernels; `None` if this processor cannot run it.
    pub(crate) fn arch(self) -> Option<Arch> {
        match self {
            InstructionSet::Scalar => Some(Arch::Scalar),
            #[cfg(target_arch = "aarch64")]
            InstructionSet::Neon => pulp::aarch64::Neon::try_new().map(Arch::Neon),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx2 => pulp::x86::V3::try_new().map(Arch::V3),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Avx512 => pulp::x86::V4::try_new().map(Arch::V4),
            #[cfg(target_arch = "x86_64")]
            InstructionSet::Neon => None,
            #[cfg(not(target_arch = "x86_64"))]
            InstructionSet::Avx2 | InstructionSet::Avx512 => None,
            #[cfg(not(any(target_arch = "aarch64", target_arch = "x86_64")))]
            InstructionSet::Neon => None,
        }
    }
}

impl fmt::Display for InstructionSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The names of the sets that this processor can run.
struct Listed;

impl fmt::Display for Listed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = InstructionSet::available().map(InstructionSet::name).collect();
        f.write_str(&names.join(", "))
    }
}

/// The runner of the kernels.
#[inline]
pub(crate) fn arch() -> Arch {
    match CHOSEN.load(Ordering::Relaxed) {
        0 => Arch::new(),
        place => {
            let chosen = InstructionSet::ALL.get(usize::from(place) - 1).and_then(|set| set.arch());
            chosen.unwrap_or_default()
        }
    }
}

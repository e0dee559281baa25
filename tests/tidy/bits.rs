//! Rules by which two daemons that apply one log hold equal bits, whatever their processors and their C libraries.
//!
//! `std` leaves the last bits of `exp`, `sin` and their like to the machine; the crate libm does not. `sqrt`, `floor`
//! and `mul_add` are exact everywhere. A kernel fuses an addition with a multiplication on every instruction set or on
//! none, and adds lanes up in an order of its own.
//!
//! Invariant: rules apply to the crates whose results are stored, in code without tests.

use super::{code, hold, read, sources};

const STORED: [&str; 3] = ["server/model", "server/grid", "server/map"];

/// Methods of numbers whose last bits are those of the machine.
const OF_THE_MACHINE: [&str; 27] = [
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "cos", "cosh", "exp", "exp2", "exp_m1",
    "gamma", "hypot", "ln", "ln_1p", "ln_gamma", "log", "log10", "log2", "powf", "powi", "sin", "sin_cos", "sinh",
    "tanh",
];

/// Names that a kernel must not use: pulp gives the results of these for each instruction set as it likes.
const OF_THE_VECTOR: [(&str, &str); 3] = [
    ("Arch::new", "the instruction set is chosen in server/model/src/instruction_set.rs"),
    ("mul_add_e_", "it is fused on some instruction sets only: use mul_add_f64s"),
    ("reduce_sum_", "its order depends on the width of vectors: use Eight::sum of server/model/src/lanes.rs"),
];

/// The methods of the machine that a line calls, as `x.exp()`, `f64::exp` or `f32::exp`.
fn called(line: &str) -> Vec<&'static str> {
    let word = |character: char| character.is_alphanumeric() || character == '_';
    let names_path =
        |path: String| line.match_indices(&path).any(|(at, found)| !line[at + found.len()..].starts_with(word));
    let calls = |name: &str| {
        line.contains(&format!(".{name}(")) || ["f64", "f32"].iter().any(|kind| names_path(format!("{kind}::{name}")))
    };
    OF_THE_MACHINE.iter().copied().filter(|name| calls(name)).collect()
}

#[test]
fn mathematics_has_equal_bits_on_every_machine() {
    let mut broken = Vec::new();
    let is_test = |path: &String| path.ends_with("_tests.rs");
    for path in STORED.iter().flat_map(|folder| sources(folder)).filter(|path| !is_test(path)) {
        for (number, line) in code(&read(&path)).lines().enumerate() {
            let place = format!("{path}:{}", number + 1);
            broken.extend(called(line).iter().map(|name| {
                format!("{place}: {name} of std differs between machines: call the crate libm, or multiply")
            }));
            let names = |word: &str| line.contains(word) && !path.ends_with("/instruction_set.rs");
            let kernel = OF_THE_VECTOR.iter().filter(|(word, _)| names(word));
            broken.extend(kernel.map(|(word, instead)| format!("{place}: names {word}: {instead}")));
        }
    }
    hold(&broken);
}

#[test]
fn calls_of_the_machine_are_found() {
    assert_eq!(called("let kept = (-gap).exp() * share.powi(2);"), ["exp", "powi"]);
    assert_eq!(called("logs.map(f64::ln)"), ["ln"]);
    assert!(called("f64::ln_exact(x) + libm::exp(x) + x.sqrt() + self.logs(x) + x.exponent()").is_empty());
}

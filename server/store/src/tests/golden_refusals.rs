//! Which changes of the bytes of learned states are refused.
//!
//! Each field of a stored state is removed, cut, made longer, and filled with other bytes, one at a time.

use tidemap_map::snapshot::StateSnapshot;

use super::{
    golden_belief,
    golden_ensemble::{self, read, written},
    golden_numbers, golden_states, golden_trained, wire,
};

const ALTERNATIVES: &str = "\
[14]\n\
1: removed cut half longer ones negative\n\
2: removed cut half longer ones negative\n\
3:\n\
4:\n\
5: great greatest\n\
6: ones negative\n\
7: removed cut half longer ones negative\n\
8:\n\
9: ones negative\n\
10: cut half longer ones negative\n\
11: great greatest\n\
12:\n\
13: removed cut half longer ones negative\n\
16: cut half longer ones negative\n\
17: removed\n\
18: cut half longer ones negative\n\
19: ones negative\n\
[14, 7]\n\
1: removed cut half longer ones negative\n\
2: ones negative\n\
3: ones negative\n\
4:\n\
5:\n\
[14, 10]\n\
1:\n\
2: ones negative\n\
[14, 13]\n\
1:\n\
2: ones negative\n\
3: removed\n\
5: removed ones negative\n\
6: removed cut half longer ones negative\n\
";

const BELIEF: &str = "\
[20]\n\
1:\n\
2: cut half longer ones negative\n\
3: cut half longer ones negative\n\
4: removed cut half longer ones negative\n\
5: cut longer ones negative\n\
6: cut half longer ones negative\n\
7:\n\
8: removed cut half longer ones negative\n\
9: cut half longer ones negative\n\
10: cut half longer ones negative\n\
[20, 2]\n\
1:\n\
2: ones negative\n\
[20, 8]\n\
1: removed cut half longer ones negative\n\
2: removed\n\
3: cut half ones negative\n\
[20, 9]\n\
1:\n\
2:\n\
3: ones negative\n\
4:\n\
";

const NUMBERS: &str = "\
[14, 21]\n\
1: removed\n\
2: removed cut half longer ones negative\n\
3: removed cut half longer\n\
4: removed cut half longer ones negative\n\
[14, 21, 4]\n\
1: cut half longer ones negative\n\
";

const PROBABILITIES: &str = "\
[14, 20]\n\
1: removed cut half longer ones negative\n\
2: removed\n\
3: removed cut half longer ones negative\n\
4: removed cut half longer ones negative\n\
5: removed cut half longer ones\n\
6: removed cut half longer\n\
7: removed cut half longer\n\
8: removed\n\
9: removed cut half longer ones\n\
10: cut half longer ones negative\n\
11:\n\
12:\n\
13: removed cut half longer ones negative\n\
14: removed cut half longer ones\n\
15: removed cut half longer ones\n\
16: removed cut half longer ones\n\
17: removed cut half longer ones\n\
18: removed cut half longer ones negative\n\
19: removed cut half longer ones\n\
[14, 20, 10]\n\
2: ones negative\n\
3: removed ones negative\n\
[14, 20, 18]\n\
1: removed cut half longer ones negative\n\
2: cut half longer ones negative\n\
3: cut half longer ones negative\n\
4: cut half longer ones negative\n\
[14, 20, 18, 2]\n\
1:\n\
2: ones negative\n\
3: removed cut half longer\n\
4: removed cut half longer ones\n\
";

const TRAINED: &str = "\
[14, 14]\n\
1: removed cut half longer ones negative\n\
2: cut half longer ones negative\n\
3: cut half longer ones negative\n\
[14, 14, 1]\n\
1: removed cut half longer ones negative\n\
2: removed great greatest\n\
3: cut longer ones negative\n\
[14, 14, 1, 1]\n\
1:\n\
2: ones negative\n\
[14, 14, 2]\n\
1: removed cut half longer ones negative\n\
2: removed cut half longer ones negative\n\
3: removed cut half longer ones negative\n\
5: cut half longer ones negative\n\
6: cut half longer ones negative\n\
7: removed ones negative\n\
8: removed cut half longer ones negative\n\
[14, 14, 2, 1]\n\
1:\n\
2: ones negative\n\
[14, 14, 2, 5]\n\
1: ones negative\n\
2: removed cut half longer ones\n\
3: removed cut half longer ones negative\n\
";

const HYPERTIME_OF_VALUES: &str = "\
[14, 14, 2]\n\
1: removed cut half longer ones negative\n\
2: removed cut half longer ones negative\n\
4: removed cut half longer ones negative\n\
5: removed cut half longer ones negative\n\
8: removed cut half longer ones negative\n\
[14, 14, 2, 1]\n\
1:\n\
2: ones negative\n\
[14, 14, 2, 5]\n\
1: ones negative\n\
2: removed cut half longer ones\n\
3: removed cut half longer ones negative\n\
";

const COUNTS: &str = "\
[14, 14, 4]\n\
1: removed cut half longer ones negative\n\
2: removed greatest\n\
3: removed cut half longer ones negative\n\
4: removed cut half longer ones negative\n\
5: removed cut half longer ones\n\
";

/// The lines of the refused changes of the messages at some paths of tags.
fn lines(state: &StateSnapshot, paths: &[&[u32]]) -> String {
    let bytes = written(state);
    let is_refused = |bytes: &[u8]| read(bytes).is_err();
    assert!(!is_refused(&bytes));
    let of_path = |path: &&[u32]| format!("{path:?}\n{}", wire::refusals(&bytes, path, &is_refused));
    paths.iter().map(of_path).collect()
}

#[test]
fn wrong_ensembles_of_probabilities_are_refused() {
    let found = lines(&golden_ensemble::known(400), &[&[14, 20], &[14, 20, 10], &[14, 20, 18], &[14, 20, 18, 2]]);
    assert_eq!(found, PROBABILITIES);
    // After few days there is a smooth table.
    let few = lines(&golden_ensemble::known(9), &[&[14, 20]]);
    assert!(few.ends_with("\n20: cut half longer ones negative\n21: ones negative\n"), "{few}");
}

#[test]
fn wrong_ensembles_of_numbers_are_refused() {
    assert_eq!(lines(&golden_numbers::known(), &[&[14, 21], &[14, 21, 4]]), NUMBERS);
}

#[test]
fn wrong_beliefs_are_refused() {
    assert_eq!(lines(&golden_belief::known(), &[&[20], &[20, 2], &[20, 8], &[20, 9]]), BELIEF);
}

#[test]
fn wrong_alternatives_are_refused() {
    let state = golden_states::state("door", golden_states::alternatives(Some(Some(2.75))));
    assert_eq!(lines(&state, &[&[14], &[14, 7], &[14, 10], &[14, 13]]), ALTERNATIVES);
}

#[test]
fn wrong_trained_models_are_refused() {
    let states = golden_trained::snapshot().states;
    let hypertime: &[&[u32]] = &[&[14, 14, 2], &[14, 14, 2, 1], &[14, 14, 2, 5]];
    let pergam: &[&[u32]] = &[&[14, 14], &[14, 14, 1], &[14, 14, 1, 1]];
    let find = |name| states.iter().find(|state| state.name.as_str() == name).expect("it is there");
    assert_eq!(lines(find("door"), &[pergam, hypertime].concat()), TRAINED);
    assert_eq!(lines(find("warmth Em"), hypertime), HYPERTIME_OF_VALUES);
    assert_eq!(lines(find("people"), &[&[14, 14, 4]]), COUNTS);
}

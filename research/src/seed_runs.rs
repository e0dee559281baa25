//! Every kind of robot with every seed, in parallel.
//!
//! Invariant: the results are the same for any number of threads.

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

/// Runs all kinds with `seeds` seeds from the first one; `progress` receives the numbers of finished and of all runs.
/// The results are by kind, then by seed.
pub(crate) fn run_all<K, T, E>(
    kinds: &[K],
    (first_seed, seeds): (u64, u64),
    progress: &(impl Fn(u64, u64) + Sync),
    run: impl Fn(K, u64) -> Result<T, E> + Sync,
) -> Result<Vec<Vec<T>>, E>
where
    K: Copy + Send + Sync,
    T: Send,
    E: Send,
{
    // Fast kinds come first; they run last, so that no thread is left with a slow one at the end.
    let of_kind = |&kind: &K| (0..seeds).map(move |seed| (kind, first_seed.wrapping_add(seed)));
    let jobs: Vec<(K, u64)> = kinds.iter().rev().flat_map(of_kind).collect();
    let (done, total) = (AtomicU64::new(0), jobs.len() as u64);
    let run = |(kind, seed)| {
        let outcome = run(kind, seed);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        outcome
    };
    let mut outcomes = jobs.into_par_iter().map(run).collect::<Result<Vec<T>, E>>()?.into_iter();
    let mut by_kind: Vec<Vec<T>> = kinds.iter().map(|_| outcomes.by_ref().take(seeds as usize).collect()).collect();
    by_kind.reverse();
    Ok(by_kind)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outcomes_are_by_kind_and_seed() {
        let run = |kind: char, seed: u64| if seed < 9 { Ok(format!("{kind}{seed}")) } else { Err(seed) };
        let done = AtomicU64::new(0);
        let count = |_: u64, total: u64| {
            assert_eq!(total, 6);
            done.fetch_add(1, Ordering::Relaxed);
        };
        assert_eq!(
            run_all(&['a', 'b'], (5, 3), &count, run),
            Ok(vec![["a5", "a6", "a7"].map(str::to_owned).to_vec(), ["b5", "b6", "b7"].map(str::to_owned).to_vec()])
        );
        assert_eq!(done.into_inner(), 6);
        assert_eq!(run_all(&['a'], (8, 2), &|_, _| {}, run), Err(9));
    }
}

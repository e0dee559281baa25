//! Random operations, compared with a naive model that keeps all observations and computes every
//! answer from them, by the formulas as they are printed.
//!
//! Invariant: after each operation, and after each restart, the daemon and the naive model answer alike. The seed is
//! printed; the same seed gives the same operations.

mod naive;
mod operations;

use operations::World;
use tidemap_tests::rounds;

#[tokio::test(flavor = "multi_thread")]
async fn random_operations_have_the_effect_that_a_naive_model_expects() {
    let seed = rounds::seed("random_operations_have_the_effect_that_a_naive_model_expects");
    let operations = rounds::count("TIDEMAP_OPERATIONS", 300);
    let mut world = World::new(seed).await;
    for number in 0..operations {
        world.operation(number).await;
    }
    world.verify_all("at the end").await;
    println!("{operations} operations: {}", world.summary());
}

//! Compares the grid with a naive oracle: random robots in a small world, with every cell compared after every step.
//!
//! Invariant: everything follows from the seed alone, which a failure prints.

use proptest::prelude::*;
use tidemap_grid::update::rules::UpdateLimits;

use self::world::World;

mod compare;
mod live;
mod oracle;
mod robot;
mod scans;
mod world;

fn config() -> ProptestConfig {
    let usual = ProptestConfig::default();
    ProptestConfig { cases: usual.cases / 4, max_shrink_iters: 200, ..usual }
}

fn follow(mut world: World, seed: u64, steps: usize) {
    for step in 0..steps {
        world.step();
        world.compare(&format!("seed {seed}, step {step}"));
    }
    world.settle();
    world.compare(&format!("seed {seed}, settled"));
    world.restore();
    world.compare(&format!("seed {seed}, restored"));
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn a_grid_gives_each_cell_the_answer_of_its_own_model(seed in any::<u64>(), steps in 1_usize..60) {
        follow(World::new(seed), seed, steps);
    }

    #[test]
    fn a_grid_does_so_with_the_limits_of_the_daemon_too(seed in any::<u64>(), steps in 1_usize..60) {
        let mut world = World::new(seed);
        world.limits = UpdateLimits::default();
        follow(world, seed, steps);
    }

    #[test]
    fn order_of_arrival_and_batching_do_not_matter(seed in any::<u64>(), scans in 1_usize..60) {
        let (mut one, mut other) = (World::new(seed), World::new(seed));
        let mut sent = one.draw_scans(scans);
        one.send_all(&sent, 1);
        one.settle();
        other.shuffle(&mut sent);
        other.send_all(&sent, 7);
        other.settle();
        one.compare_sums(&other, &format!("seed {seed}"));
    }
}

proptest! {
    // Each case has three worlds of some days.
    #![proptest_config(ProptestConfig { cases: config().cases.div_ceil(4), ..config() })]

    #[test]
    fn scans_are_learned_alike_in_one_update_and_night_by_night(seed in any::<u64>(), scans in 20_usize..90) {
        let mut sent = World::new(seed).draw_scans(scans);
        sent.sort_by_key(|scan| scan.utc_nanos);
        let learned = |batch: usize, closes: &dyn Fn(usize) -> bool| {
            let mut world = World::new(seed);
            world.send_by_day(&sent, batch, closes);
            world
        };
        let nightly = learned(1, &|_| true);
        for other in [learned(1, &|_| false), learned(7, &|day| day % 3 == 1)] {
            prop_assert!(other.knows_the_same(&nightly), "seed {seed}");
        }
    }
}

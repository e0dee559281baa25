//! Checks the best order against dynamic programming over all sets, which uses no bounds.

use super::*;

/// The least expected time over all sets of visited nodes and positions, without pruning.
fn oracle(map: &Map, floor: f64) -> f64 {
    let roads = map.roads();
    let (count, times) = (map.goals.len(), roads.all_pairs().unwrap());
    let weights: Vec<f64> = map.goals.iter().map(|&(_, probability)| probability.max(floor)).collect();
    let sum: f64 = weights.iter().sum();
    let mut costs = vec![f64::INFINITY; (1 << count) * count];
    for set in 1..1_usize << count {
        let left: f64 = (0..count).filter(|goal| set & (1 << goal) == 0).map(|goal| weights[goal]).sum();
        for to in (0..count).filter(|to| set & (1 << to) != 0) {
            let before = set & !(1 << to);
            let charge = left + weights[to];
            let mut cost = if before == 0 { times[to] * charge } else { f64::INFINITY };
            for from in (0..count).filter(|from| before & (1 << from) != 0) {
                let secs = roads.dwell_secs(from) + times[from * count + to];
                cost = cost.min(costs[before * count + from] + secs * charge);
            }
            costs[set * count + to] = cost;
        }
    }
    let last = &costs[((1 << count) - 1) * count..];
    last.iter().copied().fold(f64::INFINITY, f64::min) / sum
}

fn check(map: &Map, options: &SearchOptions, what: &str) {
    let plan = search(&map.roads(), map.start(), &goals(map), options, || false).unwrap();
    let best = oracle(map, options.floor);
    assert!(plan.optimal, "{what}");
    assert!((plan.expected_secs - best).abs() <= 1e-9 * best.max(1.0), "{what}: {} is not {best}", plan.expected_secs);
    assert!(plan.lower_bound_secs <= plan.expected_secs, "{what}");
    assert!(plan.lower_bound_secs >= best * (1.0 - 1e-9), "{what}: a bound of {}", plan.lower_bound_secs);
    let mut seen: Vec<NodeId> = plan.steps.iter().map(|step| step.node).collect();
    seen.sort();
    assert_eq!(seen, map.goals.iter().map(|&(node, _)| node).collect::<Vec<_>>(), "{what}");
}

#[test]
fn no_order_is_better_on_a_thousand_maps() {
    for seed in 0..1_000 {
        let count = 2 + (seed as usize * 7) % 12;
        let (shape, whole) = (SHAPES[seed as usize % 4], seed / 4 % 2 == 0);
        let mut map = Map::random(shape, count, whole, seed);
        if seed % 5 == 0 {
            map = with_looks(map, seed);
        }
        check(&map, &SearchOptions::default(), &format!("{shape:?} of {count}, seed {seed}"));
    }
}

#[test]
fn no_order_is_better_on_maps_of_fifteen_nodes() {
    for seed in 0..16 {
        let shape = SHAPES[seed as usize % 4];
        let map = Map::random(shape, 15, seed / 4 % 2 == 0, 10_000 + seed);
        check(&map, &SearchOptions::default(), &format!("{shape:?} of 15, seed {seed}"));
    }
}

#[test]
fn no_order_is_better_where_the_bound_by_paths_is_needed() {
    let mut needed = 0;
    for seed in 0..6 {
        let map =
            Map::random([Shape::Complete, Shape::Random][seed as usize % 2], 18, seed / 2 % 2 == 0, 20_000 + seed);
        check(&map, &SearchOptions::default(), &format!("seed {seed}"));
        let plan = search(&map.roads(), map.start(), &goals(&map), &SearchOptions::default(), || false).unwrap();
        needed += usize::from(plan.states > 4_000);
    }
    assert!(needed > 0, "the first bound was enough for all");
}

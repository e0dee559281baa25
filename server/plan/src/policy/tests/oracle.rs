//! Value iteration over all states until convergence, as an oracle for policies.

use rand::{Rng, SeedableRng, rngs::SmallRng};
use tidemap_map::{
    name::StateName,
    topology::{Edge, Extent, Topology},
};

use super::*;

/// A map with forecasts by edge and slot.
struct World {
    topology: Topology,
    target: NodeId,
    options: PolicyOptions,
    forecasts: Vec<Vec<Option<EdgeForecast>>>,
}

impl World {
    fn random(seed: u64) -> World {
        let mut random = SmallRng::seed_from_u64(seed);
        let (count, slots) = (random.random_range(2..=6), random.random_range(1..=6));
        let slot_secs = random.random_range(10.0..100.0);
        let whole = seed.is_multiple_of(3);
        let mut topology = Topology::new();
        let nodes: Vec<NodeId> = (0..count)
            .map(|node| topology.add_node(StateName::new(&format!("n{node}")).unwrap(), None, None).unwrap())
            .collect();
        for _ in 0..random.random_range(count..3 * count) {
            let (from, to) = (random.random_range(0..count), random.random_range(0..count));
            let action = random.random_bool(0.2).then(|| StateName::new("door").unwrap());
            // Existing edges and loops are omitted.
            let _ = topology.add_edge(nodes[from], nodes[to], action, Extent::secs(1.0));
        }
        let closed = if random.random() { 0.3 } else { 0.0 };
        let mut forecast = || {
            let success = match whole {
                true => [1.0, 0.5][random.random_range(0..2)],
                false => random.random_range(0.2..=1.0),
            };
            // The slot widths range from several edges per slot to several slots per edge.
            let slots =
                if whole { [0.25, 0.5, 1.0, 2.0][random.random_range(0..4)] } else { random.random_range(0.05..2.5) };
            let forecast = EdgeForecast { success, duration_secs: slots * slot_secs, evidence: 1.0 };
            (!random.random_bool(closed)).then_some(forecast)
        };
        let forecasts = topology.edges().map(|_| (0..slots).map(|_| forecast()).collect()).collect();
        let objective = if random.random() { PolicyObjective::Reach } else { PolicyObjective::Time };
        let recovery_secs = if whole { 0.5 * slot_secs } else { random.random_range(0.0..100.0) };
        let options = PolicyOptions { objective, slot_secs, slots, recovery_secs };
        World { topology, target: NodeId(random.random_range(0..count) as u32), options, forecasts }
    }

    fn at(&self, edge: &Edge, at_secs: f64) -> Option<EdgeForecast> {
        let slot = (at_secs / self.options.slot_secs).floor();
        assert!((at_secs / self.options.slot_secs - slot - 0.5).abs() < 1e-9, "the middle of a slot");
        self.forecasts[edge.id.0 as usize][slot as usize]
    }

    fn actions(&self, node: NodeId, slot: usize) -> Vec<PolicyAction> {
        let edges = self.topology.leaving(node).filter(|edge| self.forecasts[edge.id.0 as usize][slot].is_some());
        edges.map(|edge| PolicyAction::Take(edge.id)).chain([PolicyAction::Wait]).collect()
    }

    /// The outcomes of an action: probability, seconds, node.
    fn outcomes(&self, node: NodeId, slot: usize, action: PolicyAction) -> Vec<(f64, f64, NodeId)> {
        match action {
            PolicyAction::Take(id) => {
                let edge = self.topology.edge(id).unwrap();
                let EdgeForecast { success, duration_secs, .. } = self.forecasts[id.0 as usize][slot].unwrap();
                let failed = (1.0 - success, duration_secs + self.options.recovery_secs, node);
                [(success, duration_secs, edge.to), failed].into_iter().filter(|outcome| outcome.0 > 0.0).collect()
            }
            PolicyAction::Wait => vec![(1.0, self.options.slot_secs, node)],
            _ => unreachable!(),
        }
    }

    /// The states between which the value at a time is interpolated, with their shares; slots may lie after the last.
    fn between(&self, slot: usize, secs: f64) -> Vec<(usize, f64)> {
        let x = slot as f64 + secs / self.options.slot_secs;
        let share = x - x.floor();
        let both = [(x.floor() as usize, 1.0 - share), (x.floor() as usize + 1, share)];
        both.into_iter().filter(|(_, share)| *share > 1e-12).collect()
    }

    fn last(&self) -> usize {
        self.options.slots - 1
    }

    fn reach_of(&self, values: &[Vec<f64>], node: NodeId, slot: usize, action: PolicyAction) -> f64 {
        let end_secs = (self.options.slots - slot) as f64 * self.options.slot_secs;
        let value = |(probability, secs, at): (f64, f64, NodeId)| {
            if at == self.target {
                return if secs <= end_secs * (1.0 + 1e-12) { probability } else { 0.0 };
            }
            let slots = self.between(slot, secs).into_iter();
            let known = slots.filter(|&(slot, _)| slot <= self.last());
            probability * known.map(|(slot, share)| share * values[slot][at.0 as usize]).sum::<f64>()
        };
        self.outcomes(node, slot, action).into_iter().map(value).sum()
    }

    /// Seconds, in the sense of the objective.
    fn secs_of(&self, values: &[Vec<f64>], node: NodeId, slot: usize, action: PolicyAction) -> f64 {
        let end_secs = (self.options.slots - slot) as f64 * self.options.slot_secs;
        let is_reach = self.options.objective == PolicyObjective::Reach;
        let value = |(probability, secs, at): (f64, f64, NodeId)| {
            let own = if is_reach { f64::min(secs, end_secs) } else { secs };
            let mut later = 0.0;
            for (slot, share) in self.between(slot, secs) {
                if at != self.target && !(is_reach && slot > self.last()) {
                    later += share * values[slot.min(self.last())][at.0 as usize];
                }
            }
            probability * (own + later)
        };
        self.outcomes(node, slot, action).into_iter().map(value).sum()
    }

    /// Iterates `value` for all states except the target's until convergence; infinite values stay.
    fn iterate(&self, start: Vec<Vec<f64>>, value: impl Fn(&[Vec<f64>], NodeId, usize) -> f64) -> Vec<Vec<f64>> {
        let mut values = start;
        for _ in 0..200_000 {
            let mut next = values.clone();
            let mut change = 0.0_f64;
            for slot in 0..self.options.slots {
                for node in self.topology.nodes().map(|node| node.id).filter(|&node| node != self.target) {
                    let old = values[slot][node.0 as usize];
                    if old.is_finite() {
                        next[slot][node.0 as usize] = value(&values, node, slot);
                        change = change.max((next[slot][node.0 as usize] - old).abs() / (1.0 + old.abs()));
                    }
                }
            }
            values = next;
            if change < 1e-15 {
                break;
            }
        }
        values
    }

    fn zeros(&self) -> Vec<Vec<f64>> {
        vec![vec![0.0; self.topology.nodes().len()]; self.options.slots]
    }

    /// Zero where some policy reaches the target with certainty, infinite elsewhere.
    fn certain(&self) -> Vec<Vec<f64>> {
        let mut values = self.zeros();
        let last = self.last();
        // If the last slot lasts for ever, a path to the target suffices.
        values[last].fill(f64::INFINITY);
        values[last][self.target.0 as usize] = 0.0;
        for _ in 0..self.topology.nodes().len() {
            for edge in self.topology.edges() {
                if self.forecasts[edge.id.0 as usize][last].is_some() && values[last][edge.to.0 as usize] == 0.0 {
                    values[last][edge.from.0 as usize] = 0.0;
                }
            }
        }
        for _ in 0..self.options.slots * self.topology.nodes().len() {
            for slot in 0..last {
                for node in self.topology.nodes().map(|node| node.id).filter(|&node| node != self.target) {
                    let ends = |action: &PolicyAction| self.secs_of(&values, node, slot, *action).is_finite();
                    if !self.actions(node, slot).iter().any(ends) {
                        values[slot][node.0 as usize] = f64::INFINITY;
                    }
                }
            }
        }
        values
    }
}

fn near(a: f64, b: f64) -> bool {
    a == b || (a - b).abs() <= 1e-9 * (1.0 + b.abs())
}

fn check_reach(world: &World, table: &PolicyTable, seed: u64) {
    let all = |node, slot| world.actions(node, slot);
    let reach = world.iterate(world.zeros(), |values, node, slot| {
        let worths = all(node, slot).into_iter().map(|action| world.reach_of(values, node, slot, action));
        worths.fold(0.0, f64::max)
    });
    let is_best = |node: NodeId, slot: usize, action: PolicyAction| {
        world.reach_of(&reach, node, slot, action) >= reach[slot][node.0 as usize] - 1e-11
    };
    let secs = world.iterate(world.zeros(), |values, node, slot| {
        let best = all(node, slot).into_iter().filter(|&action| is_best(node, slot, action));
        best.map(|action| world.secs_of(values, node, slot, action)).fold(f64::INFINITY, f64::min)
    });
    for (slot, node) in states(world) {
        let entry = table.entry(node, slot).unwrap();
        let what = format!("seed {seed}, {node:?} in slot {slot}: {entry:?}");
        let (reach_is, secs_are) = (reach[slot][node.0 as usize], secs[slot][node.0 as usize]);
        assert!(near(entry.reach, reach_is), "{what}, not {reach_is}");
        assert!(near(entry.expected_secs, secs_are), "{what}, not {secs_are}");
        match entry.action {
            PolicyAction::Nothing => assert_eq!(reach_is, 0.0, "{what}"),
            PolicyAction::Arrived => panic!("{what}"),
            action => {
                assert!(near(world.reach_of(&reach, node, slot, action), reach_is), "{what}");
                assert!(near(world.secs_of(&secs, node, slot, action), secs_are), "{what}");
            }
        }
    }
}

fn check_time(world: &World, table: &PolicyTable, seed: u64) {
    let is_for_ever = |slot: usize, action: &PolicyAction| slot == world.last() && *action == PolicyAction::Wait;
    let secs = world.iterate(world.certain(), |values, node, slot| {
        let actions = world.actions(node, slot).into_iter().filter(|action| !is_for_ever(slot, action));
        actions.map(|action| world.secs_of(values, node, slot, action)).fold(f64::INFINITY, f64::min)
    });
    let reach = world.iterate(world.zeros(), |values, node, slot| match table.entry(node, slot).unwrap().action {
        PolicyAction::Nothing => 0.0,
        action => world.reach_of(values, node, slot, action),
    });
    for (slot, node) in states(world) {
        let entry = table.entry(node, slot).unwrap();
        let (secs_are, reach_is) = (secs[slot][node.0 as usize], reach[slot][node.0 as usize]);
        let what = format!("seed {seed}, {node:?} in slot {slot}: {entry:?}, not {secs_are}, {reach_is}");
        assert!(near(entry.expected_secs, secs_are), "{what}");
        assert!(near(entry.reach, reach_is), "{what}");
        match entry.action {
            PolicyAction::Nothing => assert!(secs_are.is_infinite(), "{what}"),
            PolicyAction::Arrived => panic!("{what}"),
            action => assert!(near(world.secs_of(&secs, node, slot, action), secs_are), "{what}"),
        }
    }
}

/// All states except the target's.
fn states(world: &World) -> Vec<(usize, NodeId)> {
    let nodes = || world.topology.nodes().map(|node| node.id).filter(|&node| node != world.target);
    (0..world.options.slots).flat_map(|slot| nodes().map(move |node| (slot, node))).collect()
}

#[test]
fn policies_are_those_of_value_iteration() {
    let (mut waits, mut takes, mut nothings, mut infinite) = (0, 0, 0, 0);
    for seed in 0..600 {
        let world = World::random(seed);
        let at = &mut |edge: &Edge, at_secs: f64| world.at(edge, at_secs);
        let table = solve_policy(&world.topology, world.target, &world.options, at, || false).unwrap();
        match world.options.objective {
            PolicyObjective::Reach => check_reach(&world, &table, seed),
            PolicyObjective::Time => check_time(&world, &table, seed),
        }
        for slot in 0..world.options.slots {
            let target = table.entry(world.target, slot).unwrap();
            assert_eq!(target, PolicyEntry { action: PolicyAction::Arrived, expected_secs: 0.0, reach: 1.0 });
            for entry in table.slot(slot).unwrap() {
                waits += usize::from(entry.action == PolicyAction::Wait);
                takes += usize::from(matches!(entry.action, PolicyAction::Take(_)));
                nothings += usize::from(entry.action == PolicyAction::Nothing);
                infinite += usize::from(entry.expected_secs.is_infinite());
            }
        }
    }
    assert!(waits > 100 && takes > 1_000 && nothings > 100 && infinite > 100, "{waits} {takes} {nothings} {infinite}");
}

//! The next best routes, by J. Y. Yen, "Finding the K shortest loopless paths in a network", Management Science 1971,
//! with deviations tried only from each route's own deviation on (E. L. Lawler, Management Science 1972).
//!
//! All paths except the known ones fall into classes: equal to a known one up to a node, then along another edge. The
//! best of each class is a separate search, from that node at the time of its arrival. Invariant: classes do not
//! overlap, so no path is found twice.

use super::{
    Forecasts, PlanRouteError,
    cost::Cost,
    labels::{EdgePath, Labels, Task},
};

/// A route with the index of the first step whose deviations were not tried yet.
struct Deviation {
    found: EdgePath,
    deviation: usize,
}

/// The best route and up to `count` next best ones, the best first.
pub(super) fn next_best<F: Forecasts, U: FnMut() -> bool>(
    search: &mut Labels<F, U>,
    best: EdgePath,
    (start, goal): (usize, usize),
    (departure_secs, latest_secs): (f64, f64),
    count: usize,
) -> Result<Vec<EdgePath>, PlanRouteError> {
    let mut found: Vec<EdgePath> = Vec::new();
    // The candidates, ascending by cost, then by edges.
    let mut candidates = vec![Deviation { found: best, deviation: 0 }];
    while found.len() <= count && !candidates.is_empty() {
        let Deviation { found: route, deviation } = candidates.remove(0);
        found.push(route.clone());
        if found.len() > count {
            break;
        }
        let mut is_passed = vec![false; search.network.nodes.len()];
        let (mut node, mut at_secs, mut cost) = (start, departure_secs, Cost::ZERO);
        for (step, &edge) in route.edges.iter().enumerate() {
            if step >= deviation {
                let before = &route.edges[..step];
                let closed_first: Vec<usize> = found
                    .iter()
                    .filter(|other| other.edges.starts_with(before))
                    .map(|other| other.edges[step])
                    .collect();
                let task = Task {
                    before,
                    node,
                    at_secs,
                    cost,
                    is_passed: &is_passed,
                    closed_first: &closed_first,
                    goal,
                    latest_secs,
                    join_secs: 0.0,
                };
                // With enough better candidates this one is never used.
                let wanted = count + 1 - found.len();
                let limit = candidates.get(wanted - 1).map_or(Cost::INFINITE, |candidate| candidate.found.cost);
                let good = search.good(&task, limit)?;
                if let Some(next) = search.best(&task, good, limit)? {
                    let key = |found: &EdgePath| (found.cost, found.edges.clone());
                    let place = candidates.partition_point(|other| key(&other.found) <= key(&next));
                    candidates.insert(place, Deviation { found: next, deviation: step });
                    candidates.truncate(wanted);
                }
            }
            let Some(traversal) = search.cache.at(edge, at_secs)? else { break };
            is_passed[node] = true;
            at_secs += traversal.duration_secs;
            cost = cost.plus(traversal.cost);
            node = search.network.to(edge);
        }
    }
    Ok(found)
}

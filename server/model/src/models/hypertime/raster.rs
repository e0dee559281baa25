//! The probability of a mixture of Gaussians in cells of space.
//!
//! Densities at the middles of cells would be wrong where a cluster is narrower than a cell. So each Gaussian is
//! integrated, one axis after the other by its triangular factor: along an axis exactly, by the normal distribution
//! function, and in strips that are so narrow that the coordinate can be treated as constant for the following axes.
//! Invariant: no cell is negative, and cells that cover everything sum up to 1, however coarse they are.

use super::cluster::Cluster;
use super::conditional::HypertimeDistribution;
use crate::special::normal_tail;

#[cfg(test)]
mod tests;

/// Deviations beyond which 1e-15 of a Gaussian is left.
const FARTHEST: f64 = 8.0;
/// Maximum width of a strip, in deviations.
const STRIP: f64 = 0.25;

impl HypertimeDistribution {
    /// Probability of each cell of a box. Cell 0 begins at `low` along each axis, all cells are `width` wide, and there
    /// are `counts` of them along each axis; the first axis varies fastest. The probabilities sum to at most 1: the
    /// rest lies outside. `None` if a list does not have one number for each coordinate, a number is not finite, the
    /// width is not above 0, a count is 0, or there are too many cells.
    pub fn cells(&self, low: &[f64], width: f64, counts: &[usize]) -> Option<Vec<f64>> {
        let coordinates = self.axes.len();
        if low.len() != coordinates || counts.len() != coordinates || counts.contains(&0) {
            return None;
        }
        if !(low.iter().all(|edge| edge.is_finite()) && width > 0.0 && width.is_finite()) {
            return None;
        }
        let all = counts.iter().try_fold(1_usize, |all, &count| all.checked_mul(count))?;
        let edges: Vec<Vec<f64>> = (self.axes.iter().zip(low).zip(counts))
            .map(|((axis, low), &count)| (0..=count).map(|i| axis.standard(low + width * i as f64)).collect())
            .collect();
        let mut cells = vec![0.0; all];
        for cluster in &self.mixture.clusters {
            Raster { cluster, edges: &edges }.share_out(cluster.parts().weight, &[], (0, 1), &mut cells);
        }
        Some(cells)
    }
}

/// One Gaussian and the edges of the cells along each axis, all standardised.
struct Raster<'a> {
    cluster: &'a Cluster,
    edges: &'a [Vec<f64>],
}

impl Raster<'_> {
    /// Distributes the mass for given deviations of the previous axes to the cells `first`, `first` + `stride`, ….
    fn share_out(&self, mass: f64, given: &[f64], (first, stride): (usize, usize), cells: &mut [f64]) {
        let axis = given.len();
        let parts = self.cluster.parts();
        let row = &parts.factor[axis * (axis + 1) / 2..][..=axis];
        let centre =
            parts.centre[axis] + row.iter().zip(given).map(|(factor, deviation)| factor * deviation).sum::<f64>();
        let edges = &self.edges[axis];
        let deviation = |edge: usize| ((edges[edge] - centre) / row[axis]).clamp(-FARTHEST, FARTHEST);
        let is_last = axis + 1 == self.edges.len();
        let mut from = deviation(0);
        let mut below = normal_tail(-from);
        for cell in 0..edges.len() - 1 {
            let to = deviation(cell + 1);
            if to <= from {
                continue;
            }
            let place = first + cell * stride;
            if is_last {
                let below_next = normal_tail(-to);
                cells[place] += mass * (below_next - below).max(0.0);
                below = below_next;
            } else {
                // The count is at most 64, because deviations are bounded.
                let strips = ((to - from) / STRIP).ceil().max(1.0);
                let edge = |strip: f64| from + (to - from) * strip / strips;
                for strip in 0..strips as usize {
                    let (left, right) = (edge(strip as f64), edge(strip as f64 + 1.0));
                    let share = (normal_tail(-right) - normal_tail(-left)).max(0.0);
                    if share > 0.0 {
                        let mut given = given.to_vec();
                        given.push(mean_between(left, right, share));
                        self.share_out(mass * share, &given, (place, stride * (edges.len() - 1)), cells);
                    }
                }
            }
            from = to;
        }
    }
}

/// Mean of a standard Gaussian between two numbers, where `share` is its mass there.
fn mean_between(left: f64, right: f64, share: f64) -> f64 {
    let density = |deviation: f64| libm::exp(-0.5 * deviation * deviation) / std::f64::consts::TAU.sqrt();
    ((density(left) - density(right)) / share).clamp(left, right)
}

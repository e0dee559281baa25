//! Localises a robot by the image features that it sees (T-RO, section VII): the landmarks that are probably visible at
//! each node are matched to the features, and matches that agree about the heading vote for the node.
//!
//! A landmark matches the feature with the nearest descriptor if this descriptor is clearly nearer than the next one
//! (ratio test), and if landmark and feature are at about the same height in their images. The distance of the feature
//! to the right of the landmark's position shows how the robot has turned. The heading on which the largest number of
//! matches agree wins (T-RO: histogram voting).
//!
//! The probability of a node compares two explanations of its votes: the robot is there, and each landmark votes as
//! probably as it is visible; or the robot is elsewhere, and landmarks vote as often as at the other nodes. Landmarks
//! of a node appear and vanish together, for example with the light. So a node's votes count as far fewer independent
//! ones ([`INDEPENDENT_VOTES`]).
//!
//! Invariant: the result depends on the features, the nodes and their order alone, whatever the processor.

use pulp::Arch;
use tidemap_map::landmark::{Descriptor, ImageFeature};

#[cfg(test)]
mod tests;

/// A match is accepted where 10 times its distance is less than 9 times that of the next.
const RATIO: [u32; 2] = [10, 9];
/// The votes of a node count as this number of independent landmarks.
pub const INDEPENDENT_VOTES: f64 = 12.0;
/// Probability that a landmark that is always or never seen is different this time.
const SURE: f64 = 0.02;

/// The rules for matches that agree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchRules {
    /// Maximum distance between landmark and feature to the side, pixels.
    pub du_max_px: f64,
    /// Maximum distance up or down, pixels.
    pub dv_max_px: f64,
    /// Matches agree about a heading within this distance, pixels.
    pub heading_px: f64,
}

impl Default for MatchRules {
    fn default() -> MatchRules {
        MatchRules { du_max_px: 400.0, dv_max_px: 30.0, heading_px: 20.0 }
    }
}

/// The features of an image, arranged for comparisons.
#[derive(Clone, Debug)]
pub struct SeenFeatures {
    features: Vec<ImageFeature>,
    /// Word `k` of all descriptors, one after the other.
    words: Vec<Vec<u64>>,
}

/// The error for descriptors of different lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("descriptors of {found} bytes and of {expected} bytes cannot be compared")]
pub struct MixedDescriptors {
    /// Length of this descriptor, bytes.
    pub found: usize,
    /// Length of the other descriptors, bytes.
    pub expected: usize,
}

/// A landmark that is expected at a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedLandmark {
    /// Position and descriptor of the landmark when it was seen.
    pub feature: ImageFeature,
    /// Probability that the landmark is visible, in [0, 1].
    pub visible: f64,
}

/// The match of the features with the landmarks of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeMatch {
    /// Landmarks with a feature near enough.
    pub matches: u32,
    /// Matches that agree about the heading.
    pub votes: u32,
    /// Sum of the voters' distances, bits.
    pub distance_bits: u32,
    /// Distance of the features to the right of the landmarks' positions, pixels; `None`: no vote.
    pub heading_px: Option<f64>,
    /// Probability that the robot is at the node, if it is at one of the nodes.
    pub probability: f64,
}

impl NodeMatch {
    /// Orders by votes, then matches, then the smaller distance: the greater, the better.
    #[must_use]
    pub fn rank(&self) -> impl Ord + use<> {
        (self.votes, self.matches, std::cmp::Reverse(self.distance_bits))
    }
}

impl SeenFeatures {
    /// The features of an image, in any order; the first counts among equally near ones.
    ///
    /// # Errors
    /// [`MixedDescriptors`]
    pub fn new(features: Vec<ImageFeature>) -> Result<SeenFeatures, MixedDescriptors> {
        let expected = features.first().map_or(0, |feature| feature.descriptor.len());
        if let Some(other) = features.iter().find(|feature| feature.descriptor.len() != expected) {
            return Err(MixedDescriptors { found: other.descriptor.len(), expected });
        }
        let word =
            |k: usize| features.iter().map(|feature| feature.descriptor.words().get(k).copied().unwrap_or(0)).collect();
        let words = (0..expected.div_ceil(8)).map(word).collect();
        Ok(SeenFeatures { features, words })
    }

    /// Number of features.
    #[must_use]
    pub fn len(&self) -> usize {
        self.features.len()
    }

    /// Whether there are no features.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.features.is_empty()
    }

    /// The feature that passes the ratio test against a descriptor.
    #[must_use]
    pub fn clearly_nearest(&self, descriptor: &Descriptor) -> Option<&ImageFeature> {
        self.nearest(descriptor, &mut Vec::new()).map(|(feature, _)| feature)
    }

    /// The feature that passes the ratio test against a descriptor, and its distance.
    fn nearest(&self, descriptor: &Descriptor, distances: &mut Vec<u32>) -> Option<(&ImageFeature, u32)> {
        distances.clear();
        distances.resize(self.features.len(), 0);
        for (word, column) in descriptor.words().iter().zip(&self.words) {
            for (distance, other) in distances.iter_mut().zip(column) {
                *distance += (word ^ other).count_ones();
            }
        }
        let (mut nearest, mut next) = ((0, u32::MAX), u32::MAX);
        for (index, &distance) in distances.iter().enumerate() {
            if distance < nearest.1 {
                (nearest, next) = ((index, distance), nearest.1);
            } else {
                next = next.min(distance);
            }
        }
        let is_clear = next < u32::MAX && nearest.1 * RATIO[0] < next * RATIO[1];
        self.features.get(nearest.0).filter(|_| is_clear).map(|feature| (feature, nearest.1))
    }

    /// The landmarks that have a feature near enough: its distance to the right, and its descriptor distance in bits.
    fn matches(&self, landmarks: &[ExpectedLandmark], rules: &MatchRules) -> Vec<(f64, u32)> {
        let mut distances = Vec::new();
        let near = |landmark: &ExpectedLandmark| {
            let (feature, distance) = self.nearest(&landmark.feature.descriptor, &mut distances)?;
            let du_px = feature.u_px - landmark.feature.u_px;
            let dv_px = feature.v_px - landmark.feature.v_px;
            (du_px.abs() <= rules.du_max_px && dv_px.abs() <= rules.dv_max_px).then_some((du_px, distance))
        };
        landmarks.iter().filter_map(near).collect()
    }

    /// Matches and votes of a node; the probability stays 0.
    fn vote(&self, landmarks: &[ExpectedLandmark], rules: &MatchRules) -> NodeMatch {
        let matches = self.matches(landmarks, rules);
        let agreeing = |du_px: f64| matches.iter().filter(move |(other, _)| (other - du_px).abs() <= rules.heading_px);
        let mut best = (0, None);
        for &(du_px, _) in &matches {
            let votes = agreeing(du_px).count();
            if votes > best.0 {
                best = (votes, Some(du_px));
            }
        }
        let voters: Vec<&(f64, u32)> = best.1.map_or_else(Vec::new, |du_px| agreeing(du_px).collect());
        let heading_px = best.1.map(|_| voters.iter().map(|(du_px, _)| du_px).sum::<f64>() / voters.len() as f64);
        NodeMatch {
            matches: matches.len() as u32,
            votes: voters.len() as u32,
            distance_bits: voters.iter().map(|(_, distance)| distance).sum(),
            heading_px,
            probability: 0.0,
        }
    }
}

/// The landmarks that are expected at a time: the `count` most probable. If probabilities are equal to nine decimals,
/// landmarks that were seen more often come first, then those of lower number. `of_landmarks`: for each landmark, the
/// probability that it is visible, and the share of its observations in which it was visible, 0 to 1.
#[must_use]
pub fn most_probable(of_landmarks: &[[f64; 2]], count: usize) -> Vec<usize> {
    let key = |index: &usize| of_landmarks.get(*index).map(|numbers| numbers.map(|number| (number * 1e9).round()));
    let mut order: Vec<usize> = (0..of_landmarks.len()).collect();
    // The sort is stable: a lower number goes first.
    order.sort_by(|a, b| {
        let [[a_first, a_then], [b_first, b_then]] = [key(a), key(b)].map(Option::unwrap_or_default);
        b_first.total_cmp(&a_first).then(b_then.total_cmp(&a_then))
    });
    order.truncate(count);
    order
}

/// The match of the features with each node, in the order of the nodes. Landmarks with descriptors of another length
/// than the features are an error.
///
/// # Errors
/// [`MixedDescriptors`]
pub fn localise(
    seen: &SeenFeatures,
    nodes: &[Vec<ExpectedLandmark>],
    rules: &MatchRules,
) -> Result<Vec<NodeMatch>, MixedDescriptors> {
    let expected = seen.features.first().map(|feature| feature.descriptor.len());
    let lengths = nodes.iter().flatten().map(|landmark| landmark.feature.descriptor.len());
    if let Some((found, expected)) =
        lengths.zip(expected.into_iter().cycle()).find(|(found, expected)| found != expected)
    {
        return Err(MixedDescriptors { found, expected });
    }
    let arch = Arch::new();
    let mut found: Vec<NodeMatch> = nodes.iter().map(|node| arch.dispatch(|| seen.vote(node, rules))).collect();
    let probabilities = probabilities(nodes, &found);
    for (node, probability) in found.iter_mut().zip(probabilities) {
        node.probability = probability;
    }
    Ok(found)
}

/// The node at which the robot is: the node with most votes, then most matches, then the smallest distance, then the
/// first. `None`: no landmark matches.
#[must_use]
pub fn best_node(nodes: &[NodeMatch]) -> Option<usize> {
    let voted = nodes.iter().enumerate().filter(|(_, node)| node.votes > 0);
    voted.rev().max_by_key(|(_, node)| node.rank()).map(|(index, _)| index)
}

/// The probability of each node.
fn probabilities(nodes: &[Vec<ExpectedLandmark>], found: &[NodeMatch]) -> Vec<f64> {
    let all: (f64, f64) = nodes.iter().zip(found).fold((0.0, 0.0), |(votes, of_all), (node, found)| {
        (votes + f64::from(found.votes), of_all + node.len() as f64)
    });
    let evidence = |(node, found): (&Vec<ExpectedLandmark>, &NodeMatch)| {
        let (votes, count) = (f64::from(found.votes), node.len() as f64);
        if count == 0.0 {
            return 0.0;
        }
        // Share of votes at the other nodes: one vote in twenty where there is little data.
        let chance = (all.0 - votes + 1.0) / (all.1 - count + 20.0);
        let there = node.iter().map(|landmark| landmark.visible).sum::<f64>() / count;
        let there = there.clamp(SURE, 1.0 - SURE).max(chance);
        let share = votes / count;
        let of_each = share * (there / chance).ln() + (1.0 - share) * ((1.0 - there) / (1.0 - chance)).ln();
        of_each * count.min(INDEPENDENT_VOTES)
    };
    let evidence: Vec<f64> = nodes.iter().zip(found).map(evidence).collect();
    let highest = evidence.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let odds: Vec<f64> = evidence.iter().map(|evidence| (evidence - highest).exp()).collect();
    let sum: f64 = odds.iter().sum();
    odds.into_iter().map(|odds| odds / sum).collect()
}

//! Votes and probabilities of nodes, against a plain search through all pairs.

use proptest::prelude::*;

use super::*;

fn feature((u, v, bits): (i32, i32, u16)) -> ImageFeature {
    let descriptor = Descriptor::new(&bits.to_le_bytes()).expect("two bytes");
    ImageFeature { u_px: f64::from(u), v_px: f64::from(v), descriptor }
}

fn expected(features: &[(i32, i32, u16)]) -> Vec<ExpectedLandmark> {
    features.iter().map(|&of_feature| ExpectedLandmark { feature: feature(of_feature), visible: 0.5 }).collect()
}

/// The result of [`localise`], computed directly from the rules.
fn plainly(seen: &[(i32, i32, u16)], node: &[(i32, i32, u16)]) -> (u32, u32, u32, Option<f64>) {
    let mut kept: Vec<(f64, u32)> = Vec::new();
    for (u, v, bits) in node {
        let mut near: Vec<(u32, usize)> =
            seen.iter().enumerate().map(|(index, other)| ((bits ^ other.2).count_ones(), index)).collect();
        near.sort_unstable();
        let [first, second, ..] = near[..] else { continue };
        let (other_u, other_v, _) = seen[first.1];
        let (du, dv) = (f64::from(other_u - u), f64::from(other_v - v));
        if 10 * first.0 < 9 * second.0 && du.abs() <= 400.0 && dv.abs() <= 30.0 {
            kept.push((du, first.0));
        }
    }
    let mut best: Vec<(f64, u32)> = Vec::new();
    for (du, _) in &kept {
        let group: Vec<(f64, u32)> = kept.iter().copied().filter(|(other, _)| (other - du).abs() <= 20.0).collect();
        if group.len() > best.len() {
            best = group;
        }
    }
    let heading = (!best.is_empty()).then(|| best.iter().map(|(du, _)| du).sum::<f64>() / best.len() as f64);
    (kept.len() as u32, best.len() as u32, best.iter().map(|(_, distance)| distance).sum(), heading)
}

fn features(count_max: usize) -> impl Strategy<Value = Vec<(i32, i32, u16)>> {
    prop::collection::vec((0..600, 0..60, any::<u16>()), 0..count_max)
}

proptest! {
    #[test]
    fn votes_are_those_of_the_rules(seen in features(40), nodes in prop::collection::vec(features(30), 0..4)) {
        let set = SeenFeatures::new(seen.iter().map(|&of_feature| feature(of_feature)).collect()).expect("of one length");
        let landmarks: Vec<Vec<ExpectedLandmark>> = nodes.iter().map(|node| expected(node)).collect();
        let found = localise(&set, &landmarks, &MatchRules::default()).expect("of one length");
        for (node, found) in nodes.iter().zip(&found) {
            let counted = (found.matches, found.votes, found.distance_bits, found.heading_px);
            prop_assert_eq!(counted, plainly(&seen, node));
            prop_assert!((0.0..=1.0).contains(&found.probability));
        }
        if !found.is_empty() {
            prop_assert!((found.iter().map(|node| node.probability).sum::<f64>() - 1.0).abs() < 1e-9);
        }
        let best = best_node(&found);
        prop_assert_eq!(best.is_some(), found.iter().any(|node| node.votes > 0));
        if let Some(best) = best {
            prop_assert!(found.iter().all(|node| node.votes <= found[best].votes));
        }
    }

    #[test]
    fn the_most_probable_come_first(numbers in prop::collection::vec((0_u8..4, 0_u8..4), 0..30), count in 0_usize..40) {
        let numbers: Vec<[f64; 2]> = numbers.iter().map(|&(p, g)| [f64::from(p) / 4.0, f64::from(g) / 4.0]).collect();
        let chosen = most_probable(&numbers, count);
        prop_assert_eq!(chosen.len(), count.min(numbers.len()));
        let rank = |index: usize| (numbers[index].map(|number| -number), index);
        prop_assert!(chosen.windows(2).all(|pair| rank(pair[0]) < rank(pair[1])));
        let last = chosen.last().map(|&last| rank(last));
        let left = (0..numbers.len()).filter(|index| !chosen.contains(index));
        prop_assert!(last.is_none_or(|last| left.map(rank).all(|other| other > last)));
    }
}

/// Ten landmarks that match nothing else.
fn ten() -> Vec<(i32, i32, u16)> {
    (0..10).map(|n| (n * 50, 20, 0b11 << n)).collect()
}

#[test]
fn a_robot_that_has_turned_is_found_with_its_heading() {
    let turned: Vec<ImageFeature> = ten().into_iter().map(|(u, v, bits)| feature((u + 130, v + 5, bits))).collect();
    let elsewhere: Vec<(i32, i32, u16)> = (0..10).map(|n| (n * 50, 20, 0b111_1000_0000_0000 ^ (0b101 << n))).collect();
    let set = SeenFeatures::new(turned).expect("of one length");
    let nodes = [expected(&elsewhere), expected(&ten())];
    let found = localise(&set, &nodes, &MatchRules::default()).expect("of one length");
    assert_eq!((best_node(&found), found[1].votes, found[1].heading_px), (Some(1), 10, Some(130.0)));
    assert!(found[1].probability > 0.9, "{found:?}");
}

#[test]
fn what_cannot_be_compared_or_found_is_an_error() {
    let long = Descriptor::new(&[1, 2, 3]).expect("three bytes");
    let other = ImageFeature { descriptor: long, ..feature((0, 0, 1)) };
    let mixed = MixedDescriptors { found: 3, expected: 2 };
    assert_eq!(SeenFeatures::new(vec![feature((0, 0, 1)), other]).expect_err("mixed"), mixed);
    let set = SeenFeatures::new(vec![feature((0, 0, 1)), feature((0, 0, 2))]).expect("of one length");
    let node = vec![ExpectedLandmark { feature: other, visible: 0.5 }];
    assert_eq!(localise(&set, &[node], &MatchRules::default()), Err(mixed));
    let nothing = SeenFeatures::new(Vec::new()).expect("nothing");
    let found =
        localise(&nothing, &[expected(&ten()), Vec::new()], &MatchRules::default()).expect("nothing to compare");
    assert_eq!(best_node(&found), None);
    // No feature was seen where one was expected.
    assert!(found[0].probability < found[1].probability, "{found:?}");
}

//! Times the search for a place among several by its landmarks.
//!
//! Invariant: descriptors are drawn from a fixed seed; half of the features of the picture are landmarks of one node.

use criterion::{Criterion, criterion_group, criterion_main};
use rand::{Rng as _, SeedableRng as _, rngs::SmallRng};
use tidemap_map::landmark::{Descriptor, ImageFeature};
use tidemap_plan::localise::{ExpectedLandmark, MatchRules, SeenFeatures, localise};

const FEATURES: usize = 500;
const NODES: usize = 8;

fn feature(rng: &mut SmallRng) -> ImageFeature {
    let bytes: [u8; 32] = rng.random();
    let descriptor = Descriptor::new(&bytes).expect("32 bytes");
    ImageFeature { u_px: rng.random_range(0.0..1024.0), v_px: rng.random_range(0.0..384.0), descriptor }
}

fn among_nodes(criterion: &mut Criterion) {
    let mut rng = SmallRng::seed_from_u64(1);
    for landmarks in [100, 500] {
        let nodes: Vec<Vec<ExpectedLandmark>> = (0..NODES)
            .map(|_| (0..landmarks).map(|_| ExpectedLandmark { feature: feature(&mut rng), visible: 0.5 }).collect())
            .collect();
        let known = nodes[0].iter().map(|landmark| landmark.feature).take(FEATURES / 2);
        let mut picture: Vec<ImageFeature> = known.collect();
        while picture.len() < FEATURES {
            picture.push(feature(&mut rng));
        }
        let seen = SeenFeatures::new(picture).expect("of one length");
        let name = format!("localise/{NODES} nodes, {landmarks} landmarks each, {FEATURES} features");
        criterion.bench_function(&name, |bencher| {
            bencher.iter(|| localise(&seen, &nodes, &MatchRules::default()).expect("of one length"));
        });
    }
}

criterion_group!(benches, among_nodes);
criterion_main!(benches);

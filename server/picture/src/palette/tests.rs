//! Checks which colours people can distinguish, and that the page has the same colours.
//!
//! Invariant: lightness and distances follow CIE L*a*b* (D65); kinds of colour vision are simulated.

use std::{env, fmt::Write as _, fs, path::Path};

use super::*;

type Matrix = [[f64; 3]; 3];

/// The appearance of linear light with one kind of cone missing, after Machado, Oliveira and Fernandes (2009).
const SEEN_BY: [(&str, Matrix); 4] = [
    ("normal", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    (
        "protan",
        [[0.152_286, 1.052_583, -0.204_868], [0.114_503, 0.786_281, 0.099_216], [-0.003_882, -0.048_116, 1.051_998]],
    ),
    (
        "deutan",
        [[0.367_322, 0.860_646, -0.227_968], [0.280_085, 0.672_501, 0.047_413], [-0.011_820, 0.042_940, 0.968_881]],
    ),
    (
        "tritan",
        [[1.255_528, -0.076_749, -0.178_779], [-0.078_411, 0.930_809, 0.147_602], [0.004_733, 0.691_367, 0.303_900]],
    ),
];

/// Converts linear light to X, Y and Z, each as a share of that of white.
const XYZ: Matrix =
    [[0.433_953, 0.376_219, 0.189_828], [0.212_673, 0.715_152, 0.072_175], [0.017_757, 0.109_468, 0.872_775]];

fn times(matrix: &Matrix, vector: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row.iter().zip(vector).map(|(weight, part)| weight * part).sum())
}

/// L*, a* and b* of a colour for a viewer.
fn lab(colour: Colour, seen_by: &Matrix) -> [f64; 3] {
    let linear = colour.map(|band| {
        let share = f64::from(band) / 255.0;
        if share <= 0.040_45 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
    });
    let seen = times(seen_by, linear).map(|light| light.clamp(0.0, 1.0));
    let [x, y, z] = times(&XYZ, seen)
        .map(|part| if part > 216.0 / 24_389.0 { part.cbrt() } else { part * 841.0 / 108.0 + 16.0 / 116.0 });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// The distance of two colours for a viewer; 2 can just be distinguished side by side.
fn apart(one: Colour, other: Colour, seen_by: &Matrix) -> f64 {
    let (one, other) = (lab(one, seen_by), lab(other, seen_by));
    one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt()
}

fn lightness(colour: Colour) -> f64 {
    lab(colour, &SEEN_BY[0].1)[0]
}

fn shares() -> impl Iterator<Item = f64> {
    (0..=254_u8).map(|step| f64::from(step) / 254.0)
}

#[test]
fn a_greater_probability_is_darker() {
    for (name, colour) in [("occupancy", occupancy as fn(f64) -> Colour), ("mark", mark), ("muted", |p| mix(&MUTED, p))]
    {
        // Where a scale is flat, steps of an eighth of a percent round to the same bytes.
        let lights: Vec<f64> = (0..=100_u8).map(|step| lightness(colour(f64::from(step) / 100.0))).collect();
        assert!(lights.windows(2).all(|pair| pair[1] < pair[0]), "{name}: {lights:?}");
    }
    let lights: Vec<f64> = shares().map(|share| lightness(occupancy(share))).collect();
    assert!(lights.windows(2).all(|pair| (0.1..1.0).contains(&(pair[0] - pair[1]))), "{lights:?}");
    assert_eq!((occupancy(0.0), occupancy(1.0)), ([255; 3], [0; 3]));
}

#[test]
fn nobody_takes_a_probability_for_unknown() {
    for (name, seen_by) in &SEEN_BY {
        for share in shares() {
            let apart = apart(occupancy(share), UNKNOWN, seen_by);
            assert!(apart > 12.0, "{name}: {share} is {apart:.1} from unknown");
        }
    }
}

#[test]
fn nobody_takes_an_uncertain_or_changed_cell_for_unknown() {
    let bits = |p: f64| if p > 0.0 && p < 1.0 { -(p * p.log2() + (1.0 - p) * (1.0 - p).log2()) } else { 0.0 };
    for (name, seen_by) in &SEEN_BY[..3] {
        for share in shares() {
            let apart = [
                apart(entropy(bits(share), share), UNKNOWN, seen_by),
                // A cell that became free or occupied, with a change of at least a fifth.
                apart(difference(-0.2 - 0.8 * share, 0.8 - 0.8 * share), UNKNOWN, seen_by),
                apart(difference(0.2 + 0.8 * share, 0.2 + 0.8 * share), UNKNOWN, seen_by),
            ];
            assert!(apart.iter().all(|&apart| apart > 6.0), "{name}: {share} is {apart:.1?} from unknown");
        }
    }
}

#[test]
fn everybody_can_distinguish_tenths() {
    for (name, seen_by) in &SEEN_BY {
        for tenth in 0..10_u8 {
            let [low, high] = [tenth, tenth + 1].map(|tenth| occupancy(f64::from(tenth) / 10.0));
            let apart = apart(low, high, seen_by);
            assert!(apart > 7.0, "{name}: {tenth} tenths and the next are {apart:.1} apart");
        }
    }
}

#[test]
fn everybody_can_distinguish_freer_from_fuller() {
    for (name, seen_by) in &SEEN_BY {
        for change in [0.2, 0.5, 1.0] {
            let apart = apart(difference(-change, 0.5 - change / 2.0), difference(change, 0.5 + change / 2.0), seen_by);
            assert!(apart > 25.0, "{name}: a change of {change} is {apart:.1} from its opposite");
        }
    }
}

#[test]
fn lines_can_be_seen_on_white_and_text_on_discs() {
    for (name, seen_by) in &SEEN_BY {
        for share in shares() {
            let colour = mark(share);
            assert!(apart(colour, [255; 3], seen_by) > 25.0, "{name}: {share} on white");
            let ink = if is_dark(colour) { [255; 3] } else { [0; 3] };
            let contrast = (lightness(colour) - lightness(ink)).abs();
            assert!(contrast > 40.0, "the text on {share}: {contrast:.0}");
        }
    }
}

#[test]
fn values_outside_are_clamped() {
    assert_eq!([-3.0, 3.0, f64::NAN].map(occupancy), [[255; 3], [0; 3], [255; 3]]);
    assert_eq!((entropy(7.0, 0.0), difference(-7.0, 0.0), difference(f64::NAN, 0.0)), (UNCERTAIN, FREER, [255; 3]));
}

/// The source code of the page's palette, with samples for a comparison with its painter.
fn page() -> String {
    let list = |stops: &[Colour]| {
        let rows: String = stops.iter().map(|[r, g, b]| format!("    [{r}, {g}, {b}],\n")).collect();
        format!("[\n{rows}]")
    };
    let mut text = "// The colours of pictures, made from server/picture/src/palette.rs: `make palette` writes them again.\n//\n// \
                    Invariant: as there; a test of the daemon's pictures holds this file equal.\n\n\
                    export type Colour = [red: number, green: number, blue: number];\n\n"
        .to_owned();
    let [low, high] = MARKS;
    let _ = write!(
        text,
        "/** A cell that was never observed. */\nexport const UNKNOWN_COLOUR: Colour = {UNKNOWN:?};\n\
         /** Probabilities of occupied from 0 to 1. */\nexport const OCCUPANCY: Colour[] = {};\n\
         /** The map below another layer. */\nexport const MUTED: Colour[] = {};\n\
         /** An entropy of one bit. */\nexport const UNCERTAIN: Colour = {UNCERTAIN:?};\n\
         /** Was occupied, is free. */\nexport const FREER: Colour = {FREER:?};\n\
         /** Was free, is occupied. */\nexport const FULLER: Colour = {FULLER:?};\n\
         /** The part of `OCCUPANCY` that lines and discs on white have. */\nexport const MARKS: [number, number] = [{low}, {high}];\n",
        list(&OCCUPANCY),
        list(&MUTED),
    );
    let sample = |value: f64, beneath: f64, colour: Colour| format!("    [{value}, {beneath}, {colour:?}],\n");
    let values = [0.0, 0.125, 0.25, 0.3, 0.5, 0.8, 1.0];
    let both = || values.into_iter().flat_map(move |value| values.map(|beneath| (value, beneath)));
    let entropies: String = both().map(|(value, beneath)| sample(value, beneath, entropy(value, beneath))).collect();
    let differences: String = both()
        .map(|(share, beneath)| (2.0 * share - 1.0, beneath))
        .map(|(value, beneath)| sample(value, beneath, difference(value, beneath)))
        .collect();
    let probabilities: String = values.map(|value| sample(value, value, occupancy(value))).concat();
    let marks: String = values.map(|value| sample(value, value, mark(value))).concat();
    let _ = write!(
        text,
        "\n/** Values of a layer, the probability beneath, and their colours: for tests. */\n\
         export const SAMPLES: Record<'probability' | 'entropy' | 'difference' | 'mark', [value: number, beneath: number, Colour][]> = {{\n    \
         probability: [\n{probabilities}],\n    entropy: [\n{entropies}],\n    difference: [\n{differences}],\n    mark: [\n{marks}],\n}};\n",
    );
    text
}

#[test]
fn the_page_has_the_same_colours() {
    let made = page();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../client/web/src/lib/palette.ts");
    if env::var_os("TIDEMAP_WRITE_PALETTE").is_some() {
        fs::write(&path, &made).expect("the file can be written");
    }
    let kept = fs::read_to_string(&path).unwrap_or_default();
    assert!(kept == made, "client/web/src/lib/palette.ts is not what the palette gives: run make palette and make web");
}

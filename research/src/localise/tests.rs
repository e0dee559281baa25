//! The recording of Stromovka gives the figures of its README; a small one is read with its faults.

use std::{fs, io::Write as _, path::PathBuf};

use flate2::{Compression, write::GzEncoder};

use super::*;

fn stromovka() -> LandmarkRecording {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/landmarks"));
    LandmarkRecording::read(&folder).expect("the recording")
}

fn found(scores: &LocaliseScores) -> Vec<usize> {
    scores.places.iter().map(|places| places.found).collect()
}

#[test]
fn the_baselines_find_as_many_places_as_the_reference() {
    let recording = stromovka();
    let models =
        [VisibilityModel::Mean, VisibilityModel::Yearly, VisibilityModel::NearestMonth, VisibilityModel::Season];
    let outcome = run(&recording, &models, &|_, _| ()).expect("figures");
    let expected = [
        ([49, 53, 55, 57, 57, 58], 0.2717, 0.103),
        ([51, 57, 57, 59, 59, 59], 0.3417, 0.113),
        ([52, 55, 56, 58, 59, 58], 0.2983, f64::NAN),
        ([54, 56, 57, 57, 59, 59], 0.3550, 0.099),
    ];
    assert_eq!(outcome.pictures, 60);
    for ((model, scores), (places, again, mse)) in outcome.models.iter().zip(expected) {
        assert_eq!(found(scores), places, "{}", model.name());
        assert!((scores.places[1].seen_again / 60.0 - again).abs() < 5e-5, "{}", model.name());
        assert!(mse.is_nan() || (scores.mse() - mse).abs() < 1e-3, "{} {}", model.name(), scores.mse());
    }
    let mean = &outcome.models[0].1.places;
    let headings: Vec<f64> = mean.iter().filter_map(FoundPlaces::heading_px).collect();
    for (heading_px, expected) in headings.iter().zip([4.4, 3.8, 3.3, 3.5, 2.9, 2.6]) {
        assert!((heading_px - expected).abs() < 0.051, "{headings:?}");
    }
    assert_eq!(mean.each_ref().map(|places| places.heading_wrong), [8, 4, 3, 2, 1, 1]);
}

#[test]
fn a_map_expects_the_landmarks_of_the_season() {
    let recording = stromovka();
    let models = [VisibilityModel::Mean, VisibilityModel::Auto];
    let mut all: Vec<LocaliseScores> = vec![LocaliseScores::default(); models.len()];
    // A month of snow and a green one.
    for month in [2, 8] {
        for (all, scores) in all.iter_mut().zip(held_out(&recording, &models, month).expect("figures")) {
            all.add(scores);
        }
    }
    let [mean, auto] = &all[..] else { panic!("two models") };
    assert!(auto.places[1].seen_again > 1.2 * mean.places[1].seen_again, "{mean:?} {auto:?}");
    assert!(auto.places.iter().zip(&mean.places).all(|(auto, mean)| auto.found >= mean.found), "{auto:?}");
}

/// A recording of one place in three months, in a new folder.
fn small(landmarks: &str) -> Result<LandmarkRecording, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let put = |name: &str, text: &str| {
        let mut bytes = text.as_bytes().to_vec();
        if name.ends_with(".gz") {
            let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
            packed.write_all(text.as_bytes()).expect("packed");
            bytes = packed.finish().expect("packed");
        }
        fs::write(folder.path().join(name), bytes).expect("written");
    };
    put("images.csv", "place,month,date,time\n1,1,a,0\n1,2,b,2592000\n1,3,c,5184000\n");
    put("features.csv.gz", "place,month,index,u,v,descriptor\n1,1,0,10,20,00ff\n1,2,0,30,20,00ff\n1,3,0,30,20,ff00\n");
    put("offsets.csv", "place,from_month,to_month,du\n1,1,2,20\n");
    put("landmarks.csv.gz", &format!("held_out,place,landmark,u,v,seen,descriptor\n{landmarks}"));
    LandmarkRecording::read(folder.path()).map_err(|error| error.to_string())
}

#[test]
fn what_is_wrong_in_a_recording_is_reported_with_its_line() {
    let recording = small("3,1,0,10,20,10-,00ff\n").expect("valid");
    assert_eq!((recording.places(), recording.months(), recording.offset_px(0, 1)), (1, 3, 20.0));
    for (landmarks, wrong) in [
        ("3,1,0,10,20,110,00ff\n", "line 2: seen is \"110\": it needs 3 marks, and - for the month held out"),
        ("3,1,0,10,20,1x-,00ff\n", "line 2: 'x' in seen is neither 1, 0 nor -"),
        ("3,2,0,10,20,11-,00ff\n", "line 2: place 2 in month 3 has no row"),
        ("3,1,0,inf,20,11-,00ff\n", "line 2: the position inf, 20 is not finite"),
        ("3,1,0,10,20,11-,0gff\n", "line 2: \"0gff\" is not hexadecimal"),
        ("3,1,0,10,20,11-,\n", "line 2: a descriptor of 0 bytes"),
    ] {
        let error = small(landmarks).expect_err(landmarks);
        assert!(error.contains(wrong), "{error}");
    }
}

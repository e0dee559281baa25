//! A file sent twice, a part of a file and then the whole, and a different file of the same name.

use std::fs;

use super::Door;

#[test]
fn a_file_that_was_sent_is_not_learned_twice() {
    let Some(door) = Door::new("Europe/London") else { return };
    door.learn();
    let before = [
        door.tidemap(["map", "show", "door"]).stdout,
        door.tidemap(["--output", "json", "model", "show", "door", "door"]).stdout,
    ];
    let again = door.observe(&door.file("train.csv"), &[]).table();
    assert_eq!(again.rows, [["96480", "0", "96480", "0"]]);
    let after = [
        door.tidemap(["map", "show", "door"]).stdout,
        door.tidemap(["--output", "json", "model", "show", "door", "door"]).stdout,
    ];
    assert_eq!(after, before);
}

#[test]
fn a_file_that_grew_goes_on_where_it_was() {
    let Some(door) = Door::new("Europe/London") else { return };
    let work = tempfile::tempdir().expect("a folder");
    let growing = work.path().join("train.csv");
    let whole = fs::read_to_string(door.file("train.csv")).expect("the recording");
    let rows: Vec<&str> = whole.lines().collect();
    // Cut in the middle of a row: an incomplete row is not read.
    let half = rows[..=40_000].join("\n") + "\n" + &rows[40_001][..9];
    fs::write(&growing, half).expect("a file");
    let first = door.observe(&growing, &[]);
    first.fails(1, &["line 40002", "incomplete", &rows[40_001][..9]]);
    assert_eq!(first.table_with(1).rows, [["40000", "40000", "0", "0"]]);
    fs::write(&growing, &whole).expect("a file");
    assert_eq!(door.observe(&growing, &[]).table().rows, [["96480", "56480", "40000", "0"]]);
    assert_eq!(door.tidemap(["map", "show", "door"]).table().number("observations"), 96_480.0);
}

#[test]
fn a_file_that_differs_is_refused_and_nothing_is_sent() {
    let Some(door) = Door::new("Europe/London") else { return };
    let work = tempfile::tempdir().expect("a folder");
    let file = work.path().join("train.csv");
    let whole = fs::read_to_string(door.file("train.csv")).expect("the recording");
    let rows: Vec<&str> = whole.lines().collect();
    fs::write(&file, rows[..=1_000].join("\n") + "\n").expect("a file");
    assert_eq!(door.observe(&file, &[]).table().number("accepted"), 1_000.0);

    let mut other = rows.clone();
    let changed = rows[7].replace(",0", ",1");
    assert_ne!(changed, rows[7]);
    other[7] = &changed;
    fs::write(&file, other.join("\n") + "\n").expect("a file");
    door.observe(&file, &[]).fails(1, &["train.csv", "that camera sent as train.csv", "nothing was sent"]);
    fs::write(&file, rows[..=500].join("\n") + "\n").expect("a file");
    door.observe(&file, &[]).fails(1, &["differs from the data that camera sent", "500", "1000"]);
    assert_eq!(door.tidemap(["map", "show", "door"]).table().number("observations"), 1_000.0);

    // With another label it counts as another file.
    fs::write(&file, other[..=20].join("\n") + "\n").expect("a file");
    assert_eq!(door.observe(&file, &["--label", "other"]).table().rows, [["20", "20", "0", "0"]]);
    assert_eq!(door.tidemap(["map", "show", "door"]).table().number("observations"), 1_020.0);
}

//! Times of files from names, lists and spacing.
//!
//! Invariant: expected times are written as UTC, computed by hand.

use super::*;

const HOUR: i64 = 3_600_000_000_000;
/// 2025-03-10T09:00:00Z.
const NINE: i64 = 1_741_597_200_000_000_000;

fn paths(names: &[&str]) -> Vec<PathBuf> {
    names.iter().map(|name| PathBuf::from("maps").join(name)).collect()
}

fn args() -> FileTimeArgs {
    FileTimeArgs { at: None, every: None, times_from: None, times_file: None, local: false, utc: false }
}

fn from(pattern: &str) -> FileTimeArgs {
    FileTimeArgs { times_from: Some(pattern.parse().expect(pattern)), ..args() }
}

/// The times of files in the order in which they are sent.
fn times(args: &FileTimeArgs, zone: &str, names: &[&str]) -> anyhow::Result<Vec<i64>> {
    let files = paths(names);
    let (timed, refused) = args.of(&files)?.resolve(zone, files.into_iter().map(|file| (file, ())).collect())?;
    assert_eq!(refused, [], "every time exists");
    Ok(timed.into_iter().map(|(_, (), time)| time).collect())
}

fn message<T: std::fmt::Debug>(result: anyhow::Result<T>) -> String {
    format!("{:#}", result.expect_err("an error"))
}

#[test]
fn each_file_has_a_time() -> anyhow::Result<()> {
    let at = FileTimeArgs { at: Some(100), ..args() };
    assert_eq!(times(&at, "UTC", &["a.pcd"])?, [100]);
    let every = FileTimeArgs { at: Some(100), every: Some(5), ..args() };
    assert_eq!(times(&every, "UTC", &["a.pcd", "c.pcd", "b.pcd"])?, [100, 105, 110]);
    assert!(message(times(&at, "UTC", &["a.pcd", "b.pcd"])).contains("--every"));
    let none = message(times(&args(), "UTC", &["a.pcd"]));
    assert!(none.contains("--at") && none.contains("--times-from"), "{none}");
    let far = FileTimeArgs { at: Some(100), every: Some(i64::MAX), ..args() };
    assert!(message(times(&far, "UTC", &["a", "b", "c"])).contains("2262"));
    Ok(())
}

#[test]
fn names_with_a_zone_have_their_times_wherever_the_map_is() -> anyhow::Result<()> {
    for (pattern, name) in [
        ("map_%Y%m%d_%H%M%S%z.yaml", "map_20250310_100000+0100.yaml"),
        ("map_%s.yaml", "map_1741597200.yaml"),
        ("%s.%f.pcd", "1741597200.000000000.pcd"),
        ("*_%s.*", "map_of_hall_7_1741597200.pgm"),
    ] {
        assert_eq!(times(&from(pattern), "Europe/Berlin", &[name])?, [NINE], "{pattern}");
    }
    let half = times(&from("%s%.f.pcd"), "UTC", &["1741597200.5.pcd"])?;
    assert_eq!(half, [NINE + 500_000_000]);
    let unneeded = FileTimeArgs { local: true, ..from("%s.pcd") };
    assert!(message(times(&unneeded, "UTC", &["1.pcd"])).contains("leave it out"));
    Ok(())
}

#[test]
fn names_without_a_zone_need_a_word() -> anyhow::Result<()> {
    let pattern = "*_%Y%m%d_%H%M%S.yaml";
    let names = ["hall_20250310_100000.yaml", "hall_20250310_090000.yaml"];
    let error = message(times(&from(pattern), "Europe/Berlin", &names));
    assert!(error.contains("--local") && error.contains("hall_20250310_100000.yaml"), "{error}");
    let local = FileTimeArgs { local: true, ..from(pattern) };
    // In Berlin it is an hour later; the files are sent in the order of their times.
    assert_eq!(times(&local, "Europe/Berlin", &names)?, [NINE - HOUR, NINE]);
    let utc = FileTimeArgs { utc: true, ..from(pattern) };
    assert_eq!(times(&utc, "Europe/Berlin", &names)?, [NINE, NINE + HOUR]);
    let days = FileTimeArgs { utc: true, ..from("%Y-%m-%d.yaml") };
    assert_eq!(times(&days, "UTC", &["2025-03-10.yaml"])?, [NINE - 9 * HOUR], "a day begins at midnight");
    Ok(())
}

#[test]
fn the_hour_that_exists_twice_follows_the_order_and_the_other_refuses_its_file_only() -> anyhow::Result<()> {
    let local = FileTimeArgs { local: true, ..from("*_%Y%m%d_%H%M.yaml") };
    let twice = ["1_20251026_0200.yaml", "2_20251026_0230.yaml", "3_20251026_0200.yaml", "4_20251026_0300.yaml"];
    // 2025-10-26T00:00:00Z is 02:00 in Berlin for the first time.
    let first = 1_761_436_800_000_000_000;
    assert_eq!(times(&local, "Europe/Berlin", &twice)?, [0, HOUR / 2, HOUR, 2 * HOUR].map(|after| first + after));
    let files = paths(&["1_20250330_0130.yaml", "2_20250330_0230.yaml", "3_20250330_0330.yaml"]);
    let named = files.iter().cloned().map(|file| (file, ())).collect();
    let (timed, refused) = local.of(&files)?.resolve("Europe/Berlin", named)?;
    // 2025-03-30T00:30:00Z is 01:30 in Berlin, and an hour later 03:30.
    let before = 1_743_294_600_000_000_000;
    assert_eq!(timed.iter().map(|(_, (), time)| *time).collect::<Vec<_>>(), [before, before + HOUR]);
    let [(file, why)] = &refused[..] else { panic!("one file is refused: {refused:?}") };
    assert_eq!(file, &files[1]);
    assert!(why.contains("does not exist in Europe/Berlin"), "{why}");
    Ok(())
}

#[test]
fn a_name_that_does_not_match_is_refused_with_the_pattern() {
    let files = ["map_20250310_090000.yaml", "map_20251310_090000.yaml"];
    let error = message(times(&FileTimeArgs { utc: true, ..from("map_%Y%m%d_%H%M%S.yaml") }, "UTC", &files));
    assert!(error.contains("\"map_20251310_090000.yaml\"") && error.contains("\"map_%Y%m%d_%H%M%S.yaml\""), "{error}");
    for early in ["map_-5.yaml", "map_99999999999999.yaml", "map_.yaml", "map_5.yaml.bak", "xmap_5.yaml"] {
        assert!(times(&from("map_%s.yaml"), "UTC", &[early]).is_err(), "{early}");
    }
}

#[test]
fn a_pattern_has_a_time() {
    for wrong in ["map.yaml", "", "*", "%H%M.yaml", "a*b_%s", "%Y.yaml", "map_%Q.yaml", "%"] {
        let error = wrong.parse::<NamePattern>().expect_err(wrong);
        assert!(error.contains("map_%Y%m%d_%H%M%S.yaml"), "{wrong}: {error}");
    }
}

#[test]
fn a_list_has_a_time_for_each_file() -> anyhow::Result<()> {
    let files = paths(&["b.yaml", "a.yaml"]);
    let list = "time,file\n1741597200,a.yaml\n2025-03-10T10:00:00,maps/b.yaml\n5,c.yaml\n";
    let clock = "2025-03-10T10:00:00".parse()?;
    assert_eq!(listed(list, &files)?, [FileTime::Clock(clock), FileTime::Utc(NINE)]);
    assert!(message(listed("file,time\na.yaml,5\n", &files)).contains("no time for \"b.yaml\""));
    assert!(message(listed("a.yaml,5\n", &files)).contains("header file,time"));
    assert!(message(listed("", &files)).contains("empty"));
    assert!(message(listed("file,time\na.yaml,soon\n", &files)).contains("line 2: \"soon\""));
    assert!(message(listed("file,time\na.yaml,5\na.yaml,6\n", &files)).contains("line 3: \"a.yaml\" has another"));
    Ok(())
}

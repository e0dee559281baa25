//! Updates that learn very much: updates of other maps have their turns meanwhile, and metrics show what waits.

use std::fs;

use tempfile::tempdir;
use tidemap_client::updates::JobState;
use tidemap_tests::{
    cli::tidemap,
    daemon::{Daemon, Launch},
    oracle::run_update,
    web::request,
};

/// Number of doors, each row of which represents almost a million readings.
const DOORS: usize = 20;

/// A map with doors that report changes, read off every second; each has a row, and one 11 days later.
fn heavy_map(daemon: &Daemon, folder: &std::path::Path) {
    tidemap(daemon, ["map", "create", "heavy", "--clock", "simulated"]).table();
    let rows: Vec<String> = (0..DOORS).flat_map(|door| [format!("0,d{door},1"), format!("950000,d{door},0")]).collect();
    let file = folder.join("heavy.csv");
    fs::write(&file, format!("time,state,value\n{}\n", rows.join("\n"))).expect("written");
    let path = file.display().to_string();
    let observe = ["observe", "heavy", &path, "--producer", "robot-1", "--changes"];
    let hold = ["--hold-max", "11d", "--hold-step", "1s"];
    tidemap(daemon, observe.into_iter().chain(hold)).table();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_long_update_of_one_map_does_not_hold_up_another() {
    let data = tempdir().expect("a folder");
    let daemon = Launch::on(data.path()).start();
    heavy_map(&daemon, data.path());
    tidemap(&daemon, ["map", "create", "light", "--clock", "simulated"]).table();
    let file = data.path().join("light.csv");
    fs::write(&file, "time,state,value\n0,door,1\n90000,door,0\n").expect("written");
    let path = file.display().to_string();
    tidemap(&daemon, ["observe", "light", &path, "--producer", "robot-2"]).table();

    let client = daemon.client();
    let long = client.run_update("heavy", None).await.expect("an update");
    run_update(&client, "light", None).await;
    let long = client.job(long.id).await.expect("known");
    assert_eq!(long.state, JobState::Running, "a short update waits for no long one: {long:?}");

    // The number of waiting readings is in the metrics and among the counters of the map, as soon as a part has ended.
    let metrics = request(&daemon.http, "GET", "/metrics", &[], b"").text();
    for name in ["tidemap_waiting_rows", "tidemap_updates_waiting_turn"] {
        assert!(metrics.lines().any(|line| line.starts_with(name)), "{name} is not in\n{metrics}");
    }
    let counters = tidemap(&daemon, ["stats", "heavy"]).stdout;
    assert!(counters.contains("waiting_rows"), "{counters}");
    // The update would go on for minutes: it begins again at the next start.
    daemon.kill();
}

//! Settings from outside: which source has priority, and the messages of wrong ones.

use std::{fs, net::TcpListener, path::Path};

use tempfile::tempdir;
use tidemap_tests::daemon::Launch;

const LOOPBACK: [&str; 4] = ["--listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0"];

/// Whether a daemon has created its data in this folder.
fn is_data(folder: &Path) -> bool {
    folder.join("MANIFEST").is_file()
}

#[test]
fn flags_win_over_the_environment_and_that_over_the_file() {
    let work = tempdir().expect("a folder");
    let folder = |name: &str| work.path().join(name);
    let config = folder("tidemapd.toml");
    let text = format!(
        "data_dir = {:?}\nlisten = \"127.0.0.1:0\"\nhttp_listen = \"127.0.0.1:0\"\n",
        folder("by-file").display().to_string()
    );
    fs::write(&config, text).expect("a config file");
    let by_file = Launch::bare().args(["--config"]).args([config.as_os_str()]).working_directory(work.path());
    by_file.start().stop_in_order();
    assert!(is_data(&folder("by-file")));

    let by_environment = by_file.setting("data_dir", folder("by-environment").display());
    fs::remove_dir_all(folder("by-file")).expect("the data of the file");
    by_environment.start().stop_in_order();
    assert!(is_data(&folder("by-environment")) && !folder("by-file").exists());

    let by_flag = by_environment.args(["--data-dir".as_ref(), folder("by-flag").as_os_str()]);
    fs::remove_dir_all(folder("by-environment")).expect("the data of the environment");
    by_flag.start().stop_in_order();
    assert!(is_data(&folder("by-flag")) && !folder("by-environment").exists());
}

#[test]
fn the_config_file_can_be_named_by_the_environment() {
    let work = tempdir().expect("a folder");
    let config = work.path().join("tidemapd.toml");
    fs::write(&config, "data_dir = 'here'\nlisten = '127.0.0.1:0'\nhttp_listen = '127.0.0.1:0'\n").expect("a file");
    let launch = Launch::bare().setting("config", config.display()).working_directory(work.path());
    launch.start().stop_in_order();
    assert!(is_data(&work.path().join("here")));
}

#[test]
fn without_settings_the_data_is_in_a_folder_here() {
    let work = tempdir().expect("a folder");
    Launch::bare().args(LOOPBACK).working_directory(work.path()).start().stop_in_order();
    assert!(is_data(&work.path().join("tidemap-data")));
}

#[test]
fn wrong_settings_are_named_and_nothing_is_created() {
    let work = tempdir().expect("a folder");
    let data = work.path().join("data");
    let launch = || Launch::on(&data).working_directory(work.path());
    let config = |name: &str, text: &str| {
        let file = work.path().join(name);
        fs::write(&file, text).expect("a config file");
        launch().args(["--config".as_ref(), file.as_os_str()])
    };
    let cases = [
        (config("1.toml", "lisen = '127.0.0.1:0'"), "lisen"),
        (config("2.toml", "max_maps = 'many'"), "max_maps"),
        (config("3.toml", "max_maps = 7\nthis is not TOML"), "3.toml"),
        (launch().args(["--config", "absent.toml"]), "absent.toml"),
        (launch().setting("max_maps", 0), "max_maps"),
        (launch().setting("segment_bytes", 1), "segment_bytes"),
        (launch().setting("max_states_per_map", "some"), "MAX_STATES_PER_MAP"),
        (launch().setting("log_level", "tidemapd=loud"), "log_level"),
        (launch().setting("log_level", "inf"), "log_level"),
        (config("4.toml", "log_level = 'inf'"), "log_level"),
        (launch().args(["--log-level", "inf"]), "log_level"),
        (launch().args(["--log-level", "inf", "config"]), "log_level"),
        (launch().setting("http_hosts", "[\"http://maps.example.org\"]"), "http_hosts"),
        (launch().args(["--listen", "here"]), "listen"),
        (launch().args(["--http-listen", "127.0.0.1:http"]), "http_listen"),
    ];
    for (launch, word) in cases {
        let exit = launch.try_start().expect_err(word);
        assert_eq!(exit.code(), Some(78), "{word}: {exit}");
        assert!(exit.stderr.contains(word), "{word:?} is not in {exit}");
        assert!(!exit.stderr.contains("panicked"), "{exit}");
        assert!(!data.exists(), "{word}: something was created");
    }
}

#[test]
fn ports_beyond_this_machine_are_refused() {
    let work = tempdir().expect("a folder");
    let data = work.path().join("data");
    for (flag, address) in [
        ("--listen", "0.0.0.0:0"),
        ("--listen", "[::]:0"),
        ("--listen", "example.org:0"),
        ("--http-listen", "0.0.0.0:0"),
    ] {
        let exit = Launch::on(&data).args([flag, address]).try_start().expect_err("reachable from elsewhere");
        assert_eq!(exit.code(), Some(78), "{address}: {exit}");
        for word in [address, "allow-insecure-remote"] {
            assert!(exit.stderr.contains(word), "{word:?} is not in {exit}");
        }
        assert!(!data.exists());
    }
}

#[test]
fn wrong_usage_is_distinguished_from_wrong_settings() {
    for args in [["--lisen", "127.0.0.1:0"], ["--log-format", "xml"]] {
        let exit = Launch::bare().args(args).try_start().expect_err("no such option");
        assert_eq!(exit.code(), Some(2), "{exit}");
        assert!(exit.stderr.contains(args[0]), "{exit}");
    }
}

#[test]
fn a_port_that_is_taken_is_named() {
    let data = tempdir().expect("a folder");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    for flag in ["--listen", "--http-listen"] {
        let exit = Launch::on(data.path()).args([flag, &address]).try_start().expect_err("the port is taken");
        assert_eq!(exit.code(), Some(69), "{exit}");
        assert!(exit.stderr.contains(&address), "{exit}");
    }
    Launch::on(data.path()).start().stop_in_order();
}

#[test]
fn a_data_folder_that_cannot_be_made_is_named() {
    let work = tempdir().expect("a folder");
    let file = work.path().join("file");
    fs::write(&file, "not a folder").expect("a file");
    let exit = Launch::on(&file.join("data")).try_start().expect_err("a file is in the way");
    assert_eq!(exit.code(), Some(65), "{exit}");
    assert!(exit.stderr.contains("file"), "{exit}");
    assert!(!exit.stderr.contains("panicked"), "{exit}");
}

#[test]
fn a_new_data_folder_gives_no_warning() {
    let work = tempdir().expect("a folder");
    let log = Launch::on(&work.path().join("data")).start().stop_in_order();
    assert!(log.contains("new data folder") && log.contains("expect_store_id"), "{log}");
    assert!(!log.contains("WARN") && !log.contains("ERROR"), "{log}");
}

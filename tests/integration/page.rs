//! The page, in a real browser against a real daemon with an office of its own: `client/web/e2e/page.mjs`.

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use tempfile::tempdir;
use tidemap_tests::binaries::{tidemap, tidemapd};

/// Whether a program can be started.
fn runs(program: &OsStr) -> bool {
    Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// The folder of the page's source, or what is missing to test it.
fn tools() -> Result<PathBuf, &'static str> {
    let web = Path::new(env!("CARGO_MANIFEST_DIR")).join("../client/web");
    let chromium = env::var_os("TIDEMAP_CHROMIUM").unwrap_or_else(|| "/usr/bin/chromium".into());
    if !runs(OsStr::new("node")) {
        return Err("there is no node");
    }
    if !["playwright-core", "axe-core"].iter().all(|name| web.join("node_modules").join(name).is_dir()) {
        return Err("client/web/node_modules is not installed: deploy/setup.sh test");
    }
    if !runs(&chromium) {
        return Err("there is no Chromium at /usr/bin/chromium or $TIDEMAP_CHROMIUM");
    }
    Ok(web)
}

#[test]
fn the_page_shows_an_office_in_a_browser() {
    let web = match tools() {
        Ok(web) => web,
        Err(reason) => return println!("SKIPPED: {reason}"),
    };
    let folder = tempdir().expect("a folder");
    // The pictures of the guide are made here, if they are requested.
    let kept = env::var_os("TIDEMAP_PAGE_PICTURES").map_or_else(|| folder.path().to_owned(), PathBuf::from);
    let output = Command::new("node")
        .current_dir(&web)
        .args([Path::new("e2e/page.mjs"), &tidemapd(), &tidemap(), &kept])
        .output()
        .expect("node runs");
    let (printed, problem) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{printed}{problem}");
    assert_eq!(printed.matches("ok  ").count(), CHECKS, "{printed}");
}

/// Number of checks that the script makes.
const CHECKS: usize = 38;

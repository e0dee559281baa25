//! `tidemap open`: the daemon's page in a browser.
//!
//! Invariant: the address is printed first, so that it is of use on a machine without a browser, too.

use std::{
    env,
    ffi::OsString,
    process::{Command, ExitCode, Stdio},
};

use super::usage;

/// The HTTP port that a daemon has by default.
const HTTP_PORT: u16 = 7436;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct OpenArgs {
    /// Name of a map [default: the list of maps]
    #[arg(value_name = "MAP")]
    map: Option<String>,
    /// Address of the daemon's HTTP port [default: port 7436 of the machine that --server names]
    #[arg(long, value_name = "URL", env = "TIDEMAP_PAGE")]
    page: Option<String>,
    /// Prints the address only
    #[arg(long)]
    print: bool,
}

/// The host of `--server`, with brackets if it has them; `None` for a Unix socket.
fn host(server: &str) -> Option<&str> {
    if server.starts_with("unix:") {
        return None;
    }
    let authority = server.split_once("://").map_or(server, |(_, rest)| rest).trim_end_matches('/');
    Some(match authority.rsplit_once(':') {
        Some((host, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => host,
        _ => authority,
    })
}

/// Names of maps have no characters that an address would have to escape; others are refused by the page.
fn address(args: &OpenArgs, server: &str) -> String {
    let page = args.page.as_ref().map(|page| match page.split_once("://") {
        Some(_) => page.trim_end_matches('/').to_owned(),
        None => format!("http://{}", page.trim_end_matches('/')),
    });
    let page = page.unwrap_or_else(|| format!("http://{}:{HTTP_PORT}", host(server).unwrap_or("127.0.0.1")));
    args.map.as_ref().map_or_else(|| format!("{page}/"), |map| format!("{page}/maps/{map}"))
}

/// The program that opens addresses here: `$BROWSER`, or that of the desktop.
fn opener() -> OsString {
    let desktop = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    env::var_os("BROWSER").filter(|program| !program.is_empty()).unwrap_or_else(|| desktop.into())
}

/// Prints the address and opens it.
///
/// # Errors
/// The name of the map is none.
pub(crate) fn run(args: &OpenArgs, server: &str) -> anyhow::Result<ExitCode> {
    if let Some(map) = &args.map
        && !map.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_-".contains(&byte))
    {
        return Err(usage(format!("{map:?} is no name of a map: these consist of a-z, 0-9, _ and -")));
    }
    let address = address(args, server);
    println!("{address}");
    if args.print {
        return Ok(ExitCode::SUCCESS);
    }
    let opener = opener();
    let mut command = Command::new(&opener);
    command.arg(&address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if let Err(error) = command.spawn() {
        eprintln!("{} could not be started ({error}); open this address in a browser", opener.to_string_lossy());
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opened(map: Option<&str>, page: Option<&str>, server: &str) -> String {
        let args = OpenArgs { map: map.map(str::to_owned), page: page.map(str::to_owned), print: true };
        address(&args, server)
    }

    #[test]
    fn the_page_is_on_the_machine_of_the_server() {
        assert_eq!(opened(None, None, "http://127.0.0.1:7435"), "http://127.0.0.1:7436/");
        assert_eq!(opened(Some("home"), None, "https://robots.example:443/"), "http://robots.example:7436/maps/home");
        assert_eq!(opened(None, None, "[::1]:7435"), "http://[::1]:7436/");
        assert_eq!(opened(None, None, "unix:/run/tidemap.sock"), "http://127.0.0.1:7436/");
    }

    #[test]
    fn the_page_can_be_named() {
        assert_eq!(opened(Some("home"), Some("10.0.0.5:80/"), "unix:x"), "http://10.0.0.5:80/maps/home");
        assert_eq!(opened(None, Some("https://tide.example"), "unix:x"), "https://tide.example/");
    }
}

//! `tidemap open`: the daemon's page in a browser.
//!
//! Invariant: the address is printed first, so that it is of use on a machine without a browser, too.

use std::{
    env,
    ffi::OsString,
    net::{ToSocketAddrs as _, UdpSocket},
    process::{Command, ExitCode, Stdio},
};

use jiff::Timestamp;
use tidemap_client::{Client, Error, updates::PagePort};
use tonic::Code;

use super::{UsageError, times::time, usage};
use crate::{output, progress::status_line};

/// The HTTP port that a daemon has by default.
const HTTP_PORT: u16 = 7436;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct OpenArgs {
    /// Name of a map [default: the list of maps]
    #[arg(value_name = "MAP")]
    map: Option<String>,
    /// Time that the page shows [default: now, or the newest data where these are old]
    #[arg(long, value_name = "TIME", value_parser = time, requires = "map")]
    at: Option<i64>,
    /// Address of the daemon's HTTP port, without a request to the daemon for it
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

/// Whether a name or an address is this machine.
fn is_here(host: &str) -> bool {
    let resolved = (host.trim_matches(['[', ']']), 0).to_socket_addrs();
    // Only own addresses can be bound.
    resolved.is_ok_and(|mut found| found.any(|address| UdpSocket::bind(address).is_ok()))
}

/// The address of the page of a daemon.
///
/// # Errors
/// The page is served to the daemon's own machine alone, which is another one.
fn served(server: &str, page: &PagePort) -> Result<String, UsageError> {
    let PagePort { port, is_loopback, has_tls, host: bound } = page;
    let target = host(server).unwrap_or("127.0.0.1");
    let is_name_of_loopback = ["127.0.0.1", "localhost", "[::1]"].contains(&target);
    if *is_loopback && !is_name_of_loopback && !is_here(target) {
        return Err(UsageError(format!(
            "the page of {target} is served to that machine alone, on port {port}. Forward the port with ssh -L \
             {port}:127.0.0.1:{port} {target}, and then open it with tidemap open --page 127.0.0.1:{port}; or let the \
             daemon serve it to others, with TLS and tokens (docs/src/security.md)"
        )));
    }
    let host = match (bound.as_str(), is_loopback) {
        ("", true) if !is_name_of_loopback => "127.0.0.1".to_owned(),
        ("", _) => target.to_owned(),
        (address, _) if address.contains(':') => format!("[{address}]"),
        (address, _) => address.to_owned(),
    };
    Ok(format!("{}://{host}:{port}", if *has_tls { "https" } else { "http" }))
}

/// The port that the daemon reports, or the default port if the token may not query it.
async fn page_of(client: &Client, map: &str) -> anyhow::Result<PagePort> {
    match client.page_port(map).await {
        Ok(Some(page)) => Ok(page),
        Ok(None) => Err(usage("the daemon is too old to name its page: give the address with --page HOST:PORT")),
        Err(Error::Server(error)) if error.code == Code::PermissionDenied => {
            status_line("the token does not allow a request for the address of the page: this is the default port");
            Ok(PagePort { port: HTTP_PORT, is_loopback: false, has_tls: true, host: String::new() })
        }
        Err(error) => Err(error.into()),
    }
}

/// The page at an address that was named.
fn named(page: &str) -> String {
    match page.split_once("://") {
        Some(_) => page.trim_end_matches('/').to_owned(),
        None => format!("http://{}", page.trim_end_matches('/')),
    }
}

/// Names of maps have no characters that an address would have to escape.
fn address(page: &str, map: Option<&str>, at: Option<i64>) -> String {
    let Some(map) = map else { return format!("{page}/") };
    let shown = at.and_then(|nanos| Timestamp::from_nanosecond(i128::from(nanos)).ok());
    shown.map_or_else(|| format!("{page}/maps/{map}"), |time| format!("{page}/maps/{map}?at={time}"))
}

/// The program that opens addresses here: `$BROWSER`, or the opener of the desktop.
fn opener() -> OsString {
    let desktop = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    env::var_os("BROWSER").filter(|program| !program.is_empty()).unwrap_or_else(|| desktop.into())
}

/// Prints the address and opens it.
///
/// # Errors
/// The daemon does not answer, or has no such map; its page cannot be reached from here.
pub(crate) async fn run(client: &Client, args: &OpenArgs, server: &str) -> anyhow::Result<ExitCode> {
    let map = args.map.as_deref();
    let is_name_byte = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"_-".contains(&byte);
    if let Some(map) = map.filter(|map| !map.bytes().all(is_name_byte)) {
        return Err(usage(format!("{map:?} is no name of a map: these consist of a-z, 0-9, _ and -")));
    }
    let page = match &args.page {
        Some(page) => named(page),
        None => served(server, &page_of(client, map.unwrap_or_default()).await?)?,
    };
    let address = address(&page, map, args.at);
    output::print(&format!("{address}\n"))?;
    if args.print {
        return Ok(ExitCode::SUCCESS);
    }
    let opener = opener();
    let mut command = Command::new(&opener);
    command.arg(&address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if let Err(error) = command.spawn() {
        let opener = opener.to_string_lossy();
        status_line(&format!("{opener} could not be started ({error}); open this address in a browser"));
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(port: u16, is_loopback: bool, host: &str) -> PagePort {
        PagePort { port, is_loopback, has_tls: !is_loopback, host: host.to_owned() }
    }

    #[test]
    fn the_page_is_on_the_machine_of_the_server() {
        for (server, page, expected) in [
            ("http://127.0.0.1:7435", page(7436, true, ""), "http://127.0.0.1:7436"),
            ("http://localhost:7435", page(7436, true, ""), "http://localhost:7436"),
            ("[::1]:7435", page(7436, true, ""), "http://[::1]:7436"),
            ("unix:/run/tidemap.sock", page(7436, true, ""), "http://127.0.0.1:7436"),
            ("127.0.0.2:7435", page(7436, true, ""), "http://127.0.0.1:7436"),
            ("https://robots.example:7435/", page(443, false, ""), "https://robots.example:443"),
            ("127.0.0.1:7435", page(443, false, "192.168.1.5"), "https://192.168.1.5:443"),
            ("127.0.0.1:7435", page(443, false, "fe80::1"), "https://[fe80::1]:443"),
        ] {
            assert_eq!(served(server, &page).expect("a page"), expected);
        }
        assert_eq!(address("http://h:1", Some("home"), None), "http://h:1/maps/home");
        let noon = 1_741_348_800_000_000_000;
        assert_eq!(address("http://h:1", Some("home"), Some(noon)), "http://h:1/maps/home?at=2025-03-07T12:00:00Z");
        assert_eq!(address("http://h:1", None, None), "http://h:1/");
    }

    #[test]
    fn a_page_of_another_machine_alone_is_refused_with_what_to_do() {
        let message = served("https://192.0.2.7:7435", &page(7436, true, "")).expect_err("not here").to_string();
        assert!(message.contains("ssh -L 7436:127.0.0.1:7436 192.0.2.7"), "{message}");
    }

    #[test]
    fn the_page_can_be_named() {
        assert_eq!(named("10.0.0.5:80/"), "http://10.0.0.5:80");
        assert_eq!(named("https://tide.example"), "https://tide.example");
    }
}

//! `tidemap open`: the daemon's page in a browser.
//!
//! Invariant: the address is printed first, so that it is of use on a machine without a browser, too.

use std::{
    env,
    ffi::OsString,
    process::{Command, ExitCode, Stdio},
};

use tidemap_client::{Client, updates::PagePort};

use super::{UsageError, usage};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct OpenArgs {
    /// Name of a map [default: the list of maps]
    #[arg(value_name = "MAP")]
    map: Option<String>,
    /// Address of the daemon's HTTP port, without asking the daemon for it
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

/// The address of the page of a daemon.
///
/// # Errors
/// The page is served to the daemon's own machine alone, which is another one.
fn served(server: &str, port: PagePort) -> Result<String, UsageError> {
    let host = host(server);
    let is_here = host.is_none_or(|host| ["127.0.0.1", "localhost", "[::1]"].contains(&host));
    let PagePort { port, is_loopback, has_tls } = port;
    if is_loopback && !is_here {
        let host = host.unwrap_or_default();
        return Err(UsageError(format!(
            "the page of {host} is served to that machine alone, on port {port}. Start the daemon with --http-listen \
             0.0.0.0:{port} (docs: access), or forward the port: ssh -L {port}:127.0.0.1:{port} {host}, and then \
             tidemap open --page 127.0.0.1:{port}"
        )));
    }
    let scheme = if has_tls { "https" } else { "http" };
    Ok(format!("{scheme}://{}:{port}", host.unwrap_or("127.0.0.1")))
}

/// The page at an address that was named.
fn named(page: &str) -> String {
    match page.split_once("://") {
        Some(_) => page.trim_end_matches('/').to_owned(),
        None => format!("http://{}", page.trim_end_matches('/')),
    }
}

/// Names of maps have no characters that an address would have to escape.
fn address(page: &str, map: Option<&str>) -> String {
    map.map_or_else(|| format!("{page}/"), |map| format!("{page}/maps/{map}"))
}

/// The program that opens addresses here: `$BROWSER`, or that of the desktop.
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
        None => match client.page_port(map.unwrap_or_default()).await? {
            Some(port) => served(server, port)?,
            None => return Err(usage("the daemon is too old to say where its page is: name it with --page HOST:PORT")),
        },
    };
    let address = address(&page, map);
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

    const HERE: PagePort = PagePort { port: 7436, is_loopback: true, has_tls: false };

    #[test]
    fn the_page_is_on_the_machine_of_the_server() {
        let everywhere = PagePort { port: 443, is_loopback: false, has_tls: true };
        for (server, port, page) in [
            ("http://127.0.0.1:7435", HERE, "http://127.0.0.1:7436"),
            ("http://localhost:7435", HERE, "http://localhost:7436"),
            ("[::1]:7435", HERE, "http://[::1]:7436"),
            ("unix:/run/tidemap.sock", HERE, "http://127.0.0.1:7436"),
            ("https://robots.example:7435/", everywhere, "https://robots.example:443"),
        ] {
            assert_eq!(served(server, port).expect("a page"), page);
        }
        assert_eq!(address("http://h:1", Some("home")), "http://h:1/maps/home");
        assert_eq!(address("http://h:1", None), "http://h:1/");
    }

    #[test]
    fn a_page_of_another_machine_alone_is_refused_with_what_to_do() {
        let message = served("https://robots.example:7435", HERE).expect_err("not here").to_string();
        assert!(message.contains("ssh -L 7436:127.0.0.1:7436 robots.example"), "{message}");
    }

    #[test]
    fn the_page_can_be_named() {
        assert_eq!(named("10.0.0.5:80/"), "http://10.0.0.5:80");
        assert_eq!(named("https://tide.example"), "https://tide.example");
    }
}

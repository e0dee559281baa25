//! The origins from which browsers may send requests to the HTTP port: pages of the port itself.
//!
//! Invariant: a page of another origin gets no answer that it could read, and changes nothing. A page that reaches the
//! port by a name of its own (DNS rebinding) is refused, because only known names are accepted; addresses are always
//! known.

use std::{net::IpAddr, sync::Arc};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, Method, StatusCode, header},
    middleware::Next,
    response::Response,
};

use super::json;

/// The host names by which the port may be reached.
#[derive(Clone, Debug)]
pub struct KnownHosts {
    /// `None`: any name. Where tokens are required, a page that came by another name has no token.
    names: Option<Arc<[String]>>,
}

impl KnownHosts {
    /// Accepts any name.
    pub fn any() -> Self {
        Self { names: None }
    }

    /// Accepts `localhost`, addresses, and these names.
    pub fn listed(names: &[String]) -> Self {
        Self { names: Some(names.iter().map(|name| name.to_ascii_lowercase()).collect()) }
    }

    fn knows(&self, host: &str) -> bool {
        let Some(names) = &self.names else { return true };
        let host = host.to_ascii_lowercase();
        let literal = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(&host);
        literal.parse::<IpAddr>().is_ok()
            || host == "localhost"
            || host.ends_with(".localhost")
            || names.contains(&host)
    }
}

/// The host of `host[:port]`.
fn without_port(authority: &str) -> &str {
    match authority.rsplit_once(':') {
        Some((host, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) && !host.is_empty() => host,
        _ => authority,
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).map(|value| value.to_str().unwrap_or(""))
}

/// The reason why a request is refused; `None` if it is not.
fn refusal(hosts: &KnownHosts, request: &Request) -> Option<String> {
    let host = text(request.headers(), header::HOST).or_else(|| request.uri().authority().map(|host| host.as_str()));
    let Some(host) = host else { return Some("the request has no Host".to_owned()) };
    let name = without_port(host);
    if !hosts.knows(name) {
        let shown: String = name.chars().take(100).collect();
        return Some(format!(
            "this daemon does not know the host name {shown:?}: use its address, or list the name in setting http_hosts"
        ));
    }
    let origin = text(request.headers(), header::ORIGIN)?;
    let is_own = ["http://", "https://"]
        .iter()
        .any(|scheme| origin.strip_prefix(scheme).is_some_and(|authority| authority.eq_ignore_ascii_case(host)));
    (!is_own).then(|| "a page of another origin may not use this port".to_owned())
}

/// Whether a request comes by a known name, and not from a page of another origin.
pub fn is_own(hosts: &KnownHosts, request: &Request) -> bool {
    refusal(hosts, request).is_none()
}

/// Whether a document of another site fetches the content. Any site may link to it, but no other site may embed it, not
/// even a picture.
fn is_embedded(request: &Request) -> bool {
    let has_header = |name: &str, word: &str| request.headers().get(name).is_some_and(|value| value == word);
    let is_link = request.method() == Method::GET
        && (has_header("sec-fetch-mode", "navigate") || !request.uri().path().starts_with("/api/"));
    has_header("sec-fetch-site", "cross-site") && !is_link
}

/// Refuses requests of pages of other origins.
pub(super) async fn check(State(hosts): State<KnownHosts>, request: Request, next: Next) -> Response {
    if let Some(reason) = refusal(&hosts, &request) {
        metrics::counter!("tidemap_foreign_requests_total").increment(1);
        return json::failure(StatusCode::FORBIDDEN, "PERMISSION_DENIED", "FOREIGN_REQUEST", &reason);
    }
    if is_embedded(&request) {
        let reason = "a page of another site may not use this port";
        return json::failure(StatusCode::FORBIDDEN, "PERMISSION_DENIED", "FOREIGN_REQUEST", reason);
    }
    next.run(request).await
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    fn refused(hosts: &KnownHosts, host: &str, origin: Option<&str>) -> bool {
        let mut request = Request::builder().uri("/api/v1/MapService/ListMaps").header(header::HOST, host);
        if let Some(origin) = origin {
            request = request.header(header::ORIGIN, origin);
        }
        refusal(hosts, &request.body(Body::empty()).expect("a request")).is_some()
    }

    #[test]
    fn names_that_nobody_listed_are_refused() {
        let hosts = KnownHosts::listed(&["Lab.example".to_owned()]);
        for host in ["localhost:7436", "127.0.0.1:7436", "[::1]:7436", "10.1.2.3", "LAB.example:80", "a.localhost"] {
            assert!(!refused(&hosts, host, None), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example:7436", "127.0.0.1.evil.example", "", "[::1].evil"] {
            assert!(refused(&hosts, host, None), "{host}");
        }
        assert!(!refused(&KnownHosts::any(), "evil.example", None));
    }

    #[test]
    fn only_pages_of_the_port_itself_may_ask() {
        for hosts in [KnownHosts::any(), KnownHosts::listed(&[])] {
            assert!(!refused(&hosts, "localhost:7436", Some("http://localhost:7436")));
            for origin in ["http://localhost:1", "https://evil.example", "null", "", "http://localhost:7436.evil"] {
                assert!(refused(&hosts, "localhost:7436", Some(origin)), "{origin}");
            }
        }
    }
}

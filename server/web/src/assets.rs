//! The files of the page, as they are built in.
//!
//! Invariant: the daemon needs no other files to serve the page. It serves the files that were built from `client/web`.
//! Each file is unpacked once, on no thread that answers others, and all readers share its bytes.

use std::sync::LazyLock;

use axum::{
    Router,
    body::{Body, Bytes},
    extract::Request,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
    routing::get,
};
use tidemap_base::{connections::unread::SharedContent, task::NoResult};
use tokio::sync::OnceCell;

/// A file that belongs to the page.
struct Asset {
    /// The path below `/`.
    path: &'static str,
    /// The content, compressed by gzip.
    gzip: &'static [u8],
    /// A tag that changes with the content.
    tag: &'static str,
}

include!(concat!(env!("OUT_DIR"), "/assets.rs"));

const INDEX: &str = "index.html";
/// Scripts and styles of the page come from the page alone, and no other page may show it in a frame.
const POLICY: &str = "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; \
                      object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

fn content_type(path: &str) -> &'static str {
    match path.rsplit_once('.').map_or("", |(_, ending)| ending) {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "json" => "application/json",
        "woff2" => "font/woff2",
        _ => "application/octet-stream",
    }
}

/// The content of each file for clients that do not take gzip. It is unpacked at the first such request.
static PLAIN: LazyLock<Vec<OnceCell<Bytes>>> = LazyLock::new(|| ASSETS.iter().map(|_| OnceCell::new()).collect());

/// The number of a file.
fn find(path: &str) -> Option<usize> {
    ASSETS.iter().position(|asset| asset.path == path)
}

pub(super) fn accepts_gzip(headers: &HeaderMap) -> bool {
    let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok()).unwrap_or("");
    accepted.split(',').any(|coding| {
        let mut parts = coding.split(';').map(str::trim);
        let is_gzip = parts.next().is_some_and(|name| name.eq_ignore_ascii_case("gzip") || name == "*");
        is_gzip && !parts.any(|weight| weight.replace(' ', "") == "q=0")
    })
}

fn unpacked(gzip: &[u8]) -> Vec<u8> {
    let mut plain = Vec::new();
    // The build made these bytes; a test reads all of them.
    let _ = std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(gzip), &mut plain);
    plain
}

/// The content of a file, not compressed.
async fn plain(number: usize) -> Result<Bytes, NoResult> {
    let unpack = async || tidemap_base::task::blocking(move || Bytes::from(unpacked(ASSETS[number].gzip))).await;
    PLAIN[number].get_or_try_init(unpack).await.cloned()
}

async fn answer(number: usize, headers: &HeaderMap) -> Response {
    let asset = &ASSETS[number];
    let mut response = Response::new(Body::empty());
    let out = response.headers_mut();
    out.insert(header::ETAG, HeaderValue::from_static(asset.tag));
    // The names of built files change with their content; all other files are requested again each time.
    let is_hashed = asset.path.starts_with("assets/");
    let caching = if is_hashed { "public, max-age=31536000, immutable" } else { "no-cache" };
    out.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching));
    out.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    out.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    out.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    out.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if headers.get(header::IF_NONE_MATCH).is_some_and(|tag| tag == asset.tag) {
        *response.status_mut() = StatusCode::NOT_MODIFIED;
        return response;
    }
    out.insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type(asset.path)));
    if accepts_gzip(headers) {
        out.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        *response.body_mut() = Body::from(asset.gzip);
    } else {
        match plain(number).await {
            Ok(content) => *response.body_mut() = Body::from(content),
            Err(_) => *response.status_mut() = StatusCode::INTERNAL_SERVER_ERROR,
        }
    }
    response.extensions_mut().insert(SharedContent);
    response
}

async fn asset(request: Request) -> Response {
    let path = request.uri().path().trim_start_matches('/');
    match find(path) {
        Some(number) => answer(number, request.headers()).await,
        None => missing(),
    }
}

/// The page itself; its script reads the path.
async fn page(request: Request) -> Response {
    match find(INDEX) {
        Some(number) => answer(number, request.headers()).await,
        None => missing(),
    }
}

fn missing() -> Response {
    let mut response = Response::new(Body::from("this daemon was built without the page, or the path is not known\n"));
    *response.status_mut() = StatusCode::NOT_FOUND;
    response
}

/// The routes of the page; without a page there are none.
pub(super) fn router() -> Router {
    if find(INDEX).is_none() {
        return Router::new();
    }
    let mut router = Router::new();
    for path in ["/", "/maps", "/maps/{*rest}", "/operations", "/states/{*rest}"] {
        router = router.route(path, get(page));
    }
    ASSETS
        .iter()
        .filter(|asset| asset.path != INDEX)
        .fold(router, |router, file| router.route(&format!("/{}", file.path), get(asset)))
}

/// Whether the page is built in.
pub fn has_page() -> bool {
    find(INDEX).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_can_be_unpacked() {
        for asset in ASSETS {
            assert!(!unpacked(asset.gzip).is_empty(), "{}", asset.path);
            assert!(asset.tag.starts_with('"') && asset.tag.ends_with('"'));
        }
    }

    #[tokio::test]
    async fn a_file_is_unpacked_once() {
        for (number, asset) in ASSETS.iter().enumerate() {
            let first = plain(number).await.expect("the content");
            assert_eq!(first, unpacked(asset.gzip));
            assert_eq!(first.as_ptr(), plain(number).await.expect("the content").as_ptr());
        }
    }

    #[test]
    fn gzip_is_sent_to_those_who_take_it() {
        let headers =
            |value: &'static str| HeaderMap::from_iter([(header::ACCEPT_ENCODING, HeaderValue::from_static(value))]);
        assert!(accepts_gzip(&headers("gzip, deflate, br")));
        assert!(accepts_gzip(&headers("br;q=1, GZIP;q=0.5")));
        assert!(!accepts_gzip(&headers("gzip;q=0, br")));
        assert!(!accepts_gzip(&headers("identity")));
        assert!(!accepts_gzip(&HeaderMap::new()));
    }
}

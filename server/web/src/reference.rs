//! `/docs`: the JSON interface as a page for people, made from its description (OpenAPI).
//!
//! Invariant: the page runs no script and takes nothing from other hosts; its policy allows only its own style. All
//! text is escaped. The page is compressed once, and all readers share its bytes.

use std::{fmt::Write as _, io::Write as _};

use axum::{
    Router,
    body::{Body, Bytes},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
    routing::get,
};
use flate2::{Compression, write::GzEncoder};
use serde_json::Value;

use super::{assets::accepts_gzip, json::reply, shared};

const POLICY: &str =
    "default-src 'none'; style-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const STYLE: &str = include_str!("reference/style.css");
const DOCUMENT: &str = "/api/v1/openapi.json";
const SCHEMAS: &str = "#/components/schemas/";

/// The routes of the page.
///
/// # Errors
/// The description is no JSON, which is a defect of the build.
pub(super) fn router(openapi: &Bytes) -> anyhow::Result<Router> {
    let html = PageFile::new("text/html; charset=utf-8", page(&serde_json::from_slice(openapi)?))?;
    let style = PageFile::new("text/css; charset=utf-8", STYLE.to_owned())?;
    let page = move |headers: HeaderMap| async move { html.answer(&headers) };
    let style = move |headers: HeaderMap| async move { style.answer(&headers) };
    Ok(Router::new().route("/docs", get(page)).route("/docs/style.css", get(style)))
}

/// A file of the page.
#[derive(Clone)]
struct PageFile {
    content_type: &'static str,
    plain: Bytes,
    gzip: Bytes,
}

impl PageFile {
    fn new(content_type: &'static str, plain: String) -> std::io::Result<PageFile> {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
        gzip.write_all(plain.as_bytes())?;
        Ok(PageFile { content_type, plain: plain.into(), gzip: gzip.finish()?.into() })
    }

    fn answer(&self, headers: &HeaderMap) -> Response {
        let is_gzip = accepts_gzip(headers);
        let content = if is_gzip { &self.gzip } else { &self.plain };
        let mut response = reply(StatusCode::OK, self.content_type, Body::from(content.clone()));
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
        headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        if is_gzip {
            headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        }
        shared(response)
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A text of the description; empty if there is none.
fn text_of<'a>(value: &'a Value, member: &str) -> &'a str {
    value[member].as_str().unwrap_or_default()
}

fn paragraph(value: &Value) -> String {
    match text_of(value, "description") {
        "" => String::new(),
        text => format!("<p>{}</p>\n", escaped(text)),
    }
}

fn members(value: &Value) -> impl Iterator<Item = (&String, &Value)> {
    value.as_object().into_iter().flatten()
}

/// The type of a schema, with links to those that have names.
fn type_of(schema: &Value) -> String {
    if let Some(name) = schema["$ref"].as_str().and_then(|reference| reference.strip_prefix(SCHEMAS)) {
        let name = escaped(name);
        return format!("<a href=\"#{name}\">{name}</a>");
    }
    if let Some(choices) = schema["anyOf"].as_array() {
        return choices.iter().map(type_of).collect::<Vec<_>>().join(" or ");
    }
    if let Some(values) = schema["enum"].as_array() {
        return escaped(&values.iter().filter_map(Value::as_str).collect::<Vec<_>>().join(", "));
    }
    match (text_of(schema, "type"), text_of(schema, "format"), text_of(schema, "contentEncoding")) {
        ("array", ..) => format!("list of {}", type_of(&schema["items"])),
        ("object", ..) if schema["additionalProperties"].is_object() => {
            format!("object of {}", type_of(&schema["additionalProperties"]))
        }
        (name, "", "") => escaped(name),
        (name, format, encoding) => escaped(&format!("{name} ({format}{encoding})")),
    }
}

fn row(name: &str, kind: &str, about: &str) -> String {
    format!("<tr><td><code>{}</code></td><td>{kind}</td><td>{}</td></tr>\n", escaped(name), escaped(about))
}

fn table(rows: &str) -> String {
    if rows.is_empty() { String::new() } else { format!("<table>\n{rows}</table>\n") }
}

/// An operation of a path: its description, its input, and its output.
fn operation(path: &str, method: &str, operation: &Value) -> String {
    let parameters = operation["parameters"].as_array().into_iter().flatten();
    let parameters: String = parameters
        .map(|known| row(text_of(known, "name"), text_of(known, "in"), text_of(known, "description")))
        .collect();
    let of_content = |content: &Value| -> Vec<String> {
        members(content).map(|(media, known)| [escaped(media), type_of(&known["schema"])].join(" ")).collect()
    };
    let takes = of_content(&operation["requestBody"]["content"]).join(", ");
    let gives = of_content(&operation["responses"]["200"]["content"]).join(", ");
    let takes = if takes.is_empty() { takes } else { format!("<p>Request body: {takes}.</p>\n") };
    let (method, path) = (method.to_uppercase(), escaped(path));
    format!(
        "<details><summary><code>{method} {path}</code></summary>\n{}{takes}{}<p>Response: {gives}.</p>\n</details>\n",
        paragraph(operation),
        table(&parameters),
    )
}

/// A message or an enumeration.
fn schema(name: &str, schema: &Value) -> String {
    let fields: String = members(&schema["properties"])
        .map(|(name, field)| row(name, &type_of(field), text_of(field, "description")))
        .collect();
    let values = if schema["enum"].is_array() { format!("<p>{}</p>\n", type_of(schema)) } else { String::new() };
    format!("<h3 id=\"{0}\">{0}</h3>\n{1}{values}{2}", escaped(name), paragraph(schema), table(&fields))
}

fn page(document: &Value) -> String {
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>tidemap: JSON over HTTP</title>\n\
         <link rel=\"stylesheet\" href=\"/docs/style.css\">\n</head>\n<body>\n<h1>tidemap {}: JSON over HTTP</h1>\n{}\
         <p>For programs: <a href=\"{DOCUMENT}\">{DOCUMENT}</a> (OpenAPI).</p>\n<nav>\n",
        escaped(text_of(&document["info"], "version")),
        paragraph(&document["info"]),
    );
    let tags: Vec<&Value> = document["tags"].as_array().into_iter().flatten().collect();
    for tag in &tags {
        let _ = writeln!(html, "<a href=\"#tag-{0}\">{0}</a>", escaped(text_of(tag, "name")));
    }
    html += "<a href=\"#schemas\">Messages</a>\n</nav>\n";
    let all: Vec<(&String, &String, &Value)> = members(&document["paths"])
        .flat_map(|(path, methods)| members(methods).map(move |(method, known)| (path, method, known)))
        .collect();
    for tag in &tags {
        let name = text_of(tag, "name");
        let _ = write!(html, "<h2 id=\"tag-{0}\">{0}</h2>\n{1}", escaped(name), paragraph(tag));
        let is_of_tag = |known: &Value| known["tags"].as_array().is_some_and(|tags| tags.iter().any(|tag| tag == name));
        html.extend(
            all.iter()
                .filter(|(.., known)| is_of_tag(known))
                .map(|(path, method, known)| operation(path, method, known)),
        );
    }
    html += "<h2 id=\"schemas\">Messages</h2>\n";
    html.extend(members(&document["components"]["schemas"]).map(|(name, known)| schema(name, known)));
    html + "</body>\n</html>\n"
}

#[cfg(test)]
mod tests {
    use prost_reflect::DescriptorPool;
    use serde_json::json;

    use super::*;
    use crate::openapi;

    #[test]
    fn it_shows_every_operation_and_every_link_leads_somewhere() {
        let pool = DescriptorPool::decode(tidemap_proto::v1::DESCRIPTORS).expect("descriptors");
        let document: Value = serde_json::from_slice(&openapi::document(&pool)).expect("JSON");
        let html = page(&document);
        for (path, methods) in members(&document["paths"]) {
            for (method, _) in members(methods) {
                let shown = format!("<code>{} {path}</code>", method.to_uppercase());
                assert_eq!(html.matches(&shown).count(), 1, "{shown}");
            }
        }
        for (at, marker) in html.match_indices("href=\"#") {
            let name = html[at + marker.len()..].split('"').next().expect("an end");
            assert!(html.contains(&format!("id=\"{name}\"")), "{name}");
        }
        assert!(!html.contains("<script") && !html.contains("style=\""));
        let elsewhere =
            |marker: &str| html.match_indices(marker).any(|(at, _)| !html[at + marker.len()..].starts_with(['#', '/']));
        assert!(!elsewhere("href=\"") && !html.contains("src=\""));
    }

    #[test]
    fn texts_are_escaped() {
        let document = json!({
            "info": { "version": "1", "description": "a <b> & \"c\"" },
            "components": { "schemas": { "X<": { "properties": { "<i>": { "type": "<t>" } } } } },
        });
        let html = page(&document);
        assert!(html.contains("a &lt;b&gt; &amp; &quot;c&quot;") && html.contains("&lt;t&gt;"), "{html}");
        assert!(!html.contains("<i>") && !html.contains("<b>") && !html.contains("X<"), "{html}");
    }
}

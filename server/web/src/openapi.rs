//! The description of the JSON interface (OpenAPI 3.1), made from the descriptors of the wire and their comments.
//!
//! Invariant: it contains each RPC that JSON can call, the documents to link to, the path of recordings, and nothing
//! else.

use axum::body::Bytes;
use prost_reflect::{
    Cardinality, DescriptorPool, EnumDescriptor, FieldDescriptor, FileDescriptor, Kind, MessageDescriptor,
    MethodDescriptor,
};
use serde_json::{Map, Value, json};

use super::{
    links::{PICTURE_PARAMETERS, Parameter, TOPOLOGY_PARAMETERS},
    recordings,
    times::form_of,
};

/// The comment before an element of a file, as one text.
pub(super) fn comment(file: &FileDescriptor, path: &[i32]) -> String {
    let Some(source) = &file.file_descriptor_proto().source_code_info else { return String::new() };
    let location = source.location.iter().find(|location| location.path == path);
    let text = location.map(|location| location.leading_comments()).unwrap_or_default();
    text.lines().map(str::trim).collect::<Vec<_>>().join("\n").trim().to_owned()
}

/// Adds a description, if there is one.
fn described(mut schema: Value, text: String) -> Value {
    if !text.is_empty() {
        schema["description"] = text.into();
    }
    schema
}

/// The name of a message in the document: its full name without the package.
pub(super) fn name_of(full_name: &str) -> &str {
    full_name.strip_prefix("tidemap.v1.").unwrap_or(full_name)
}

fn reference(full_name: &str) -> Value {
    json!({ "$ref": format!("#/components/schemas/{}", name_of(full_name)) })
}

/// A message that JSON writes in a form of its own.
fn well_known(full_name: &str) -> Option<Value> {
    match full_name {
        "google.protobuf.Timestamp" => Some(json!({ "type": "string", "format": "date-time" })),
        "google.protobuf.Duration" => {
            Some(json!({ "type": "string", "pattern": "^-?[0-9]+(\\.[0-9]+)?s$", "examples": ["3600s"] }))
        }
        "google.protobuf.FieldMask" => Some(json!({ "type": "string" })),
        "google.protobuf.Empty" => Some(json!({ "type": "object", "properties": {} })),
        _ => None,
    }
}

fn number() -> Value {
    json!({ "anyOf": [{ "type": "number" }, { "enum": ["NaN", "Infinity", "-Infinity"] }] })
}

fn kind(kind: &Kind) -> Value {
    match kind {
        Kind::Double | Kind::Float => number(),
        Kind::Int64 | Kind::Sint64 | Kind::Sfixed64 => {
            json!({ "type": "string", "format": "int64", "pattern": "^-?[0-9]{1,19}$" })
        }
        Kind::Uint64 | Kind::Fixed64 => json!({ "type": "string", "format": "uint64", "pattern": "^[0-9]{1,20}$" }),
        Kind::Int32 | Kind::Sint32 | Kind::Sfixed32 => {
            json!({ "type": "integer", "format": "int32", "minimum": i32::MIN, "maximum": i32::MAX })
        }
        Kind::Uint32 | Kind::Fixed32 => json!({ "type": "integer", "minimum": 0, "maximum": u32::MAX }),
        Kind::Bool => json!({ "type": "boolean" }),
        Kind::String => json!({ "type": "string" }),
        Kind::Bytes => json!({ "type": "string", "contentEncoding": "base64" }),
        Kind::Message(message) => well_known(message.full_name()).unwrap_or_else(|| reference(message.full_name())),
        Kind::Enum(known) => reference(known.full_name()),
    }
}

/// The schema of a time in a request; times in replies have one form only.
fn time() -> Value {
    json!({
        "description": "RFC 3339, or nanoseconds since 1970.",
        "anyOf": [
            { "type": "string", "format": "date-time" },
            { "type": "string", "format": "int64", "pattern": "^[0-9]{1,19}$" },
        ],
    })
}

fn field(field: &FieldDescriptor) -> Value {
    let text = comment(&field.parent_message().parent_file(), field.path());
    let kind = |element: &Kind| if form_of(field).is_some() { time() } else { kind(element) };
    let schema = match (field.cardinality(), field.kind()) {
        (Cardinality::Repeated, Kind::Message(entry)) if field.is_map() => {
            json!({ "type": "object", "additionalProperties": kind(&entry.map_entry_value_field().kind()) })
        }
        (Cardinality::Repeated, element) => json!({ "type": "array", "items": kind(&element) }),
        (_, element) => kind(&element),
    };
    match field.containing_oneof() {
        Some(choice) if !choice.is_synthetic() => {
            let others = format!("At most one of the fields of `{}` is set.", choice.name());
            described(schema, [text, others].join("\n").trim().to_owned())
        }
        _ => described(schema, text),
    }
}

fn message(message: &MessageDescriptor) -> Value {
    let properties: Map<String, Value> =
        message.fields().map(|member| (member.json_name().to_owned(), field(&member))).collect();
    let schema = json!({ "type": "object", "properties": properties, "additionalProperties": false });
    described(schema, comment(&message.parent_file(), message.path()))
}

fn enumeration(known: &EnumDescriptor) -> Value {
    let names: Vec<String> = known.values().map(|value| value.name().to_owned()).collect();
    described(json!({ "type": "string", "enum": names }), comment(&known.parent_file(), known.path()))
}

fn operation(method: &MethodDescriptor) -> Value {
    let service = method.parent_service();
    let media = if method.is_server_streaming() { "application/x-ndjson" } else { "application/json" };
    let text = comment(&method.parent_file(), method.path());
    let operation = json!({
        "operationId": format!("{}.{}", service.name(), method.name()),
        "tags": [service.name()],
        "requestBody": {
            "required": true,
            "content": { "application/json": { "schema": kind(&Kind::Message(method.input())) } },
        },
        "responses": {
            "200": {
                "description": if method.is_server_streaming() { "One object a line." } else { "The reply." },
                "content": { media: { "schema": kind(&Kind::Message(method.output())) } },
            },
            "default": error(),
        },
    });
    described(operation, text)
}

/// The documents to link to: the path, the description, the parameters, and the type of the content of each.
const LINKS: [(&str, &str, &[Parameter], &str); 2] = [
    (
        "/api/v1/maps/{name}/grid.png",
        "The grid of a map as it is predicted at a time, as a picture with one pixel for each column of cells. Its \
         headers `tidemap-lower-left-m` and `tidemap-metres-per-pixel` give its position.",
        PICTURE_PARAMETERS,
        "image/png",
    ),
    (
        "/api/v1/maps/{name}/topology.geojson",
        "The nodes and edges of a map with their predictions for a time. Coordinates are metres in the frame of the \
         map.",
        TOPOLOGY_PARAMETERS,
        "application/geo+json",
    ),
];

/// A part of a path.
fn part(name: &str, text: &str) -> Value {
    json!({ "name": name, "in": "path", "required": true, "schema": { "type": "string" }, "description": text })
}

/// All parameters of an address: those in its path, then the others.
fn all_parameters(parts: impl IntoIterator<Item = Value>, parameters: &[Parameter]) -> Vec<Value> {
    let others = parameters.iter().map(|parameter| {
        let mut described = json!({
            "name": parameter.name, "in": "query", "schema": { "type": "string" },
            "description": parameter.description,
        });
        if !parameter.example.is_empty() {
            described["example"] = parameter.example.into();
        }
        described
    });
    parts.into_iter().chain(others).collect()
}

/// The response to a request that has no other response.
fn error() -> Value {
    json!({
        "description": "The request was refused or failed; `error.message` has the reason.",
        "content": { "application/json": { "schema": reference("Error") } },
    })
}

/// The operation of a link.
fn link(text: &str, parameters: &[Parameter], media: &str) -> Value {
    json!({
        "description": text,
        "tags": ["Links"],
        "parameters": all_parameters([part("name", "Name of the map.")], parameters),
        "responses": {
            "200": { "description": "The content.", "content": { media: {} } },
            "304": { "description": "The caller has it: `If-None-Match` was its `ETag`." },
            "default": error(),
        },
    })
}

/// The operations on recordings.
fn recordings() -> Value {
    let parts = || [part("name", "Name of the map."), part("file", "Name of the file, such as drive.mcap.")];
    let operation = |text: &str, parameters: &[Parameter], reply: (&str, &str)| {
        json!({
            "description": text,
            "tags": ["Recordings"],
            "parameters": all_parameters(parts(), parameters),
            "responses": {
                "200": { "description": reply.1, "content": { reply.0: {} } },
                "default": error(),
            },
        })
    };
    let [producer, update, bytes] = recordings::PARAMETERS;
    let mut post = operation(
        "Imports a recording of a robot, as `tidemap import` does: MCAP, a bag of ROS 1, or a database of rosbag2. The \
         map is created if it does not exist, and learns the recording. The same file again, under the same name, sends what is missing. The \
         caller must have the permission to send observations of the map, and to create it if it does not exist. One \
         recording is imported at a time; the import ends when the connection does.",
        &[*producer, *update],
        (
            "application/x-ndjson",
            "One object a line: `line`, a text; `progress`, with the `seconds` since the import began; at the end \
             `done` and `exit`, which is 0 if all was accepted, or `error`.",
        ),
    );
    post["requestBody"] = json!({ "required": true, "content": { "application/octet-stream": {} } });
    let get = operation(
        "Checks whether a recording would be accepted now. Call it before you send a large one.",
        &[*producer, *bytes],
        ("application/json", "It would be accepted: `mapExists`, the `file` as it is named, and `maxUploadBytes`."),
    );
    json!({ "get": get, "post": post })
}

/// The document.
pub(super) fn document(pool: &DescriptorPool) -> Bytes {
    let mut paths = Map::new();
    let mut tags = Vec::new();
    for service in pool.services() {
        let text = comment(&service.parent_file(), service.path());
        tags.push(described(json!({ "name": service.name() }), text));
        for method in service.methods().filter(|method| !method.is_client_streaming()) {
            let path = format!("/api/v1/{}/{}", service.name(), method.name());
            paths.insert(path, json!({ "post": operation(&method) }));
        }
    }
    tags.push(json!({ "name": "Links", "description": "Pictures and files for links." }));
    for (path, text, parameters, media) in LINKS {
        paths.insert(path.to_owned(), json!({ "get": link(text, parameters, media) }));
    }
    tags.push(json!({ "name": "Recordings", "description": "Recordings of robots, as files." }));
    paths.insert(recordings::PATH.to_owned(), recordings());
    let error = json!({
        "type": "object",
        "required": ["error"],
        "properties": { "error": {
            "type": "object",
            "required": ["code", "message"],
            "properties": {
                "code": { "type": "string", "description": "The name of the gRPC code." },
                "reason": { "type": "string", "description": "The reason, for programs." },
                "message": { "type": "string", "description": "The problem, and what to do." },
                "details": { "type": "object", "additionalProperties": { "type": "string" } },
            },
        } },
    });
    let mut schemas = Map::from_iter([("Error".to_owned(), error)]);
    let own = |name: &str| name.starts_with("tidemap.v1.");
    for known in pool.all_messages().filter(|known| own(known.full_name()) && !known.is_map_entry()) {
        schemas.insert(name_of(known.full_name()).to_owned(), message(&known));
    }
    for known in pool.all_enums().filter(|known| own(known.full_name())) {
        schemas.insert(name_of(known.full_name()).to_owned(), enumeration(&known));
    }
    let document = json!({
        "openapi": "3.1.0",
        "info": {
            "title": "tidemap",
            "version": env!("CARGO_PKG_VERSION"),
            "description": "The RPCs of tidemap.v1 as JSON. 64-bit integers are strings. Times are RFC 3339 \
                            or nanoseconds since 1970; replies have RFC 3339 for single times, and nanoseconds for rows.",
        },
        "tags": tags,
        "paths": paths,
        "security": [{}, { "token": [] }],
        "components": {
            "schemas": schemas,
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } },
        },
    });
    document.to_string().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_has_every_method_and_every_reference_leads_somewhere() {
        let pool = DescriptorPool::decode(tidemap_proto::v1::DESCRIPTORS).expect("descriptors");
        let document: Value = serde_json::from_slice(&document(&pool)).expect("JSON");
        let paths = document["paths"].as_object().expect("paths");
        let callable = pool.services().flat_map(|service| service.methods().collect::<Vec<_>>());
        let methods = callable.filter(|method| !method.is_client_streaming()).count();
        // The path of recordings has a GET and a POST.
        assert_eq!(paths.values().filter(|path| path["post"].is_object()).count(), methods + 1);
        assert_eq!(paths.values().filter(|path| path["get"].is_object()).count(), paths.len() - methods);
        let schemas = document["components"]["schemas"].as_object().expect("schemas");
        let text = document.to_string();
        for (position, marker) in text.match_indices("#/components/schemas/") {
            let name = text[position + marker.len()..].split('"').next().expect("an end");
            assert!(schemas.contains_key(name), "{name}");
        }
        let without = paths.iter().filter(|(_, path)| {
            let operation = if path["post"].is_object() { &path["post"] } else { &path["get"] };
            operation["description"].is_null()
        });
        assert_eq!(without.count(), 0, "each method has a description");
    }
}

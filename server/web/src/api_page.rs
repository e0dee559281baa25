//! The API page of the guide, `docs/src/api.md`, made from the descriptors of the wire, their comments and the table of
//! roles.
//! Invariant: the page in the guide is equal to the output of this module. After a change of the wire, `make api-page`
//! writes the page again.

use std::{collections::BTreeSet, env, fmt::Write as _, fs, path::Path};

use prost_reflect::{
    Cardinality, DescriptorPool, EnumDescriptor, FieldDescriptor, Kind, MessageDescriptor, MethodDescriptor,
    ServiceDescriptor,
};
use tidemap_base::access::table::{Need, need};
use tidemap_proto::v1::DESCRIPTORS;

use super::openapi::{comment, name_of};

const OPENING: &str = "# The API

Every service, call, message and field of `tidemap.v1`, made from the files in `proto/tidemap/v1/`. [The wire by
example](wire.md) shows how to call them.

A call is `/tidemap.v1.SERVICE/METHOD` over gRPC and gRPC-Web, and `POST /api/v1/SERVICE/METHOD` as JSON, except where it
streams requests. The role is what a [token](security.md#tokens) needs; `any` is any valid token. In JSON, names of fields
are in camelCase and 64-bit integers are strings.

";

/// A comment as one line of a table or a paragraph: `<` and `|` would be HTML and another cell.
fn line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('<', "&lt;").replace('|', "\\|")
}

fn anchor(name: &str) -> String {
    format!("[`{name}`](#{})", name.to_lowercase().replace('.', ""))
}

fn type_name(kind: &Kind) -> String {
    match kind {
        Kind::Message(message) if message.full_name().starts_with("google.") => format!("`{}`", message.full_name()),
        Kind::Message(message) => anchor(name_of(message.full_name())),
        Kind::Enum(known) => anchor(name_of(known.full_name())),
        other => format!("`{other:?}`").to_lowercase(),
    }
}

fn field_row(field: &FieldDescriptor) -> String {
    let kind = type_name(&field.kind());
    let text = line(&comment(&field.parent_message().parent_file(), field.path()));
    let text = match field.containing_oneof() {
        Some(choice) if !choice.is_synthetic() => format!("One of `{}`. {text}", choice.name()),
        _ => text,
    };
    let kind = match field.cardinality() {
        Cardinality::Repeated => format!("list of {kind}"),
        _ if field.field_descriptor_proto().proto3_optional() => format!("optional {kind}"),
        _ => kind,
    };
    format!("| {} | `{}` | {kind} | {text} |\n", field.number(), field.name())
}

fn message_section(message: &MessageDescriptor) -> String {
    let mut text = format!("### {}\n\n", name_of(message.full_name()));
    let about = line(&comment(&message.parent_file(), message.path()));
    if !about.is_empty() {
        let _ = writeln!(text, "{about}\n");
    }
    if message.fields().len() == 0 {
        return text + "No fields.\n\n";
    }
    text += "| no. | field | type | meaning |\n| --- | --- | --- | --- |\n";
    message.fields().for_each(|field| text += &field_row(&field));
    text + "\n"
}

fn enum_section(known: &EnumDescriptor) -> String {
    let mut text = format!("### {}\n\n", name_of(known.full_name()));
    let _ = writeln!(text, "{}\n", line(&comment(&known.parent_file(), known.path())));
    text += "| no. | value | meaning |\n| --- | --- | --- |\n";
    for value in known.values() {
        let meaning = line(&comment(&known.parent_file(), value.path()));
        let _ = writeln!(text, "| {} | `{}` | {meaning} |", value.number(), value.name());
    }
    text + "\n"
}

fn role(method: &MethodDescriptor) -> String {
    let path = format!("/{}/{}", method.parent_service().full_name(), method.name());
    match need(&path) {
        Some(Need::Role(role)) => role.name().to_owned(),
        Some(Need::AllMaps(role)) => format!("{}, for all maps", role.name()),
        Some(Need::Token) => "any".to_owned(),
        Some(Need::Open) => "none".to_owned(),
        Some(Need::Peer) => "none; the secret of the cluster".to_owned(),
        None => panic!("{path} has no row in the table of roles"),
    }
}

fn method_section(method: &MethodDescriptor) -> String {
    let (service, name) = (method.parent_service(), method.name());
    let streamed = |is_stream, message: MessageDescriptor| {
        format!("{}{}", if is_stream { "stream of " } else { "" }, anchor(name_of(message.full_name())))
    };
    let json = match method.is_client_streaming() {
        true => "gRPC only".to_owned(),
        false => format!("`POST /api/v1/{}/{name}`", service.name()),
    };
    format!(
        "### {}.{name}\n\n{}\n\n{} → {}. Role: {}. JSON: {json}.\n\n",
        service.name(),
        line(&comment(&method.parent_file(), method.path())),
        streamed(method.is_client_streaming(), method.input()),
        streamed(method.is_server_streaming(), method.output()),
        role(method),
    )
}

fn service_section(service: &ServiceDescriptor) -> String {
    let about = line(&comment(&service.parent_file(), service.path()));
    let methods: String = service.methods().map(|method| method_section(&method)).collect();
    format!("## {}\n\n{about}\n\n{methods}", service.name())
}

/// The page, from the descriptors.
fn page(pool: &DescriptorPool) -> String {
    let own = |name: &str| name.starts_with("tidemap.v1.");
    let mut text = OPENING.to_owned();
    pool.services().filter(|service| own(service.full_name())).for_each(|service| text += &service_section(&service));
    text += "## Messages\n\n";
    let messages = pool.all_messages().filter(|message| own(message.full_name()) && !message.is_map_entry());
    let mut sections: Vec<(String, String)> =
        messages.map(|message| (message.full_name().to_owned(), message_section(&message))).collect();
    sections.sort();
    text.extend(sections.into_iter().map(|(_, section)| section));
    text += "## Enumerations\n\n";
    let known = pool.all_enums().filter(|known| own(known.full_name()));
    let mut sections: Vec<(String, String)> =
        known.map(|known| (known.full_name().to_owned(), enum_section(&known))).collect();
    sections.sort();
    text.extend(sections.into_iter().map(|(_, section)| section));
    text.trim_end().to_owned() + "\n"
}

#[test]
fn the_api_page_of_the_guide_is_made_from_the_descriptors() {
    let pool = DescriptorPool::decode(DESCRIPTORS).expect("descriptors");
    let made = page(&pool);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/api.md");
    if env::var_os("TIDEMAP_WRITE_API_PAGE").is_some() {
        fs::write(&path, &made).expect("the page can be written");
    }
    let kept = fs::read_to_string(&path).unwrap_or_default();
    let differs = kept.lines().zip(made.lines()).position(|(kept, made)| kept != made);
    assert!(kept == made, "docs/src/api.md is not what the descriptors give, from line {differs:?}: run make api-page");
}

#[test]
fn links_of_the_page_lead_to_its_headings() {
    let pool = DescriptorPool::decode(DESCRIPTORS).expect("descriptors");
    let made = page(&pool);
    let headings = made.lines().filter_map(|line| line.strip_prefix("### "));
    let headings: BTreeSet<String> = headings.map(|name| name.replace('.', "").to_lowercase()).collect();
    let links: Vec<&str> = made.split("](#").skip(1).filter_map(|rest| rest.split(')').next()).collect();
    assert!(links.len() > 200, "{} links", links.len());
    for link in links {
        assert!(headings.contains(link), "there is no heading for {link}");
    }
    assert!(made.contains("### MapService.DeleteMap\n") && made.contains("Role: admin."), "calls have roles");
}

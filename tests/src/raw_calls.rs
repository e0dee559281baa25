//! Calls of any method by its path, with a message of bytes, and the descriptions of the methods in the descriptors.
//!
//! Invariant: nothing here knows a method by name, so that a new one is called as well.

use std::time::Duration;

use bytes::Bytes;
use prost::Message as _;
use prost_types::{DescriptorProto, FileDescriptorSet};
use tidemap_client::connection::Connection;
use tidemap_proto::bytes_codec::BytesCodec;
use tokio_stream::StreamExt as _;
use tonic::{Code, Request, client::Grpc, codegen::http::uri::PathAndQuery};

/// A method of `tidemap.v1`.
#[derive(Clone, Debug)]
pub struct Method {
    /// Path of the method, `/package.Service/Method`.
    pub path: String,
    /// The method without package and service.
    pub name: String,
    /// Numbers of the fields, from the outermost in, that lead to the name of a map in a request; empty if none does.
    map_field: Vec<u32>,
}

/// The way to the name of a map in a message.
fn map_field(messages: &[&DescriptorProto], type_name: &str, method: &str) -> Vec<u32> {
    let name = type_name.rsplit('.').next().unwrap_or_default();
    let Some(message) = messages.iter().find(|message| message.name() == name) else { return Vec::new() };
    let is_map = |field: &str| field == "map" || (field == "name" && method.ends_with("Map"));
    if let Some(field) = message.field.iter().find(|field| is_map(field.name())) {
        return vec![field.number().unsigned_abs()];
    }
    // The first message of a stream is one of several kinds.
    let first = message.field.iter().find(|field| field.number() == 1 && field.oneof_index.is_some());
    let Some(first) = first else { return Vec::new() };
    let rest = map_field(messages, first.type_name(), method);
    if rest.is_empty() { rest } else { [vec![1], rest].concat() }
}

/// All methods of `tidemap.v1`.
///
/// # Panics
/// If the descriptors cannot be read.
#[must_use]
pub fn methods() -> Vec<Method> {
    let set = FileDescriptorSet::decode(tidemap_proto::v1::DESCRIPTORS).expect("descriptors");
    let messages: Vec<&DescriptorProto> = set.file.iter().flat_map(|file| &file.message_type).collect();
    let mut methods = Vec::new();
    for file in &set.file {
        for service in &file.service {
            for method in &service.method {
                methods.push(Method {
                    path: format!("/{}.{}/{}", file.package(), service.name(), method.name()),
                    name: method.name().to_owned(),
                    map_field: map_field(&messages, method.input_type(), method.name()),
                });
            }
        }
    }
    methods
}

impl Method {
    /// Whether the requests of the method name a map.
    #[must_use]
    pub fn names_a_map(&self) -> bool {
        !self.map_field.is_empty()
    }

    /// A request for a map, without anything else.
    #[must_use]
    pub fn request(&self, map: &str) -> Bytes {
        let mut message = map.as_bytes().to_vec();
        if self.map_field.is_empty() {
            return Bytes::new();
        }
        for number in self.map_field.iter().rev() {
            let mut outer = Vec::new();
            prost::encoding::encode_key(*number, prost::encoding::WireType::LengthDelimited, &mut outer);
            prost::encoding::encode_varint(message.len() as u64, &mut outer);
            outer.extend(message);
            message = outer;
        }
        message.into()
    }
}

/// The status of a call with one message, or that of a stream at its first message. A stream that sends nothing within
/// the time is well.
pub async fn call(connection: Connection, path: &str, message: Bytes, within: Duration) -> Code {
    let mut grpc = Grpc::new(connection);
    if grpc.ready().await.is_err() {
        return Code::Unavailable;
    }
    let requests = tokio_stream::once(message);
    let path = PathAndQuery::try_from(path).expect("a path");
    let work = async {
        let replies = grpc.streaming(Request::new(requests), path, BytesCodec).await?.into_inner();
        tokio::pin!(replies);
        replies.next().await.transpose()
    };
    match tokio::time::timeout(within, work).await {
        Ok(Ok(_)) | Err(_) => Code::Ok,
        Ok(Err(status)) => status.code(),
    }
}

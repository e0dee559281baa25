//! Invalid messages: the bytes that a broken or hostile client sends on a stream of observations.
//!
//! Invariant: the gRPC frames are valid; their content is that of the test.

use bytes::Bytes;
use tidemap_proto::bytes_codec::BytesCodec;
use tonic::{Status, client::Grpc, codegen::http::uri::PathAndQuery, transport::Endpoint};

/// Opens a stream of observations, sends these messages, and returns how the stream ended.
///
/// # Errors
/// The status; `Ok`, with the number of replies, if the stream ended in order.
///
/// # Panics
/// If there is no daemon, or the stream does not end.
pub async fn observe(address: &str, messages: Vec<Vec<u8>>) -> Result<usize, Status> {
    let endpoint = Endpoint::from_shared(format!("http://{address}")).expect("an address");
    let mut grpc = Grpc::new(endpoint.connect().await.expect("a daemon listens"));
    grpc.ready().await.expect("a connection");
    let path = PathAndQuery::from_static("/tidemap.v1.ObservationService/Observe");
    // The stream stays open: the daemon must end it.
    let requests = tokio_stream::StreamExt::chain(
        tokio_stream::iter(messages.into_iter().map(Bytes::from)),
        tokio_stream::pending(),
    );
    let mut replies = grpc.streaming(tonic::Request::new(requests), path, BytesCodec).await?.into_inner();
    let count = async {
        let mut count = 0;
        while replies.message().await?.is_some() {
            count += 1;
        }
        Ok(count)
    };
    tokio::time::timeout(std::time::Duration::from_secs(60), count).await.expect("the daemon ends the stream")
}

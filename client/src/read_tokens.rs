//! The read token of each map that a client has seen, for daemons that share maps: each request carries it, and no
//! later reply shows less.
//!
//! Invariant: a token only grows, until there is another map of the name. A daemon that is alone sends no token, and
//! receives none.

use std::{
    collections::HashMap,
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll},
};

use prost::Message as _;
use tidemap_proto::{
    first_message::PeekedBody,
    map_of::{map_of, names_a_map},
    read_token::{AT_LEAST, ReadToken, SHOWN},
    v1,
};
use tonic::{
    body::Body,
    codegen::{Service, http},
};

/// Maximum size of a first message that is decoded; a request with a larger one carries no token.
const FIRST_BYTES: usize = 16 << 20;
/// A stream of observations needs no token, and its first message may come later than its head.
const OBSERVE: &str = "/tidemap.v1.ObservationService/Observe";
/// After these a map of a name is another one.
const RENEWING: [&str; 2] = ["/tidemap.v1.MapService/CreateMap", "/tidemap.v1.MapService/DeleteMap"];

/// The tokens of all maps. Clones share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReadTokens(Arc<Mutex<HashMap<String, ReadToken>>>);

impl ReadTokens {
    // A lock, because requests come from all tasks; held only to copy a token.
    fn all(&self) -> MutexGuard<'_, HashMap<String, ReadToken>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The newest read token of a map.
    pub(crate) fn of(&self, map: &str) -> Option<ReadToken> {
        self.all().get(map).copied()
    }

    /// Records that a reply showed the data of a map up to a token.
    pub(crate) fn saw(&self, map: &str, token: ReadToken) {
        if token.is_nothing() {
            return;
        }
        let mut all = self.all();
        match all.get_mut(map) {
            Some(known) => *known = known.max(token),
            None => drop(all.insert(map.to_owned(), token)),
        }
    }

    /// A map of this name begins anew.
    pub(crate) fn forget(&self, map: &str) {
        self.all().remove(map);
    }
}

/// A connection whose requests carry the read tokens, and which records the tokens of the replies.
#[derive(Clone, Debug)]
pub struct TokenService<S> {
    inner: S,
    tokens: ReadTokens,
}

impl<S> TokenService<S> {
    pub(crate) fn new(inner: S, tokens: ReadTokens) -> Self {
        Self { inner, tokens }
    }
}

impl<S, R> Service<http::Request<Body>> for TokenService<S>
where
    S: Service<http::Request<Body>, Response = http::Response<R>> + Clone + Send + 'static,
    S::Future: Send,
    R: Send + 'static,
{
    type Response = http::Response<R>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<http::Response<R>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: http::Request<Body>) -> Self::Future {
        let path = request.uri().path();
        let is_renewing = RENEWING.contains(&path);
        if path == OBSERVE || !(is_renewing || names_a_map(path)) {
            return Box::pin(self.inner.call(request));
        }
        // The service that is ready takes the request.
        let next = self.inner.clone();
        let mut inner = std::mem::replace(&mut self.inner, next);
        let tokens = self.tokens.clone();
        Box::pin(async move {
            let (mut parts, body) = request.into_parts();
            let mut body = PeekedBody::new(body);
            // A body that breaks off breaks off for the daemon, too.
            let first = body.first_message(FIRST_BYTES).await.ok().flatten();
            if is_renewing {
                // Both requests have the name in their first field.
                let renewed = first.and_then(|message| v1::DeleteMapRequest::decode(message).ok());
                let reply = inner.call(http::Request::from_parts(parts, Body::new(body))).await?;
                renewed.iter().for_each(|request| tokens.forget(&request.name));
                return Ok(reply);
            }
            let map = first.and_then(|message| map_of(parts.uri.path(), &message).map(str::to_owned));
            if let Some(token) = map.as_ref().and_then(|map| tokens.of(map))
                && !parts.headers.contains_key(&AT_LEAST)
            {
                token.put(&mut parts.headers, AT_LEAST);
            }
            let reply = inner.call(http::Request::from_parts(parts, Body::new(body))).await?;
            if let (Some(map), Ok(Some(shown))) = (map, ReadToken::of(reply.headers(), &SHOWN)) {
                tokens.saw(&map, shown);
            }
            Ok(reply)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use super::*;

    const PREDICT: &str = "/tidemap.v1.QueryService/PredictStates";

    fn token(position: u64, generation: u64) -> ReadToken {
        ReadToken { map_uid: 7, position, generation }
    }

    /// A daemon that shows a fixed token, and records the tokens of the requests.
    #[derive(Clone, Debug)]
    struct Shows {
        shown: Option<ReadToken>,
        received: Arc<Mutex<Vec<Option<ReadToken>>>>,
    }

    impl Service<http::Request<Body>> for Shows {
        type Response = http::Response<Body>;
        type Error = Infallible;
        type Future = std::future::Ready<Result<http::Response<Body>, Infallible>>;

        fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
            Poll::Ready(Ok(()))
        }

        fn call(&mut self, request: http::Request<Body>) -> Self::Future {
            let received = ReadToken::of(request.headers(), &AT_LEAST).expect("a token");
            self.received.lock().expect("not poisoned").push(received);
            let mut reply = http::Response::new(Body::empty());
            if let Some(shown) = self.shown {
                shown.put(reply.headers_mut(), SHOWN);
            }
            std::future::ready(Ok(reply))
        }
    }

    async fn ask(service: &mut TokenService<Shows>, shown: Option<ReadToken>, map: &str) -> Option<ReadToken> {
        service.inner.shown = shown;
        let message = v1::PredictStatesRequest { map: map.to_owned(), ..Default::default() };
        send(service, PREDICT, &message.encode_to_vec()).await
    }

    async fn send(service: &mut TokenService<Shows>, path: &str, message: &[u8]) -> Option<ReadToken> {
        let length = u32::try_from(message.len()).expect("short");
        let bytes = tonic::codegen::Bytes::from([&[0][..], &length.to_be_bytes(), message].concat());
        let request = http::Request::builder().uri(path).body(Body::new(Whole(Some(bytes)))).expect("a request");
        service.call(request).await.expect("a reply");
        service.inner.received.lock().expect("not poisoned").pop().expect("it was asked")
    }

    struct Whole(Option<tonic::codegen::Bytes>);

    impl http_body::Body for Whole {
        type Data = tonic::codegen::Bytes;
        type Error = Infallible;

        fn poll_frame(
            mut self: Pin<&mut Self>,
            _: &mut Context<'_>,
        ) -> Poll<Option<Result<http_body::Frame<Self::Data>, Infallible>>> {
            Poll::Ready(self.0.take().map(|bytes| Ok(http_body::Frame::data(bytes))))
        }
    }

    #[tokio::test]
    async fn requests_carry_the_most_that_was_seen_of_their_map() {
        let tokens = ReadTokens::default();
        let mut service = TokenService::new(Shows { shown: None, received: Arc::default() }, tokens.clone());
        assert_eq!(ask(&mut service, None, "office").await, None);
        assert_eq!(ask(&mut service, Some(token(7, 2)), "office").await, None, "nothing is known before the reply");
        assert_eq!(ask(&mut service, Some(token(5, 3)), "office").await, Some(token(7, 2)));
        assert_eq!(ask(&mut service, None, "office").await, Some(token(7, 3)));
        assert_eq!(ask(&mut service, None, "home").await, None);
        tokens.saw("office", ReadToken::default());
        tokens.saw("office", token(9, 0));
        assert_eq!(ask(&mut service.clone(), None, "office").await, Some(token(9, 3)), "clones share the tokens");
        let another = ReadToken { map_uid: 8, ..token(1, 0) };
        assert_eq!(ask(&mut service, Some(another), "office").await, Some(token(9, 3)));
        assert_eq!(ask(&mut service, None, "office").await, Some(another), "somebody has made the map anew");
        let created =
            v1::CreateMapRequest { name: "office".to_owned(), time_zone: "UTC".to_owned(), ..Default::default() };
        send(&mut service, RENEWING[0], &created.encode_to_vec()).await;
        assert_eq!(ask(&mut service, None, "office").await, None);
    }
}

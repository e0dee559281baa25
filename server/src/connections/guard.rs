//! A connection under guard: it ends when it makes no request in time, or when it has to make room.
//!
//! Invariant: the guard changes no byte.

use std::{
    io,
    pin::Pin,
    task::{Context, Poll, ready},
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, Sleep, sleep_until},
};

use super::{
    Peer, Place, REQUEST_WITHIN,
    request_scan::{Protocol, RequestScan},
};

/// A connection and its place.
#[derive(Debug)]
pub(crate) struct GuardedConnection<S> {
    socket: S,
    place: Place,
    scan: RequestScan,
    /// The deadline of the first request.
    deadline: Option<Pin<Box<Sleep>>>,
}

impl<S> GuardedConnection<S> {
    pub(super) fn new(socket: S, place: Place, protocol: Protocol) -> Self {
        let deadline = Some(Box::pin(sleep_until(Instant::now() + REQUEST_WITHIN)));
        Self { socket, place, scan: RequestScan::new(protocol), deadline }
    }

    /// Who is at the other end.
    pub(crate) fn peer(&self) -> Peer {
        self.place.seat.peer
    }

    /// A server that waits to write its greeting, as in a TLS handshake, does not read; the deadline holds then too.
    fn check_before_request(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        match self.deadline.is_some().then(|| self.must_end(context)).flatten() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    fn must_end(&mut self, context: &mut Context<'_>) -> Option<io::Error> {
        if self.place.seat.is_displaced(context.waker()) {
            return Some(io::Error::new(io::ErrorKind::ConnectionAborted, "the connection made room for another"));
        }
        let deadline = self.deadline.as_mut()?;
        deadline.as_mut().poll(context).is_ready().then(|| {
            metrics::counter!("tidemap_connections_silent").increment(1);
            io::Error::new(io::ErrorKind::TimedOut, "the connection made no request in time")
        })
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for GuardedConnection<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let guarded = &mut *self;
        if let Some(error) = guarded.must_end(context) {
            return Poll::Ready(Err(error));
        }
        let before = buffer.filled().len();
        ready!(Pin::new(&mut guarded.socket).poll_read(context, buffer))?;
        if guarded.scan.sees_request(&buffer.filled()[before..]) {
            guarded.place.seat.asks();
            guarded.deadline = None;
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for GuardedConnection<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.check_before_request(context)?;
        Pin::new(&mut self.socket).poll_write(context, bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.check_before_request(context)?;
        Pin::new(&mut self.socket).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.check_before_request(context)?;
        Pin::new(&mut self.socket).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(context)
    }
}

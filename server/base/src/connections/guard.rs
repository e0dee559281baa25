//! A connection under guard: it ends when it makes no request in time, when it has to make room, and on the HTTP port
//! when nobody reads its reply.
//!
//! Invariant: the guard changes no byte. The daemon closes no connection with bytes of the client on their way, because
//! the client could then lose the last bytes that were sent to it: after its own end, the daemon reads on for
//! [`LINGER`] and [`LINGER_BYTES`] at most.

use std::{
    io,
    pin::Pin,
    task::{Context, Poll, ready},
    time::Duration,
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    time::{Instant, Sleep, sleep, sleep_until},
};

use tracing::info;

use super::{
    ConnectionSlot, Port, REQUEST_WITHIN, Remote,
    stall::{Stall, UNREAD_FOR},
};
use crate::telemetry::occasional::Occasional;

static UNREAD: Occasional = Occasional::new();

/// Maximum number of bytes that are read and ignored meanwhile, a few at a time, because others wait.
const LINGER_BYTES: usize = 64 << 10;
/// Maximum time for the other end to close its side after the daemon has closed its own.
const LINGER: Duration = Duration::from_secs(1);

/// A connection and its slot.
#[derive(Debug)]
pub struct GuardedConnection<S> {
    socket: S,
    slot: ConnectionSlot,
    /// The deadline of the first request; in the reserve for probes, the deadline of the connection.
    deadline: Option<Pin<Box<Sleep>>>,
    /// The deadline of the wait for the other side's end, and the number of ignored bytes.
    linger: Option<(Pin<Box<Sleep>>, usize)>,
    /// The pauses in which the client takes nothing of its reply.
    stall: Stall,
}

impl<S> GuardedConnection<S> {
    pub(super) fn new(socket: S, slot: ConnectionSlot) -> Self {
        let deadline = Some(Box::pin(sleep_until(Instant::now() + REQUEST_WITHIN)));
        Self { socket, slot, deadline, linger: None, stall: Stall::default() }
    }

    /// The other end of the connection.
    pub fn remote(&self) -> Remote {
        self.slot.remote()
    }

    /// A server that waits to write its greeting, as in a TLS handshake, does not read; the deadline holds then too.
    fn check_before_request(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        match self.request_deadline().is_some().then(|| self.must_end(context)).flatten() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    /// The deadline of the first request; `None` after that request. The reserve for probes always has one.
    fn request_deadline(&mut self) -> Option<&mut Pin<Box<Sleep>>> {
        if self.slot.port != Port::Probes && self.slot.seat.has_request() {
            self.deadline = None;
        }
        self.deadline.as_mut()
    }

    fn must_end(&mut self, context: &mut Context<'_>) -> Option<io::Error> {
        if self.slot.seat.is_displaced(context.waker()) {
            return Some(io::Error::new(io::ErrorKind::ConnectionAborted, "the connection made room for another"));
        }
        let deadline = self.request_deadline()?;
        deadline.as_mut().poll(context).is_ready().then(|| {
            metrics::counter!("tidemap_connections_silent", "port" => self.slot.port.name()).increment(1);
            io::Error::new(io::ErrorKind::TimedOut, "the connection made no request in time")
        })
    }

    /// Watches the result of a write. The wait for a client of the HTTP port that takes nothing is bounded, and the
    /// connection may make room meanwhile. `bytes` returns how many bytes the client took.
    fn watch_reader<T>(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<T>>,
        bytes: impl FnOnce(&T) -> usize,
    ) -> Poll<io::Result<T>> {
        if !matches!(self.slot.port, Port::Http | Port::Probes) {
            return written;
        }
        if let Poll::Ready(done) = &written {
            self.stall.note_taken(done.as_ref().map_or(0, bytes));
            self.slot.seat.note_stall(None);
            return written;
        }
        if let Some(error) = self.must_end(context) {
            return Poll::Ready(Err(error));
        }
        let stalled = self.stall.poll_stalled(context);
        self.slot.seat.note_stall(self.stall.began());
        ready!(stalled);
        metrics::counter!("tidemap_replies_ended_total", "reason" => "unread").increment(1);
        if let Some(left_out) = UNREAD.next() {
            let (peer, secs) = (self.slot.seat.peer, UNREAD_FOR.as_secs());
            info!(%peer, secs, left_out, "a reply was ended, because its client did not read it");
        }
        Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client does not read its reply")))
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
        Pin::new(&mut guarded.socket).poll_read(context, buffer)
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> AsyncWrite for GuardedConnection<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        self.check_before_request(context)?;
        let written = Pin::new(&mut self.socket).poll_write(context, bytes);
        self.watch_reader(context, written, |bytes| *bytes)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        self.check_before_request(context)?;
        let written = Pin::new(&mut self.socket).poll_write_vectored(context, slices);
        self.watch_reader(context, written, |bytes| *bytes)
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.check_before_request(context)?;
        let flushed = Pin::new(&mut self.socket).poll_flush(context);
        self.watch_reader(context, flushed, |()| 0)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let ended = Pin::new(&mut self.socket).poll_shutdown(context);
        ready!(self.watch_reader(context, ended, |()| 0))?;
        let guarded = &mut *self;
        let (until, ignored) = guarded.linger.get_or_insert_with(|| (Box::pin(sleep(LINGER)), 0));
        let mut bytes = [0; 8192];
        while *ignored < LINGER_BYTES
            && !guarded.slot.seat.is_displaced(context.waker())
            && until.as_mut().poll(context).is_pending()
        {
            let mut buffer = ReadBuf::new(&mut bytes);
            let read = ready!(Pin::new(&mut guarded.socket).poll_read(context, &mut buffer));
            *ignored += buffer.filled().len();
            if read.is_err() || buffer.filled().is_empty() {
                break;
            }
        }
        Poll::Ready(Ok(()))
    }
}

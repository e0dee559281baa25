//! Reads bytes in order: with lookahead, and by fields.
//!
//! Invariant: memory grows with the bytes that are there, not with the lengths that they state. A source that ends too
//! early gives [`io::ErrorKind::UnexpectedEof`].

use std::io::{self, Read};

const BUFFER_BYTES: usize = 64 << 10;

/// Bytes in order, counted, with lookahead.
pub(crate) struct ByteSource<R> {
    inner: R,
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    position: u64,
}

impl<R: Read> ByteSource<R> {
    pub(crate) fn new(inner: R) -> Self {
        Self { inner, buffer: vec![0; BUFFER_BYTES].into_boxed_slice(), start: 0, end: 0, position: 0 }
    }

    /// The number of bytes that have been taken.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// The next bytes, which stay there. They are fewer than `count` where the source ends; at most 64 KiB.
    pub(crate) fn peek(&mut self, count: usize) -> io::Result<&[u8]> {
        let count = count.min(BUFFER_BYTES);
        if self.end - self.start < count {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
            while self.end < count {
                match self.inner.read(&mut self.buffer[self.end..]) {
                    Ok(0) => break,
                    Ok(got) => self.end += got,
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(error) => return Err(error),
                }
            }
        }
        let until = self.end.min(self.start + count);
        Ok(&self.buffer[self.start..until])
    }

    /// Whether no byte is left.
    pub(crate) fn is_at_end(&mut self) -> io::Result<bool> {
        Ok(self.peek(1)?.is_empty())
    }

    /// Takes `N` bytes.
    pub(crate) fn array<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    /// Takes `count` bytes and replaces the content of `into` with them.
    pub(crate) fn take_into(&mut self, into: &mut Vec<u8>, count: usize) -> io::Result<()> {
        into.clear();
        let got = self.by_ref().take(count as u64).read_to_end(into)?;
        if got < count { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(()) }
    }

    /// Passes over `count` bytes.
    pub(crate) fn skip(&mut self, count: u64) -> io::Result<()> {
        let got = io::copy(&mut self.by_ref().take(count), &mut io::sink())?;
        if got < count { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(()) }
    }
}

impl<R: Read> Read for ByteSource<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let got = if self.start == self.end && into.len() >= BUFFER_BYTES {
            self.inner.read(into)?
        } else {
            let ahead = self.peek(1)?.len();
            let got = into.len().min(if ahead == 0 { 0 } else { self.end - self.start });
            into[..got].copy_from_slice(&self.buffer[self.start..self.start + got]);
            self.start += got;
            got
        };
        self.position += got as u64;
        Ok(got)
    }
}

/// Bytes that are taken field by field, the low byte of a number first. `None`: fewer are left.
#[derive(Clone, Copy)]
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    pub(crate) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array().map(u8::from_le_bytes)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes behind their length of four bytes.
    pub(crate) fn counted(&mut self) -> Option<&'a [u8]> {
        let count = usize::try_from(self.u32()?).ok()?;
        self.take(count)
    }

    /// Text behind its length of four bytes.
    pub(crate) fn text(&mut self) -> Option<String> {
        self.counted().map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }
}

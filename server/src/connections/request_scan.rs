//! Finds the first request in the bytes that a client sends: a frame of HTTP/2 that opens it, or the end of the headers
//! of HTTP/1.
//!
//! Invariant: it looks at frame headers only, costs a few operations per frame, and understands no content. Bytes that
//! are no HTTP are no request.

/// The client connection preface of HTTP/2 (RFC 9113, section 3.4).
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const FRAME_HEADER_BYTES: usize = 9;
const HEADERS: u8 = 1;

/// Which protocol a port speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// HTTP/2 with prior knowledge, as gRPC.
    Http2,
    /// HTTP/1.
    Http1,
}

/// The state of a scan.
#[derive(Debug)]
pub(super) enum RequestScan {
    /// So many bytes of the preface were seen.
    Preface(usize),
    /// A frame header of which so many bytes were seen.
    Header([u8; FRAME_HEADER_BYTES], usize),
    /// So many bytes of a frame are left.
    Payload(usize),
    /// So many bytes of the end of HTTP/1 headers were seen.
    Lines(usize),
    /// No HTTP.
    Unknown,
}

impl RequestScan {
    pub(super) fn new(protocol: Protocol) -> Self {
        match protocol {
            Protocol::Http2 => Self::Preface(0),
            Protocol::Http1 => Self::Lines(0),
        }
    }

    /// Looks at received bytes; whether they hold a request.
    pub(super) fn sees_request(&mut self, mut bytes: &[u8]) -> bool {
        let mut has_request = false;
        while let Some((&byte, rest)) = bytes.split_first() {
            match self {
                Self::Preface(seen) => {
                    if PREFACE.get(*seen) != Some(&byte) {
                        *self = Self::Unknown;
                        return has_request;
                    }
                    *seen += 1;
                    if *seen == PREFACE.len() {
                        *self = Self::Header([0; FRAME_HEADER_BYTES], 0);
                    }
                    bytes = rest;
                }
                Self::Header(header, seen) => {
                    header[*seen] = byte;
                    *seen += 1;
                    bytes = rest;
                    if *seen == FRAME_HEADER_BYTES {
                        has_request |= header[3] == HEADERS;
                        let length = header[..3].iter().fold(0, |length, byte| length << 8 | usize::from(*byte));
                        *self =
                            if length == 0 { Self::Header([0; FRAME_HEADER_BYTES], 0) } else { Self::Payload(length) };
                    }
                }
                Self::Payload(left) => {
                    let skipped = bytes.len().min(*left);
                    *left -= skipped;
                    bytes = &bytes[skipped..];
                    if *left == 0 {
                        *self = Self::Header([0; FRAME_HEADER_BYTES], 0);
                    }
                }
                Self::Lines(seen) => {
                    *seen = match (byte, *seen) {
                        (b'\r', 2) => 3,
                        (b'\r', _) => 1,
                        (b'\n', seen @ (1 | 3)) => seen + 1,
                        _ => 0,
                    };
                    if *seen == 4 {
                        has_request = true;
                        *seen = 0;
                    }
                    bytes = rest;
                }
                Self::Unknown => return has_request,
            }
        }
        has_request
    }
}

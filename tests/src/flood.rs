//! Floods: clients that take what they can get, and go on until they are dropped.
//!
//! Invariant: all of it stays on loopback. A flood is of one kind, and everything that it sends is complete HTTP up to
//! the point where it stalls.

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpSocket, TcpStream},
    task::JoinSet,
};
use tokio_rustls::rustls::{pki_types::ServerName, version};

use crate::certificates::Authority;

/// A connection that is silent for so long sends nothing more for now.
const SILENT_AFTER: Duration = Duration::from_millis(100);
/// A connection that is not read is held for so long.
const HELD_FOR: Duration = Duration::from_secs(5);
/// A client waits for so long for an answer, if it waits.
const ANSWER_WITHIN: Duration = Duration::from_secs(60);

/// A connection from an address of loopback.
///
/// # Errors
/// It is refused.
pub async fn connect_from(source: Ipv4Addr, address: &str) -> std::io::Result<TcpStream> {
    let address: SocketAddr = address.parse().expect("HOST:PORT of loopback");
    let socket = TcpSocket::new_v4()?;
    // Bytes that are not read stay at the other end.
    socket.set_recv_buffer_size(16 << 10)?;
    socket.bind(SocketAddr::from((source, 0)))?;
    socket.connect(address).await
}

/// The bytes that open a connection of HTTP/2.
#[must_use]
pub fn http2_preface() -> Vec<u8> {
    [b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".as_slice(), &[0, 0, 0, 4, 0, 0, 0, 0, 0]].concat()
}

/// The headers of a call of gRPC, and nothing of its message. `is_whole`: no message follows.
///
/// # Panics
/// If the path is long.
#[must_use]
pub fn call_headers(stream: u32, path: &str, is_whole: bool) -> Vec<u8> {
    let text = |text: &str| [&[u8::try_from(text.len()).expect("short")], text.as_bytes()].concat();
    let field = |name: &str, value: &str| [vec![0], text(name), text(value)].concat();
    // Indexed: POST and http; then the path and the authority by the index of their names.
    let block = [
        vec![0x83, 0x86, 0x04],
        text(path),
        vec![0x01],
        text("here"),
        field("content-type", "application/grpc"),
        field("te", "trailers"),
    ]
    .concat();
    let length = u32::try_from(block.len()).expect("short").to_be_bytes();
    let flags = if is_whole { 0x05 } else { 0x04 };
    [&length[1..], &[1, flags], &stream.to_be_bytes(), &block].concat()
}

/// Requests a path so many times over one connection of HTTP/2, whose replies may send nothing: their window is 0.
///
/// # Panics
/// If the path is long.
#[must_use]
pub fn gets_without_window(path: &str, count: u32) -> Vec<u8> {
    let preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n".as_slice();
    let settings = [0, 0, 6, 4, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0];
    let length = u8::try_from(path.len()).expect("short");
    // Indexed: GET and http; then the path and the authority by the index of their names.
    let block = [&[0x82, 0x86, 0x04, length], path.as_bytes(), &[0x01, 9], b"localhost"].concat();
    let size = u32::try_from(block.len()).expect("short").to_be_bytes();
    let get = |number: u32| [&size[1..], &[1, 0x05], &(2 * number + 1).to_be_bytes(), &block].concat();
    [preface, &settings].concat().into_iter().chain((0..count).flat_map(get)).collect()
}

/// Reads what there is, until the other end is silent. `false`: it has closed the connection.
async fn read_until_silent(socket: &mut TcpStream) -> bool {
    let mut bytes = [0; 4096];
    loop {
        match tokio::time::timeout(SILENT_AFTER, socket.read(&mut bytes)).await {
            Err(_) => return true,
            Ok(Ok(1..)) => {}
            Ok(_) => return false,
        }
    }
}

/// A running flood; it ends when it is dropped.
#[derive(Debug)]
pub struct Flood {
    rounds: Arc<AtomicU64>,
    answers: Arc<Mutex<Vec<u16>>>,
    _clients: JoinSet<()>,
}

impl Flood {
    fn start<W: Future<Output = ()> + Send + 'static>(
        sources: &[Ipv4Addr],
        connections_each: usize,
        client: impl Fn(Ipv4Addr, Arc<AtomicU64>, Arc<Mutex<Vec<u16>>>) -> W,
    ) -> Self {
        let (rounds, answers) = (Arc::new(AtomicU64::new(0)), Arc::default());
        let mut clients = JoinSet::new();
        for source in sources.iter().copied().cycle().take(sources.len() * connections_each) {
            clients.spawn(client(source, Arc::clone(&rounds), Arc::clone(&answers)));
        }
        Self { rounds, answers, _clients: clients }
    }

    /// Opens calls of gRPC without sending their messages, so many at a time on each connection.
    #[must_use]
    pub fn half_open_calls(
        address: &str,
        path: &'static str,
        (sources, connections_each, calls): (&[Ipv4Addr], usize, u32),
    ) -> Self {
        let address = address.to_owned();
        Self::start(sources, connections_each, |source, rounds, _| {
            let address = address.clone();
            async move {
                loop {
                    let Ok(mut socket) = connect_from(source, &address).await else {
                        tokio::time::sleep(SILENT_AFTER).await;
                        continue;
                    };
                    let mut bytes = http2_preface();
                    // Streams of clients have odd numbers.
                    for round in 0.. {
                        let first = round * calls;
                        bytes.extend((first..first + calls).flat_map(|call| call_headers(2 * call + 1, path, false)));
                        let is_open = socket.write_all(&bytes).await.is_ok() && read_until_silent(&mut socket).await;
                        rounds.fetch_add(1, Ordering::Relaxed);
                        bytes.clear();
                        if !is_open {
                            break;
                        }
                    }
                }
            }
        })
    }

    /// Posts a body to a path of the HTTP port, again and again, on so many connections. `headers` end with a line
    /// break each.
    #[must_use]
    pub fn posts(address: &str, path: &str, headers: &str, body: &[u8], (sources, each): (&[Ipv4Addr], usize)) -> Self {
        let head = format!(
            "POST {path} HTTP/1.0\r\nHost: {address}\r\nContent-Type: application/json\r\nContent-Length: {}\r\n{headers}\r\n",
            body.len()
        );
        let (address, request) = (address.to_owned(), Arc::new([head.as_bytes(), body].concat()));
        Self::start(sources, each, |source, rounds, answers| {
            let (address, request) = (address.clone(), Arc::clone(&request));
            async move {
                loop {
                    let Ok(mut socket) = connect_from(source, &address).await else {
                        tokio::time::sleep(SILENT_AFTER).await;
                        continue;
                    };
                    // A refused request may not be read to its end.
                    let _ = socket.write_all(&request).await;
                    let mut answer = Vec::new();
                    let _ = tokio::time::timeout(ANSWER_WITHIN, socket.read_to_end(&mut answer)).await;
                    let code = answer.get(9..12).and_then(|code| std::str::from_utf8(code).ok()?.parse::<u16>().ok());
                    answers.lock().unwrap_or_else(PoisonError::into_inner).extend(code);
                    rounds.fetch_add(1, Ordering::Relaxed);
                }
            }
        })
    }

    /// Sends bytes on so many connections and reads nothing. Each is held for some seconds, and opened again.
    #[must_use]
    pub fn unread(address: &str, bytes: Vec<u8>, (sources, each): (&[Ipv4Addr], usize)) -> Self {
        let (address, bytes) = (address.to_owned(), Arc::new(bytes));
        Self::start(sources, each, |source, rounds, _| {
            let (address, bytes) = (address.clone(), Arc::clone(&bytes));
            async move {
                loop {
                    if let Ok(mut socket) = connect_from(source, &address).await {
                        // A daemon that waits for its reader does not read either.
                        let _ = tokio::time::timeout(SILENT_AFTER, socket.write_all(&bytes)).await;
                        rounds.fetch_add(1, Ordering::Relaxed);
                        tokio::time::sleep(HELD_FOR).await;
                    }
                    tokio::time::sleep(SILENT_AFTER).await;
                }
            }
        })
    }

    /// Does the same as [`Flood::unread`], with TLS by a certificate of this authority.
    ///
    /// # Panics
    /// If TLS cannot be set up.
    #[must_use]
    pub fn unread_tls(
        address: &str,
        authority: &Authority,
        bytes: Vec<u8>,
        (sources, each): (&[Ipv4Addr], usize),
    ) -> Self {
        let (address, bytes, connector) = (address.to_owned(), Arc::new(bytes), authority.connector(&version::TLS13));
        let name = ServerName::try_from("localhost").expect("a name");
        Self::start(sources, each, |source, rounds, _| {
            let (address, bytes) = (address.clone(), Arc::clone(&bytes));
            let (connector, name) = (connector.clone(), name.clone());
            async move {
                loop {
                    if let Ok(socket) = connect_from(source, &address).await
                        && let Ok(mut socket) = connector.connect(name.clone(), socket).await
                    {
                        let _ = tokio::time::timeout(SILENT_AFTER, socket.write_all(&bytes)).await;
                        rounds.fetch_add(1, Ordering::Relaxed);
                        tokio::time::sleep(HELD_FOR).await;
                    }
                    tokio::time::sleep(SILENT_AFTER).await;
                }
            }
        })
    }

    /// Number of times that clients have sent all their bytes.
    #[must_use]
    pub fn rounds(&self) -> u64 {
        self.rounds.load(Ordering::Relaxed)
    }

    /// The codes of the answers of HTTP so far.
    #[must_use]
    pub fn answers(&self) -> Vec<u16> {
        self.answers.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Waits until so many rounds are done, so that a test without a flood does not count.
    ///
    /// # Panics
    /// If nothing flows.
    pub async fn flowing(&self, rounds: u64) {
        let flows = async {
            while self.rounds() < rounds {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), flows).await.expect("the flood flows");
    }
}

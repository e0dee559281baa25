//! One import: the program `tidemap` reads the file and sends its observations, as any client would.
//!
//! Invariant: the program has no access to the daemon but a Unix socket that nobody else can reach, on which the
//! caller's token is checked as on every port. It ends before its file is removed, whatever ends first: the sender, who
//! reads its output, the sender's token, or the daemon. Its output is bounded, and so are its memory, its processor
//! time and its duration.

use std::{
    convert::Infallible,
    fs, io,
    os::{
        fd::AsRawFd as _,
        unix::process::{CommandExt as _, ExitStatusExt as _},
    },
    path::{Path, PathBuf},
    pin::pin,
    process::{ExitStatus, Stdio},
    time::{Duration, Instant},
};

use axum::body::Bytes;
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use serde_json::{Value, json};
use tidemap_base::{
    access::Caller,
    connections::{
        ConnectionLimits, Connections, Port,
        accept::{Acceptor, Listener},
        socket::listen_unix,
    },
};
use tidemap_map::name::{MapName, ProducerKey};
use tidemap_rpc::{
    admission::Admitted,
    guard::Access,
    serve::{Services, serve},
};
use tokio::{
    io::{AsyncBufReadExt as _, AsyncRead, AsyncReadExt as _, AsyncWriteExt as _, BufReader},
    process::{Child, Command},
    sync::{mpsc, watch},
    time::MissedTickBehavior,
};
use tracing::{info, warn};

use super::workplace::Workplace;

/// Processor time of the program in seconds, plus one second per [`BYTES_PER_CPU_SEC`] bytes of the file. A hostile
/// file of a few bytes could take hours.
const CPU_SECS: u64 = 120;
const BYTES_PER_CPU_SEC: u64 = 256 << 10;
/// Seconds after which a program is killed that does not end when its processor time is over.
const CPU_SECS_TO_END: u64 = 5;
/// Maximum duration of an import.
const ENDS_WITHIN: Duration = Duration::from_secs(12 * 3600);
/// With this score the system ends the program before the daemon when memory is short.
const OOM_SCORE: &str = "1000";
/// Connections of the program.
const CONNECTIONS: ConnectionLimits =
    ConnectionLimits { total: 16, per_client: 16, idle_after: Duration::from_secs(60) };
/// Name of the socket.
const SOCKET: &str = "socket";
/// Time between two progress lines, which show that the import still runs.
const BEAT_EVERY: Duration = Duration::from_secs(2);
/// Maximum time for a line to be taken.
const READ_WITHIN: Duration = Duration::from_secs(60);
/// Maximum number of lines that are sent.
const LINES_MAX: usize = 2000;
/// A longer line is sent in parts.
const LINE_BYTES_MAX: u64 = 4096;
/// Number of lines that wait.
const LINES_AHEAD: usize = 64;
/// Exit status of a program that a signal ended, minus the signal, as in shells.
const SIGNALLED: i32 = 128;

/// The resources that the daemon gives to an import.
pub(super) struct Origin {
    pub(super) services: Services,
    pub(super) access: Access,
    /// Becomes true when the daemon stops.
    pub(super) stopping: watch::Receiver<bool>,
}

/// An import of the file that its place holds.
pub(super) struct Import {
    pub(super) program: PathBuf,
    pub(super) map: MapName,
    pub(super) key: ProducerKey,
    /// Whether an update ends the import.
    pub(super) has_update: bool,
    /// The token with which the program proves the identity of its sender.
    pub(super) token: Option<String>,
    /// Size of the file.
    pub(super) bytes: u64,
    pub(super) place: Workplace,
    pub(super) origin: Origin,
}

/// The reason why an import did not end by itself.
#[derive(Debug, thiserror::Error)]
enum Stopped {
    #[error("the sender has disconnected")]
    Left,
    #[error("the daemon is stopping; the same file again sends what is missing")]
    Stopping,
    #[error("the sender's token was revoked or changed, or has expired: send the file again with one that is valid")]
    Revoked,
    #[error("the import has not ended within {} hours: use tidemap import", ENDS_WITHIN.as_secs() / 3600)]
    Long,
    #[error("the import cannot be run: {0}")]
    Io(#[from] io::Error),
}

impl Stopped {
    fn object(&self) -> Value {
        let (code, reason) = match self {
            Self::Left => ("CANCELLED", "LEFT"),
            Self::Stopping => ("UNAVAILABLE", "STOPPING"),
            Self::Revoked => ("UNAUTHENTICATED", "REVOKED"),
            Self::Long => ("DEADLINE_EXCEEDED", "LATE"),
            Self::Io(_) => ("INTERNAL", "IMPORT_FAILED"),
        };
        json!({ "error": { "code": code, "reason": reason, "message": self.to_string() } })
    }
}

/// The recipients of the lines of an import.
struct Listeners(mpsc::Sender<Result<Bytes, Infallible>>);

impl Listeners {
    async fn send(&self, object: &Value) -> Result<(), Stopped> {
        let line = Bytes::from(format!("{object}\n"));
        self.0.send_timeout(Ok(line), READ_WITHIN).await.map_err(|_| Stopped::Left)
    }

    async fn line(&self, text: &str) -> Result<(), Stopped> {
        self.send(&json!({ "line": text })).await
    }
}

impl Import {
    /// Starts the import, and returns the lines of its output. The import ends when nobody takes them.
    pub(super) fn start(self, admitted: Admitted) -> mpsc::Receiver<Result<Bytes, Infallible>> {
        let (sender, lines) = mpsc::channel(LINES_AHEAD);
        tidemap_base::task::spawn(async move {
            let listeners = Listeners(sender);
            let ended = self.run(&listeners, admitted.caller().clone()).await;
            let (map, file) = (self.map.as_str(), self.place.file());
            match &ended {
                Ok(exit) => info!(map, file, exit, "a recording was imported"),
                Err(error) => warn!(map, file, %error, "the import of a recording was stopped"),
            }
            self.place.clear().await;
            let last = match ended {
                Ok(exit) => json!({ "done": true, "exit": exit }),
                Err(error) => error.object(),
            };
            // A sender that has left does not receive the line.
            drop(listeners.send(&last).await);
            drop(admitted);
        });
        lines
    }

    /// Runs the program to its end, and returns its exit status.
    async fn run(&self, listeners: &Listeners, caller: Caller) -> Result<i32, Stopped> {
        let (acceptor, accepted) = Acceptor::new(Connections::new(Port::Imports, CONNECTIONS));
        acceptor.listen(Listener::Unix(listen_in(self.place.folder())?));
        let (stop, stopped) = watch::channel(false);
        let Origin { services, access, .. } = &self.origin;
        tidemap_base::task::spawn(serve(accepted, access.clone(), services.clone(), false, stopped));
        let ended = self.follow(listeners, caller).await;
        stop.send_replace(true);
        ended
    }

    async fn follow(&self, listeners: &Listeners, caller: Caller) -> Result<i32, Stopped> {
        let mut child = self.spawn()?;
        let mut stopping = self.origin.stopping.clone();
        let mut revoked = pin!(self.origin.access.clone().revoked(caller));
        let followed = tokio::select! {
            biased;
            () = revoked.as_mut() => Err(Stopped::Revoked),
            followed = follow(&mut child, self.token.as_deref(), listeners) => followed,
            () = listeners.0.closed() => Err(Stopped::Left),
            _ = stopping.wait_for(|stopping| *stopping) => Err(Stopped::Stopping),
            () = tokio::time::sleep(ENDS_WITHIN) => Err(Stopped::Long),
        };
        let status = match followed {
            Ok(status) => status,
            Err(stopped) => {
                // A program that has already ended is not killed.
                drop(child.kill().await);
                return Err(stopped);
            }
        };
        // The program may have noticed the revocation first, and ended.
        if !status.success() && tokio::time::timeout(Duration::ZERO, revoked).await.is_ok() {
            return Err(Stopped::Revoked);
        }
        Ok(exit_status(status))
    }

    fn spawn(&self) -> io::Result<Child> {
        let mut command = std::process::Command::new(&self.program);
        command
            .args(["import", "--output", "table", "--patience", "10s"])
            .arg(format!("--producer={}", self.key.producer()))
            .arg(format!("--label={}", self.key.label()))
            .args((!self.has_update).then_some("--no-update"))
            // A name that begins with a dash is not an option.
            .args(["--", self.map.as_str(), self.place.file()])
            .current_dir(self.place.recording_folder())
            .env_clear()
            .env("TIDEMAP_SERVER", format!("unix:../{SOCKET}"))
            // The program ends with this process, and leaves the processor to others.
            .env("TIDEMAP_DAEMON", std::process::id().to_string())
            // Few threads and heaps: each takes address space.
            .envs([("TOKIO_WORKER_THREADS", "2"), ("MALLOC_ARENA_MAX", "2")])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            // The daemon ends the program, and a Ctrl-C that is meant for the daemon does not.
            .process_group(0);
        if self.token.is_some() {
            // The token is neither an argument nor a file: others can see an argument, and a file may remain.
            command.env("TIDEMAP_TOKEN_FILE", "/dev/stdin").stdin(Stdio::piped());
        } else {
            command.stdin(Stdio::null());
        }
        let child = Command::from(command).kill_on_drop(true).spawn()?;
        limit(&child, self.place.memory(), cpu_secs(self.bytes));
        Ok(child)
    }
}

/// Listens on a socket in a folder. The path of the socket goes through this process, because the folder's own path may
/// be too long.
fn listen_in(folder: &Path) -> io::Result<tokio::net::UnixListener> {
    let opened = fs::File::open(folder)?;
    listen_unix(&Path::new("/proc/self/fd").join(opened.as_raw_fd().to_string()).join(SOCKET), 0o600)
}

/// Processor time of the program that reads a file of this size.
fn cpu_secs(bytes: u64) -> u64 {
    CPU_SECS + bytes / BYTES_PER_CPU_SEC
}

/// Limits the resources of the program. It was started a moment ago, and has read nothing yet.
fn limit(child: &Child, memory_bytes: u64, cpu_secs: u64) {
    let Some(pid) = child.id() else { return };
    let pid_raw = i32::try_from(pid).ok().and_then(Pid::from_raw);
    for (what, resource, current, maximum) in [
        ("memory", Resource::As, memory_bytes, memory_bytes),
        ("processor time", Resource::Cpu, cpu_secs, cpu_secs + CPU_SECS_TO_END),
    ] {
        let limited = Rlimit { current: Some(current), maximum: Some(maximum) };
        if let Err(error) = prlimit(pid_raw, resource, limited) {
            warn!(%error, what, "the resources of an import are not limited");
        }
    }
    // If the system does not allow this, the daemon is in no worse state than without it.
    let _ = fs::write(format!("/proc/{pid}/oom_score_adj"), OOM_SCORE);
}

/// Sends the output of the program, until the program ends.
async fn follow(child: &mut Child, token: Option<&str>, listeners: &Listeners) -> Result<ExitStatus, Stopped> {
    if let (Some(token), Some(mut stdin)) = (token, child.stdin.take()) {
        // A program that ends before it has read the token reports the reason.
        let _ = stdin.write_all(token.as_bytes()).await;
    }
    let (sender, mut lines) = mpsc::channel(LINES_AHEAD);
    if let Some(output) = child.stdout.take() {
        tidemap_base::task::spawn(split(output, sender.clone()));
    }
    if let Some(output) = child.stderr.take() {
        tidemap_base::task::spawn(split(output, sender));
    }
    let begun = Instant::now();
    let mut beat = tokio::time::interval(BEAT_EVERY);
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut count = 0_usize;
    loop {
        tokio::select! {
            line = lines.recv() => match line {
                Some(line) if count < LINES_MAX => {
                    count += 1;
                    listeners.line(&line).await?;
                }
                Some(_) => count += 1,
                None => break,
            },
            _ = beat.tick() => {
                listeners.send(&json!({ "progress": { "seconds": begun.elapsed().as_secs() } })).await?;
            }
        }
    }
    let status = child.wait().await?;
    if count > LINES_MAX {
        listeners.line(&format!("{} more lines are left out", count - LINES_MAX)).await?;
    }
    if let Some(signal) = status.signal() {
        let text = if signal == Signal::XCPU.as_raw() {
            "the file needs more processor time than an import of its size has here: use tidemap import".to_owned()
        } else {
            format!(
                "the program that read the file was ended by signal {signal}: the file may need more memory than an \
                 import has here. Use tidemap import"
            )
        };
        listeners.line(&text).await?;
    }
    Ok(status)
}

fn exit_status(status: ExitStatus) -> i32 {
    status.code().unwrap_or_else(|| SIGNALLED + status.signal().unwrap_or(0))
}

/// Sends the lines of an output, until it ends or nobody takes them.
async fn split(output: impl AsyncRead + Unpin + Send, lines: mpsc::Sender<String>) {
    let mut output = BufReader::new(output);
    loop {
        let mut line = Vec::new();
        let read = (&mut output).take(LINE_BYTES_MAX).read_until(b'\n', &mut line).await;
        if !matches!(read, Ok(bytes) if bytes > 0) {
            return;
        }
        let text = String::from_utf8_lossy(&line).trim_end().to_owned();
        if lines.send(text).await.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn lines_of(script: &str, token: Option<&str>) -> (ExitStatus, Vec<Value>) {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", script]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.kill_on_drop(true).spawn().expect("a shell");
        let (sender, mut receiver) = mpsc::channel(LINES_AHEAD);
        let listeners = Listeners(sender);
        let received = tokio::spawn(async move {
            let mut received = Vec::new();
            while let Some(Ok(line)) = receiver.recv().await {
                let object: Value = serde_json::from_slice(&line).expect("JSON");
                received.extend(object.get("line").cloned());
            }
            received
        });
        let status = follow(&mut child, token, &listeners).await.expect("it ends");
        drop(listeners);
        (status, received.await.expect("the lines"))
    }

    #[tokio::test]
    async fn the_output_of_a_program_is_passed_on_and_bounded() {
        let (status, lines) = lines_of("cat; echo; echo a >&2; exit 3", Some("secret")).await;
        assert_eq!((exit_status(status), lines.len()), (3, 2));
        assert!(lines.contains(&json!("secret")) && lines.contains(&json!("a")), "{lines:?}");
        let (_, lines) = lines_of("seq 3000", None).await;
        assert_eq!((lines.len(), &lines[LINES_MAX]), (LINES_MAX + 1, &json!("1000 more lines are left out")));
        let (_, lines) = lines_of("head -c 10000 /dev/zero | tr '\\0' x", None).await;
        let lengths: Vec<usize> = lines.iter().filter_map(|line| line.as_str().map(str::len)).collect();
        assert_eq!(lengths, [4096, 4096, 1808]);
        let (status, lines) = lines_of("kill -9 $$", None).await;
        assert_eq!((exit_status(status), lines.len()), (137, 1));
    }

    #[tokio::test]
    async fn a_program_that_takes_too_much_of_the_processor_ends_with_the_reason() {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", "while :; do :; done"]).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.kill_on_drop(true).spawn().expect("a shell");
        limit(&child, 1 << 30, 1);
        let (sender, mut receiver) = mpsc::channel(LINES_AHEAD);
        let status = follow(&mut child, None, &Listeners(sender)).await.expect("it ends");
        assert_eq!(status.signal(), Some(Signal::XCPU.as_raw()));
        let mut received = Vec::new();
        while let Some(Ok(line)) = receiver.recv().await {
            received.extend_from_slice(&line);
        }
        let received = String::from_utf8_lossy(&received);
        assert!(received.contains("processor time") && received.contains("tidemap import"), "{received}");
        assert_eq!((cpu_secs(2_000), cpu_secs(4 << 30)), (CPU_SECS, CPU_SECS + 16_384));
    }

    #[tokio::test]
    async fn a_program_whose_sender_left_is_not_waited_for() {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", "echo a; sleep 600"]).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.kill_on_drop(true).spawn().expect("a shell");
        let (sender, receiver) = mpsc::channel(LINES_AHEAD);
        drop(receiver);
        let followed = follow(&mut child, None, &Listeners(sender)).await;
        assert!(matches!(followed, Err(Stopped::Left)));
    }
}

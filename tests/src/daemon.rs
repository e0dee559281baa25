//! The daemon as a process.
//!
//! Invariant: a daemon listens on loopback, on free ports, and is killed when its handle is dropped. Its output
//! on stderr is kept. Timeouts are long: they detect a daemon that hangs, never one that is slow.

use std::{
    ffi::OsString,
    fmt,
    io::{BufRead as _, BufReader, Read},
    os::unix::process::ExitStatusExt as _,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU16, Ordering},
        mpsc,
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

pub use rustix::process::Signal;
use rustix::process::{Pid, kill_process};
use tidemap_client::Client;

use crate::binaries;

/// Timeout until a daemon is ready.
const READY_WITHIN: Duration = Duration::from_secs(120);
/// Timeout until a daemon has ended.
const EXIT_WITHIN: Duration = Duration::from_secs(60);
const POLL: Duration = Duration::from_millis(5);

/// How to start a daemon.
#[derive(Clone, Debug)]
pub struct Launch {
    program: PathBuf,
    wrapper: Vec<OsString>,
    args: Vec<OsString>,
    environment: Vec<(String, OsString)>,
    working_directory: Option<PathBuf>,
}

impl Launch {
    /// The daemon of this build, without any settings.
    #[must_use]
    pub fn bare() -> Self {
        Self {
            program: binaries::tidemapd(),
            wrapper: Vec::new(),
            args: Vec::new(),
            environment: Vec::new(),
            working_directory: None,
        }
    }

    /// The daemon of this build, on free ports, with its data in `data`. Set through the environment, so that a flag
    /// has priority.
    #[must_use]
    pub fn on(data: &Path) -> Self {
        let loopback = Self::bare().setting("listen", "127.0.0.1:0").setting("http_listen", "127.0.0.1:0");
        loopback.setting("data_dir", data.display())
    }

    /// Another program instead of the daemon of this build.
    #[must_use]
    pub fn program(mut self, program: PathBuf) -> Self {
        self.program = program;
        self
    }

    /// A command that starts the daemon as its child, such as `strace`.
    #[must_use]
    pub fn under<T: Into<OsString>>(mut self, wrapper: impl IntoIterator<Item = T>) -> Self {
        self.wrapper = wrapper.into_iter().map(Into::into).collect();
        self
    }

    /// More arguments.
    #[must_use]
    pub fn args<T: Into<OsString>>(mut self, args: impl IntoIterator<Item = T>) -> Self {
        self.args.extend(args.into_iter().map(Into::into));
        self
    }

    /// A setting by its key, through the environment.
    #[must_use]
    pub fn setting(mut self, key: &str, value: impl fmt::Display) -> Self {
        self.environment.push((format!("TIDEMAP_{}", key.to_uppercase()), value.to_string().into()));
        self
    }

    /// The working directory.
    #[must_use]
    pub fn working_directory(mut self, folder: &Path) -> Self {
        self.working_directory = Some(folder.to_path_buf());
        self
    }

    /// Starts the process and does not wait.
    ///
    /// # Panics
    /// If there is no such program.
    #[must_use]
    pub fn spawn(&self) -> Process {
        let mut words = self.wrapper.iter().cloned().chain([self.program.clone().into_os_string()]);
        let mut command = Command::new(words.next().expect("there is a program"));
        command.args(words).args(&self.args);
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("TIDEMAP_")) {
            command.env_remove(name);
        }
        command.envs(self.environment.iter().map(|(name, value)| (name, value)));
        if let Some(folder) = &self.working_directory {
            command.current_dir(folder);
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Process::watch(command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}")))
    }

    /// Starts the daemon and waits until it is ready.
    ///
    /// # Errors
    /// The exit of the process, if it ended instead.
    ///
    /// # Panics
    /// If it neither becomes ready nor ends.
    pub fn try_start(&self) -> Result<Daemon, Exit> {
        self.spawn().ready()
    }

    /// Starts the daemon and waits until it is ready.
    ///
    /// # Panics
    /// If it does not become ready.
    #[must_use]
    pub fn start(&self) -> Daemon {
        self.try_start().unwrap_or_else(|exit| panic!("the daemon did not start: {exit}"))
    }
}

/// Exit status and stderr of a process.
#[derive(Clone, Debug)]
pub struct Exit {
    /// The status with which the process ended.
    pub status: ExitStatus,
    /// All of stderr.
    pub stderr: String,
}

impl Exit {
    /// The exit status, where it was not a signal.
    #[must_use]
    pub fn code(&self) -> Option<i32> {
        self.status.code()
    }
}

impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.status)?;
        if let Some(signal) = self.status.signal() {
            write!(f, " (signal {signal})")?;
        }
        write!(f, "\n{}", self.stderr)
    }
}

/// A running process whose output is read.
#[derive(Debug)]
pub struct Process {
    child: Child,
    lines: mpsc::Receiver<String>,
    stderr: Arc<Mutex<String>>,
    readers: Vec<JoinHandle<()>>,
}

impl Process {
    fn watch(mut child: Child) -> Self {
        let (sender, lines) = mpsc::channel();
        let stdout = child.stdout.take().expect("stdout is a pipe");
        let mut errors = child.stderr.take().expect("stderr is a pipe");
        let stderr = Arc::new(Mutex::new(String::new()));
        let kept = Arc::clone(&stderr);
        let readers = vec![
            // After the first lines nothing receives them; the pipe is emptied anyway.
            thread::spawn(move || {
                BufReader::new(stdout).lines().map_while(Result::ok).for_each(|line| drop(sender.send(line)));
            }),
            thread::spawn(move || {
                let mut buffer = [0; 4096];
                while let Ok(length @ 1..) = errors.read(&mut buffer) {
                    let text = String::from_utf8_lossy(&buffer[..length]);
                    kept.lock().unwrap_or_else(PoisonError::into_inner).push_str(&text);
                }
            }),
        ];
        Self { child, lines, stderr, readers }
    }

    /// Waits for the line with the addresses of the daemon.
    ///
    /// # Errors
    /// The exit of the process, if it ended instead.
    ///
    /// # Panics
    /// If it neither prints the line nor ends.
    pub fn ready(mut self) -> Result<Daemon, Exit> {
        match self.lines.recv_timeout(READY_WITHIN) {
            Ok(line) => {
                let addresses = line.strip_prefix("listening grpc=").and_then(|rest| rest.split_once(" http="));
                let (grpc, http) = addresses.unwrap_or_else(|| panic!("{line:?} does not name the ports"));
                let (grpc, http) = (grpc.to_owned(), http.to_owned());
                Ok(Daemon { process: self, grpc, http })
            }
            Err(mpsc::RecvTimeoutError::Disconnected) => Err(self.exit()),
            Err(mpsc::RecvTimeoutError::Timeout) => panic!("the daemon is not ready:\n{}", self.stderr()),
        }
    }

    /// Waits for the end.
    ///
    /// # Panics
    /// If it does not end.
    pub fn exit(&mut self) -> Exit {
        let since = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child can be waited for") {
                break status;
            }
            assert!(since.elapsed() < EXIT_WITHIN, "the process does not end:\n{}", self.stderr());
            thread::sleep(POLL);
        };
        for reader in self.readers.drain(..) {
            reader.join().expect("a reader of output does not panic");
        }
        Exit { status, stderr: self.stderr() }
    }

    /// Ends the process as `kill -9` does.
    ///
    /// # Panics
    /// If it does not end.
    pub fn kill(mut self) -> Exit {
        self.signal(Signal::KILL);
        self.exit()
    }

    /// The daemon's stderr so far.
    #[must_use]
    pub fn stderr(&self) -> String {
        self.stderr.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Number of the process.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal to the process; ignored if it has ended.
    pub fn signal(&self, signal: Signal) {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw).expect("a process has a number");
        // The child is not reaped before `exit`, so its number is still valid.
        let _ = kill_process(pid, signal);
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A daemon that is ready.
#[derive(Debug)]
pub struct Daemon {
    process: Process,
    /// Address of its gRPC port.
    pub grpc: String,
    /// Address of its HTTP port.
    pub http: String,
}

impl Daemon {
    /// A client of it.
    ///
    /// # Panics
    /// If its address is invalid.
    #[must_use]
    pub fn client(&self) -> Client {
        Client::new(&self.grpc).expect("the daemon printed an address")
    }

    /// The process.
    #[must_use]
    pub fn process(&self) -> &Process {
        &self.process
    }

    /// Ends it as `kill -9` does.
    pub fn kill(self) -> Exit {
        self.process.kill()
    }

    /// Asks the daemon to stop and waits for that.
    pub fn stop(mut self) -> Exit {
        self.process.signal(Signal::TERM);
        self.process.exit()
    }

    /// Waits for it to end by itself.
    pub fn exit(mut self) -> Exit {
        self.process.exit()
    }

    /// Asks the daemon to stop, and checks that it stopped in order.
    ///
    /// # Panics
    /// If it does not.
    pub fn stop_in_order(self) -> String {
        let exit = self.stop();
        assert_eq!(exit.code(), Some(0), "stopping ended with {exit}");
        exit.stderr
    }
}

/// A free port of loopback outside the range that the system assigns by itself.
///
/// # Panics
/// If all are taken.
#[must_use]
pub fn lasting_port() -> u16 {
    /// Ports used so far: tests of one process must not get the same port while it is free between two daemons.
    static GIVEN: AtomicU16 = AtomicU16::new(0);
    // Tests that run at once are processes of neighbouring numbers, and each needs a few ports.
    let first = 20_000 + u16::try_from(std::process::id() % 750 * 8).unwrap_or(0);
    let free = |port: &u16| std::net::TcpListener::bind(("127.0.0.1", *port)).is_ok();
    let port = std::iter::repeat_with(|| first + GIVEN.fetch_add(1, Ordering::Relaxed)).take(5_000).find(free);
    port.expect("a free port")
}

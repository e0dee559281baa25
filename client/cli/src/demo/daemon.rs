//! The daemon of the demo, in a temporary folder and on free ports.
//!
//! Invariant: neither the process nor the folder outlives [`Daemon`], unless `keep` is called.

use std::{
    env, fs,
    io::{BufRead as _, BufReader, ErrorKind},
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, anyhow, bail};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

const START_TIMEOUT: Duration = Duration::from_secs(30);
const STOP_TIMEOUT: Duration = Duration::from_secs(10);
/// Number of log lines in an error.
const LOG_LINES: usize = 8;

/// A running `tidemapd`.
pub(super) struct Daemon {
    child: Child,
    folder: Option<TempDir>,
    address: String,
    /// `HOST:PORT` of its HTTP port.
    http: String,
}

/// A daemon that continues after the demo.
pub(super) struct KeptDaemon {
    pub(super) pid: u32,
    pub(super) folder: PathBuf,
}

impl Daemon {
    /// Starts `program`, or the `tidemapd` beside this executable, and waits until it is ready.
    pub(super) fn start(program: Option<&Path>) -> anyhow::Result<Self> {
        let program = program.map_or_else(beside, |path| Ok(path.to_path_buf()))?;
        let folder = tempfile::Builder::new().prefix("tidemap-demo-").tempdir().context("no temporary folder")?;
        let log = fs::File::create(log_path(folder.path())).context("no log in the temporary folder")?;
        let child = Command::new(&program)
            .arg("--data-dir")
            .arg(folder.path().join("data"))
            .args(["--listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0"])
            // Settings of another daemon on this machine do not apply.
            .env_clear()
            .envs(env::vars_os().filter(|(key, _)| !key.to_string_lossy().starts_with("TIDEMAP_")))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(log)
            // Ctrl-C reaches the demo only, which then stops the daemon.
            .process_group(0)
            .spawn()
            .map_err(|error| match error.kind() {
                ErrorKind::NotFound => anyhow!("{} does not exist; name the daemon with --daemon", program.display()),
                _ => anyhow!("{} cannot be started: {error}", program.display()),
            })?;
        // From here on, drop stops the process.
        let mut daemon = Self { child, folder: Some(folder), address: String::new(), http: String::new() };
        (daemon.address, daemon.http) = daemon.wait_until_ready()?;
        Ok(daemon)
    }

    /// `HOST:PORT` of its gRPC port.
    pub(super) fn address(&self) -> &str {
        &self.address
    }

    /// `HOST:PORT` of its HTTP port, where the page is.
    pub(super) fn http(&self) -> &str {
        &self.http
    }

    /// Leaves the daemon and its folder.
    pub(super) fn keep(mut self) -> KeptDaemon {
        let folder = self.folder.take().map(TempDir::keep).unwrap_or_default();
        KeptDaemon { pid: self.child.id(), folder }
    }

    fn wait_until_ready(&mut self) -> anyhow::Result<(String, String)> {
        let stdout = self.child.stdout.take().context("the daemon has no stdout")?;
        let (sender, lines) = mpsc::channel();
        // A thread, because reading from a pipe has no time limit. It ends with the pipe.
        thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        let deadline = Instant::now() + START_TIMEOUT;
        loop {
            match lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(line) => {
                    if let Some((grpc, http)) = address(&line, "grpc=").zip(address(&line, "http=")) {
                        return Ok((grpc.to_owned(), http.to_owned()));
                    }
                }
                Err(mpsc::RecvTimeoutError::Disconnected) => bail!("the daemon ended at once{}", self.last_words()),
                Err(mpsc::RecvTimeoutError::Timeout) => {
                    bail!("the daemon was not ready after {} s{}", START_TIMEOUT.as_secs(), self.last_words())
                }
            }
        }
    }

    /// The end of its log, for an error message.
    pub(super) fn last_words(&self) -> String {
        let text = self.folder.as_ref().and_then(|folder| fs::read_to_string(log_path(folder.path())).ok());
        let text = text.unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        if lines.is_empty() {
            return String::new();
        }
        format!("; its log ends with\n  {}", lines[lines.len().saturating_sub(LOG_LINES)..].join("\n  "))
    }

    fn stop(&mut self) {
        let pid = i32::try_from(self.child.id()).ok().and_then(Pid::from_raw);
        if pid.is_some_and(|pid| kill_process(pid, Signal::TERM).is_ok()) {
            let deadline = Instant::now() + STOP_TIMEOUT;
            while Instant::now() < deadline {
                if !matches!(self.child.try_wait(), Ok(None)) {
                    return;
                }
                thread::sleep(Duration::from_millis(10));
            }
        }
        // The daemon does not stop; its folder is removed anyway.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // A kept daemon has no folder here.
        if self.folder.is_some() {
            self.stop();
        }
    }
}

fn log_path(folder: &Path) -> PathBuf {
    folder.join("tidemapd.log")
}

fn beside() -> anyhow::Result<PathBuf> {
    let own = env::current_exe().context("the path of this program is not known; name the daemon with --daemon")?;
    let path = own.with_file_name("tidemapd");
    if !path.is_file() {
        bail!("there is no tidemapd beside {}; build it, or name it with --daemon", own.display());
    }
    Ok(path)
}

/// An address in the line `listening grpc=HOST:PORT http=HOST:PORT`.
fn address<'a>(line: &'a str, port: &str) -> Option<&'a str> {
    line.strip_prefix("listening ")?.split(' ').find_map(|field| field.strip_prefix(port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ready_line_names_the_port() {
        let line = "listening grpc=127.0.0.1:4711 http=127.0.0.1:4712";
        assert_eq!(address(line, "grpc="), Some("127.0.0.1:4711"));
        assert_eq!(address(line, "http="), Some("127.0.0.1:4712"));
        assert_eq!(address("starting", "grpc="), None);
    }

    #[test]
    fn a_missing_daemon_is_named() {
        let error = Daemon::start(Some(Path::new("/nonexistent/tidemapd"))).err().expect("it does not exist");
        assert!(error.to_string().contains("/nonexistent/tidemapd"));
    }

    #[test]
    fn a_program_that_is_no_daemon_is_not_waited_for() {
        let error = Daemon::start(Some(Path::new("/bin/false"))).err().expect("it ends at once");
        assert!(error.to_string().contains("ended at once"), "{error}");
    }
}

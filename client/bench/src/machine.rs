//! CPU times of processes, and the speed of the daemon's disk.
//!
//! Invariant: a value that cannot be read is empty, never guessed.

use std::fs;

use tidemap_client::Client;

use super::{DaemonProcess, Figures};
use tidemap_formats::table::Cell;

/// Unit of the times in `/proc/PID/stat`: always 100 per second on Linux.
const TICKS_PER_SEC: f64 = 100.0;

/// CPU times of this process and of the daemon.
#[derive(Clone, Copy, Debug)]
pub(super) struct CpuTimes {
    feeder: Option<f64>,
    daemon: Option<f64>,
}

impl CpuTimes {
    pub(super) fn now(process: DaemonProcess) -> Self {
        let daemon = process.daemon_pid.or_else(only_daemon);
        Self { feeder: cpu_secs("self"), daemon: daemon.and_then(|pid| cpu_secs(&pid.to_string())) }
    }

    /// CPU time of this process since `earlier`.
    pub(super) fn feeder_since(self, earlier: Self) -> Cell {
        since(self.feeder, earlier.feeder)
    }

    /// CPU time of the daemon since `earlier`.
    pub(super) fn daemon_since(self, earlier: Self) -> Cell {
        since(self.daemon, earlier.daemon)
    }

    /// Peak memory of the daemon since its start.
    pub(super) fn daemon_peak_bytes(process: DaemonProcess) -> Cell {
        let daemon = process.daemon_pid.or_else(only_daemon);
        Cell::maybe(daemon.and_then(peak_bytes))
    }
}

fn since(now: Option<f64>, earlier: Option<f64>) -> Cell {
    Cell::maybe(now.zip(earlier).map(|(now, earlier)| ((now - earlier) * TICKS_PER_SEC).round() / TICKS_PER_SEC))
}

/// User and system time of a process.
fn cpu_secs(pid: &str) -> Option<f64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name is in parentheses and may contain anything; the times are the 12th and 13th fields after it.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut times = fields.split_whitespace().skip(11);
    let mut ticks = || times.next()?.parse::<u64>().ok();
    Some((ticks()? + ticks()?) as f64 / TICKS_PER_SEC)
}

/// Peak resident memory of a process.
fn peak_bytes(pid: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(peak.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

/// The daemon's process, if exactly one runs on this machine.
fn only_daemon() -> Option<u32> {
    let processes = fs::read_dir("/proc").ok()?.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    let mut daemons = processes.filter(|pid: &u32| {
        fs::read_to_string(format!("/proc/{pid}/comm")).is_ok_and(|name| name.trim_end() == "tidemapd")
    });
    let daemon = daemons.next()?;
    daemons.next().is_none().then_some(daemon)
}

/// Latencies of the daemon's disk.
pub(super) async fn disk(client: &Client) -> Result<Figures, tidemap_client::Error> {
    let statistics = client.statistics("").await?;
    let value = |name: &str| Cell::maybe(statistics.iter().find(|statistic| statistic.name == name).map(|s| s.value));
    Ok(vec![("fdatasync_p50_secs", value("fdatasync_p50_secs")), ("fdatasync_p99_secs", value("fdatasync_p99_secs"))])
}

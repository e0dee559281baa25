//! The rules for this program when a daemon runs it to import a recording that was sent to the daemon.
//!
//! Invariant: the program ends when the daemon ends in any way, and uses the processor only when other processes leave
//! it idle.

use std::env;

use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal, setpriority_process};

/// The number of the daemon's process, as the daemon passes it.
const DAEMON: &str = "TIDEMAP_DAEMON";
/// The lowest priority that the system has.
const NICENESS: i32 = 19;

/// Ties this process to the daemon that runs it, if one does. `false`: the daemon is gone already.
pub(crate) fn follow_daemon() -> bool {
    let Ok(daemon) = env::var(DAEMON) else { return true };
    let daemon = daemon.parse().ok().and_then(Pid::from_raw);
    // A system that has neither runs the import all the same.
    let _ = set_parent_process_death_signal(Some(Signal::KILL));
    let _ = setpriority_process(None, NICENESS);
    // This is checked afterwards: a daemon that ended before sends no signal any more.
    getppid() == daemon
}

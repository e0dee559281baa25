//! Status lines on stderr, and progress bars if stderr is a terminal.
//!
//! Invariant: nothing here can fail; if stderr is closed, its lines are lost and the command continues. Names of files
//! and of the wire may be in any line: unprintable characters are escaped.

use std::{
    io::{self, Write as _},
    time::Duration,
};

use indicatif::{ProgressBar, ProgressStyle};

use crate::output::for_terminal;

const TICK: Duration = Duration::from_millis(200);

/// Prints a line to stderr. Text after a line end is set off, so that it does not appear as a line of its own.
pub fn status_line(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{}", for_terminal(line).replace('\n', "\n  "));
}

/// A progress bar; hidden if stderr is not a terminal.
#[derive(Clone, Debug)]
pub struct Bar(ProgressBar);

impl Bar {
    /// Counts the bytes of a file; `total` is `None` if its length is unknown.
    pub fn bytes(total: Option<u64>) -> Self {
        match total {
            Some(total) => {
                Self::with(ProgressBar::new(total), "{bar:32} {bytes}/{total_bytes} {bytes_per_sec} {eta} left  {msg}")
            }
            None => Self::with(ProgressBar::new_spinner(), "{spinner} {bytes} {bytes_per_sec}  {msg}"),
        }
    }

    /// Counts the parts of a job.
    pub fn count(what: &'static str) -> Self {
        let bar = Self::with(ProgressBar::new(0), "{bar:32} {pos}/{len} {msg}");
        bar.0.set_message(what);
        bar
    }

    fn with(bar: ProgressBar, template: &str) -> Self {
        // The templates are constants; an invalid one would leave the plain style.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.enable_steady_tick(TICK);
        Self(bar)
    }

    /// Sets the amount that is done.
    pub fn set(&self, position: u64) {
        self.0.set_position(position);
    }

    /// Sets the amount that is done, and the total.
    pub fn set_of(&self, position: u64, total: u64) {
        self.0.set_length(total);
        self.0.set_position(position);
    }

    /// Prints a line above the bar.
    pub fn status_line(&self, line: &str) {
        self.0.suspend(|| status_line(line));
    }

    /// Removes the bar.
    pub fn clear(&self) {
        self.0.finish_and_clear();
    }
}

//! What is said on stderr while something runs: notices, and bars where stderr is a terminal.
//!
//! Invariant: nothing here can fail; a stderr that is closed loses its notices and stops nothing.

use std::{
    io::{self, Write as _},
    time::Duration,
};

use indicatif::{ProgressBar, ProgressStyle};

const TICK: Duration = Duration::from_millis(200);

/// Says a line.
pub(crate) fn status_line(line: &str) {
    let _ = writeln!(io::stderr().lock(), "{line}");
}

/// A bar, or nothing where stderr is no terminal.
#[derive(Clone, Debug)]
pub(crate) struct Bar(ProgressBar);

impl Bar {
    /// For bytes of a file; of a length that is not known where `total` is absent.
    pub(crate) fn bytes(total: Option<u64>) -> Self {
        match total {
            Some(total) => {
                Self::with(ProgressBar::new(total), "{bar:32} {bytes}/{total_bytes} {bytes_per_sec} {eta} left  {msg}")
            }
            None => Self::with(ProgressBar::new_spinner(), "{spinner} {bytes} {bytes_per_sec}  {msg}"),
        }
    }

    /// For pieces of a job.
    pub(crate) fn count(what: &'static str) -> Self {
        let bar = Self::with(ProgressBar::new(0), "{bar:32} {pos}/{len} {msg}");
        bar.0.set_message(what);
        bar
    }

    fn with(bar: ProgressBar, template: &str) -> Self {
        // The templates are constants; one that did not parse would leave the plain style.
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.enable_steady_tick(TICK);
        Self(bar)
    }

    /// How far it is.
    pub(crate) fn set(&self, position: u64) {
        self.0.set_position(position);
    }

    /// How far it is, of how much.
    pub(crate) fn set_of(&self, position: u64, total: u64) {
        self.0.set_length(total);
        self.0.set_position(position);
    }

    /// Says a line above the bar.
    pub(crate) fn status_line(&self, line: &str) {
        self.0.suspend(|| status_line(line));
    }

    /// Takes the bar away.
    pub(crate) fn clear(&self) {
        self.0.finish_and_clear();
    }
}

//! The beams of scans and clouds: how many there were, and how many had no return.
//!
//! Invariant: each beam of a placed scan or cloud is counted once.

use crate::known::Beam;

/// Counts of the beams of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BeamCounts {
    /// All beams.
    pub all: u64,
    /// Beams from which nothing came back within the range of the sensor.
    pub without_return: u64,
    /// Beams without a reading.
    pub without_reading: u64,
    /// Scans and clouds whose beams have times that cannot be: they are placed at the time of their header.
    pub wrong_times: u64,
}

impl BeamCounts {
    /// Counts a beam, and gives it back.
    pub(super) fn count(&mut self, beam: Beam) -> Beam {
        self.all += 1;
        match beam {
            Beam::Hit => {}
            Beam::NoReturn => self.without_return += 1,
            Beam::NoReading => self.without_reading += 1,
        }
        beam
    }
}

impl BeamCounts {
    /// Sentences for the user about beams that measured nothing, and about wrong times.
    pub fn notices(&self) -> Vec<String> {
        let Self { all, without_return, without_reading, wrong_times } = self;
        let mut notices = Vec::new();
        let none = without_return + without_reading;
        if none > 0 {
            let mut text = format!("{none} of {all} beams have no return, and hit nothing");
            if *without_return > 0 && *without_reading > 0 {
                text += &format!(": {without_return} reach the sensor's limit, {without_reading} have no reading");
            }
            notices.push(text);
        }
        if *wrong_times > 0 {
            notices.push(format!(
                "{wrong_times} messages have times of beams that are not within a second of their stamp: all beams are \
                 placed at the stamp"
            ));
        }
        notices
    }
}

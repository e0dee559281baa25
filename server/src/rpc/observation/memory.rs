//! The memory that a batch takes from when it is handed to the writer until it is durable and applied.
//!
//! Invariant: these are estimates, but never much too small, because they bound the memory that waits for a slow disk.

use tidemap_map::{
    sighting::{PlaceReport, Sighting},
    site::Site,
    traversal::{EdgeFailure, Traversal},
};

use tidemap_proto::convert::{landmarks::place_from_wire, reports::SentReport};

use crate::ingest::protocol::{ObservationBatch, ReportBatch};

/// Memory of a decoded observation, in bytes.
const OBSERVATION_BYTES: usize = 24;
/// Additional memory of a position: its coordinates, and an observation of each axis.
const POSITION_BYTES: usize = 112;
/// Memory of a refused observation with its reason, in bytes, about.
const REFUSED_BYTES: usize = 300;
/// Memory of a name besides its text, in bytes, about.
const NAME_BYTES: usize = 64;

/// Memory of a batch until it is durable, about.
pub(super) fn bytes_of(batch: &ObservationBatch) -> usize {
    let names =
        batch.new_names.iter().map(|name| NAME_BYTES + name.as_ref().map_or(0, |name| name.name.as_str().len()));
    64 + OBSERVATION_BYTES * batch.values.len()
        + POSITION_BYTES * batch.positions.len()
        + REFUSED_BYTES * batch.refused.len()
        + names.sum::<usize>()
}

/// Memory of traversals or sightings until they are durable, about: as they are, as observations with the names of
/// their states, and as failures.
pub(super) fn bytes_of_reports(batch: &ReportBatch, site: &Site) -> usize {
    let of_traversal = |traversal: &Traversal| {
        let texts = 3 * traversal.edge.to_string().len() + 2 * traversal.reason.len();
        size_of::<Traversal>() + 2 * (OBSERVATION_BYTES + NAME_BYTES) + texts + size_of::<EdgeFailure>()
    };
    let of_sighting = |sighting: &Sighting| {
        let at = site.topology().place(&sighting.place).ok().and_then(|place| site.landmarks().at(place));
        let names = sighting.seen.iter().chain(&sighting.out_of_view);
        let texts: usize = names.map(|name| NAME_BYTES + name.as_str().len()).sum();
        texts + at.map_or(0, |known| known.landmarks().len()) * (OBSERVATION_BYTES + 2 * NAME_BYTES)
    };
    let each = |(_, report): &(u64, PlaceReport)| {
        let more = match report {
            PlaceReport::Traversal(_) => 0,
            PlaceReport::Sighting(sighting) => of_sighting(sighting),
            PlaceReport::Task(run) => {
                3 * run.name.to_string().len() + 2 * run.reason.len() + OBSERVATION_BYTES + NAME_BYTES
            }
        };
        size_of::<PlaceReport>() + more + report.traversal().map_or(0, of_traversal)
    };
    64 + batch.reports.iter().map(each).sum::<usize>() + REFUSED_BYTES * batch.refused.len()
}

/// Maximum number of bytes of the reports of one record of the log, which has at most 16 MiB.
pub(super) const REPORT_BYTES_MAX: usize = 4 << 20;

/// Bytes of a report in the log, at most: of a sighting, of an observation of each landmark with its state's name.
pub(super) fn bytes_of_sent(report: &SentReport, site: &Site) -> usize {
    let SentReport::Sighting(sighting) = report else { return 4 * report.text_bytes() + 2 * NAME_BYTES };
    let place = place_from_wire("place", sighting.place.as_ref()).ok();
    let landmarks = place.as_ref().and_then(|(place, _)| {
        let at = site.topology().place(place).ok()?;
        Some((place.landmark_prefix().len(), site.landmarks().at(at)?))
    });
    let each = |prefix: usize, name: &str| prefix + name.len() + NAME_BYTES + OBSERVATION_BYTES;
    let of_landmarks = landmarks.map_or(0, |(prefix, known)| {
        known.landmarks().iter().map(|landmark| each(prefix, landmark.name.as_str())).sum()
    });
    of_landmarks + 4 * report.text_bytes() + 2 * NAME_BYTES
}

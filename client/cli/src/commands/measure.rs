//! The measure of the worth of an observation, as an option.
//!
//! Invariant: the names are the names of [`InformationMeasure`].

use clap::ValueEnum;
use tidemap_client::exploration::InformationMeasure;

/// Measure of the value of an observation.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum MeasureArg {
    /// The gain as published in RA-L 2016: the information about a state after the observation
    Ral,
    /// The information that the observation gives about later ones
    Learn,
    /// The gain plus four times the information about later ones
    Both,
}

impl From<MeasureArg> for InformationMeasure {
    fn from(measure: MeasureArg) -> InformationMeasure {
        match measure {
            MeasureArg::Ral => InformationMeasure::RaL,
            MeasureArg::Learn => InformationMeasure::Learn,
            MeasureArg::Both => InformationMeasure::Both,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_measure_has_its_name() {
        let names = MeasureArg::value_variants().iter().map(|&arg| {
            let value = arg.to_possible_value().expect("none is hidden");
            (value.get_name().to_owned(), InformationMeasure::from(arg).name())
        });
        let names: Vec<_> = names.collect();
        assert_eq!(names.len(), InformationMeasure::ALL.len());
        assert!(names.iter().all(|(arg, name)| arg == name), "{names:?}");
    }
}

//! The distribution of a state over place and time, p(a | x, t), by warped hypertime.
//!
//! Invariant: the model is trained on at least one observation of the state, and only on observations at whose time a
//! position was observed.

use tidemap_map::spec::MapSpec;
use tidemap_model::{
    Sample, StopSignal,
    models::{CannotTrain, FieldReading, HypertimeDistribution, HypertimeField, HypertimeOptions, Moment, Readings},
};

/// A model of a state by place and time.
#[derive(Clone, Debug)]
pub struct PlaceModel {
    field: HypertimeField,
    observations: u64,
}

impl PlaceModel {
    /// Trains a model on the readings of a state and those of the axes of a vector, each ascending by time. If several
    /// readings have the same time, the first ones belong together, then the second ones, and so on.
    ///
    /// # Errors
    /// [`CannotTrain`] if an option is out of range, state and vector have no common time, or the training is stopped.
    pub fn train(
        options: &HypertimeOptions,
        values: &[Sample],
        axes: &[impl AsRef<[Sample]>],
        spec: &MapSpec,
        stop: StopSignal<'_>,
    ) -> Result<Self, CannotTrain> {
        let Some(first) = axes.first().map(AsRef::as_ref) else { return Err(CannotTrain::NoReadings) };
        let mut place = 0;
        let mut placed: Vec<Sample> = Vec::new();
        let mut readings = Vec::new();
        for value in values {
            while first.get(place).is_some_and(|position| position.utc_nanos < value.utc_nanos) {
                place += 1;
            }
            if first.get(place).is_none_or(|position| position.utc_nanos > value.utc_nanos) {
                continue;
            }
            let location = axes.iter().filter_map(|axis| axis.as_ref().get(place)).map(|sample| sample.value);
            readings.push(FieldReading {
                moment: value.moment(),
                location: location.collect(),
                value: vec![value.value],
            });
            placed.push(*value);
            place += 1;
        }
        if readings.is_empty() {
            return Err(CannotTrain::NoReadings);
        }
        let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
        let weights: Vec<f64> = Readings { half_life_secs, ..Readings::new(&placed) }.weights().collect();
        let field = HypertimeField::train_weighted(&readings, &weights, (&spec.periodicities, options), stop)?;
        Ok(Self { field, observations: readings.len() as u64 })
    }

    /// Number of observations with a position.
    pub fn observations(&self) -> u64 {
        self.observations
    }

    /// The distribution at a place, in metres, and a moment; `None` if the distribution is undefined.
    pub fn at(&self, place_m: &[f64], at: Moment) -> Option<HypertimeDistribution> {
        self.field.distribution(at, place_m)
    }
}

#[cfg(test)]
mod tests {
    use tidemap_map::name::MapName;
    use tidemap_model::selector::ModelKind;

    use super::*;

    fn sample(minutes: i64, value: f64) -> Sample {
        Sample { utc_nanos: minutes * 60_000_000_000, offset_secs: 0, value }
    }

    #[test]
    fn only_readings_with_a_position_of_the_same_time_count() {
        let options = ModelKind::HYPERTIME_EM.with_count(2).hypertime_options().expect("options");
        let values: Vec<Sample> = (0..400).map(|i| sample(30 * i, f64::from(u8::from(i % 4 == 0)))).collect();
        let axis = |scale: f64| -> Vec<Sample> {
            (0..200).map(|i| sample(60 * i, scale * f64::from(u8::from(i % 2 == 0)))).collect()
        };
        let spec = MapSpec::new(MapName::new("office").expect("valid"));
        let model =
            PlaceModel::train(&options, &values, &[axis(5.0), axis(1.0)], &spec, StopSignal::NEVER).expect("a model");
        assert_eq!(model.observations(), 200);
        let at = |place: [f64; 2]| model.at(&place, values[0].moment()).expect("a distribution").mean()[0];
        assert!(at([5.0, 1.0]) > 0.8 && at([0.0, 0.0]) < 0.2, "{} and {}", at([5.0, 1.0]), at([0.0, 0.0]));
        let late: Vec<Sample> = (0..20).map(|i| sample(60 * i + 1, 0.0)).collect();
        assert!(PlaceModel::train(&options, &values, &[late.clone(), late], &spec, StopSignal::NEVER).is_err());
    }
}

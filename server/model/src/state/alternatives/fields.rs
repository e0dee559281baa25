//! The stored fields of the alternatives to the spectral model of a state.
//!
//! Invariant: a reader gets back what a writer has written. The constructors of the model check what depends on other
//! fields.

use std::array;

use super::{AlternativesParts, TrainingRecordParts};
use crate::{
    InvalidParts, LocalDay, Periodicities,
    catalogue::TrainedModelParts,
    fields::{FINITE, NOT_NEGATIVE, StoredFields, Visitor},
    models::{CalibratedParts, CountRateParts, HourTableParts, HypertimeMethod, HypertimeParts, PergamParts},
};

impl StoredFields for AlternativesParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        let hours = |numbers: Vec<f64>| HourTableParts::of_numbers(&numbers);
        visitor.converted(Self::HOURS, "hours of a state", &mut self.hours, HourTableParts::numbers, hours)?;
        visitor.list(2, "error sum", NOT_NEGATIVE, &mut self.error_sums)?;
        visitor.integer(3, "last day with errors", &mut self.last_day)?;
        visitor.integer(4, "last learned day", &mut self.learned_day)?;
        visitor.integer(5, "chosen model", &mut self.choice)?;
        visitor.number(6, "weight of the observations", FINITE, &mut self.weight)?;
        visitor.messages(7, "change alarm", array::from_mut(&mut self.alarm))?;
        visitor.integer(8, "pairs of readings", &mut self.succession.pairs)?;
        visitor.number(9, "rate of changes", NOT_NEGATIVE, &mut self.succession.change_rate_sum)?;
        visitor.messages(10, "newest learned reading", &mut self.succession.last)?;
        visitor.integer(11, "supported order", &mut self.supported)?;
        visitor.integer(12, "learned days", &mut self.days)?;
        let mut trained = TrainedFields::of(&self.trained);
        visitor.messages(13, "calibrated model", &mut trained.calibrated)?;
        visitor.messages(14, "trained models", &mut trained.others)?;
        self.trained = trained.records();
        visitor.integer(15, "first day of the routine", &mut self.since)?;
        self.gains.field(16, visitor)?;
        visitor.integer(17, "number of gaps", &mut self.gaps.count)?;
        let kept = self.gaps.kept.iter();
        let mut kept: Vec<u64> = kept.flat_map(|&(number, secs)| [number, u64::from(secs)]).collect();
        visitor.integers(18, GAPS, &mut kept)?;
        if let Some(kept) = visitor.accept(|| kept_gaps(&kept))? {
            self.gaps.kept = kept;
        }
        visitor.number(19, "sum of changes", NOT_NEGATIVE, &mut self.changes)?;
        visitor.messages(20, "ensemble of a probability", &mut self.ensemble)?;
        visitor.messages(21, "ensemble of numbers", &mut self.numbers)
    }
}

impl AlternativesParts {
    /// The tag of the numbers of [`AlternativesParts::hours`], which the index keeps apart from the message.
    pub const HOURS: u32 = 1;

    /// Gives models that were read the periodicities of their map.
    #[must_use]
    pub fn with_periodicities(mut self, periodicities: &Periodicities) -> AlternativesParts {
        for record in &mut self.trained {
            if let TrainedModelParts::Poisson(model) = &mut record.model {
                model.periodicities.clone_from(periodicities);
            }
        }
        self
    }
}

const GAPS: &str = "times between readings";

/// The kept gaps: number and seconds of each in turn.
fn kept_gaps(numbers: &[u64]) -> Result<Vec<(u64, u32)>, InvalidParts> {
    let wrong = |found: u64| InvalidParts::OutOfRange { field: GAPS, found: found as f64 };
    let (gaps, []) = numbers.as_chunks::<2>() else { return Err(wrong(numbers.len() as u64)) };
    let gap = |&[number, secs]: &[u64; 2]| Ok((number, u32::try_from(secs).map_err(|_| wrong(secs))?));
    gaps.iter().map(gap).collect()
}

/// The last training of a model, and the errors of the model since.
#[derive(Clone, Copy, Debug, Default)]
struct Training {
    day: LocalDay,
    error_sum: Option<f64>,
}

impl StoredFields for Training {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "day of a training", &mut self.day)?;
        visitor.number(2, "error sum", NOT_NEGATIVE, &mut self.error_sum)
    }
}

/// A model with its training as a message.
#[derive(Debug, Default)]
struct Trained<M> {
    training: Training,
    model: M,
}

impl<M: StoredFields> StoredFields for Trained<M> {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.messages(1, "training of a model", array::from_mut(&mut self.training))?;
        self.model.fields(visitor)
    }
}

/// The calibrated model, with the fields of its training among its own.
#[derive(Debug, Default)]
struct TrainedCalibrated(Trained<CalibratedParts>);

impl StoredFields for TrainedCalibrated {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        self.0.training.fields(visitor)?;
        self.0.model.fields(visitor)
    }
}

/// The models that were trained on readings; a model is absent before its first training.
#[derive(Debug, Default)]
struct TrainedFields {
    calibrated: Option<TrainedCalibrated>,
    /// Absent if all of them are.
    others: Option<NightlyModels>,
}

/// The models that are one message.
#[derive(Debug, Default)]
struct NightlyModels {
    pergam: Option<Trained<PergamParts>>,
    hypertime_em: Option<Trained<HypertimeParts>>,
    hypertime_km: Option<Trained<HypertimeParts>>,
    poisson: Option<Trained<CountRateParts>>,
}

impl StoredFields for NightlyModels {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.messages(1, "periodic mixture of Gaussians", &mut self.pergam)?;
        visitor.messages(2, "hypertime by expectation-maximisation", &mut self.hypertime_em)?;
        visitor.messages(3, "hypertime by k-means", &mut self.hypertime_km)?;
        visitor.messages(4, "rate of counts", &mut self.poisson)
    }
}

impl TrainedFields {
    fn of(records: &[TrainingRecordParts]) -> TrainedFields {
        let mut fields = TrainedFields::default();
        for TrainingRecordParts { model, day, error_sum } in records {
            let training = Training { day: *day, error_sum: *error_sum };
            let others = &mut fields.others;
            match model.clone() {
                TrainedModelParts::Calibrated(model) => {
                    fields.calibrated = Some(TrainedCalibrated(Trained { training, model }));
                }
                TrainedModelParts::Pergam(model) => {
                    others.get_or_insert_default().pergam = Some(Trained { training, model });
                }
                TrainedModelParts::Hypertime(model) => {
                    let others = others.get_or_insert_default();
                    let place = match model.method() {
                        HypertimeMethod::Em => &mut others.hypertime_em,
                        HypertimeMethod::Km => &mut others.hypertime_km,
                    };
                    *place = Some(Trained { training, model });
                }
                TrainedModelParts::Poisson(model) => {
                    others.get_or_insert_default().poisson = Some(Trained { training, model });
                }
            }
        }
        fields
    }

    fn records(self) -> Vec<TrainingRecordParts> {
        fn record<M>(
            trained: Option<Trained<M>>,
            model: impl FnOnce(M) -> TrainedModelParts,
        ) -> Option<TrainingRecordParts> {
            let Trained { training: Training { day, error_sum }, model: parts } = trained?;
            Some(TrainingRecordParts { model: model(parts), day, error_sum })
        }
        let hypertime = |method| move |model: HypertimeParts| TrainedModelParts::Hypertime(model.with_method(method));
        let NightlyModels { pergam, hypertime_em, hypertime_km, poisson } = self.others.unwrap_or_default();
        let records = [
            record(self.calibrated.map(|calibrated| calibrated.0), TrainedModelParts::Calibrated),
            record(pergam, TrainedModelParts::Pergam),
            record(hypertime_em, hypertime(HypertimeMethod::Em)),
            record(hypertime_km, hypertime(HypertimeMethod::Km)),
            record(poisson, TrainedModelParts::Poisson),
        ];
        records.into_iter().flatten().collect()
    }
}

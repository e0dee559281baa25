//! One choice of a model for states that are parts of one quantity: the labels of a categorical state, or cosine and
//! sine of an angle.
//!
//! Invariant: the sums of errors that are compared are over the same observations, because parts are observed together.

use super::{StateModel, alternatives::CLEARLY_LOWER};
use crate::catalogue::ModelKind;

/// Chooses one model for all parts, by the sum of their errors. `before`: the model that was in force, which stays
/// unless another model has a sum that is lower by 5 %. A model that some part does not have is not chosen.
pub fn choose_together(parts: &mut [&mut StateModel], before: ModelKind) {
    let errors = |part: &StateModel| -> Vec<(ModelKind, f64)> {
        part.alternatives().into_iter().flat_map(|known| known.error_sums()).collect()
    };
    let all: Vec<_> = parts.iter().map(|part| errors(part)).collect();
    let sum_of = |wanted: ModelKind| -> Option<f64> {
        all.iter().map(|sums| Some(sums.iter().find(|(kind, _)| *kind == wanted)?.1)).sum()
    };
    let in_force = sum_of(before).map_or(f64::INFINITY, |sum| CLEARLY_LOWER * sum);
    let sums = all.iter().flatten().take(all.first().map_or(0, Vec::len));
    let sums = sums.filter_map(|(kind, _)| Some((*kind, sum_of(*kind)?)));
    let Some((best, sum)) = sums.min_by(|(_, one), (_, other)| one.total_cmp(other)) else { return };
    let choice = if sum < in_force { best } else { before };
    for part in parts {
        if let Some(alternatives) = &mut part.alternatives {
            alternatives.set_choice(choice);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{OrderCriterion, Periodicities, Sample};

    const HOUR: i64 = 3_600_000_000_000;

    /// A state that is 1 at some hours of the day, learned day by day.
    fn learned(days: i64, is_one: impl Fn(i64, i64) -> bool) -> StateModel {
        let periodicities = Periodicities::default();
        let mut model = StateModel::new(&periodicities);
        for day in 0..days {
            let hours = (0..24).map(|hour| Sample {
                utc_nanos: (day * 24 + hour) * HOUR,
                offset_secs: 0,
                value: f64::from(u8::from(is_one(day, hour))),
            });
            model.update(&periodicities, OrderCriterion::SquaredError, hours.collect());
        }
        model
    }

    #[test]
    fn parts_are_predicted_by_the_model_with_the_least_sum_of_errors() {
        // A block of hours, which a histogram predicts best, and noise, whose hours all have about the same mean.
        let mut block = learned(20, |_, hour| hour == 7);
        let mut noise = learned(20, |day, hour| (day * 31 + hour * 17) % 7 < 3);
        let sum_of = |model: &StateModel, kind: ModelKind| {
            let sums = model.alternatives().into_iter().flat_map(|known| known.error_sums());
            sums.filter(|(known, _)| *known == kind).map(|(_, sum)| sum).sum::<f64>()
        };
        let both = |kind| sum_of(&block, kind) + sum_of(&noise, kind);
        let kinds: Vec<ModelKind> =
            block.alternatives().into_iter().flat_map(|known| known.error_sums()).map(|(kind, _)| kind).collect();
        assert!(kinds.len() > 2, "{kinds:?}");
        let least = kinds.iter().copied().min_by(|one, other| both(*one).total_cmp(&both(*other))).expect("some");
        let worst = kinds.iter().copied().max_by(|one, other| both(*one).total_cmp(&both(*other))).expect("some");
        choose_together(&mut [&mut block, &mut noise], worst);
        assert_eq!((block.choice(), noise.choice()), (least, least), "of {kinds:?}");
        choose_together(&mut [&mut block, &mut noise], least);
        assert_eq!((block.choice(), noise.choice()), (least, least), "the model in force stays");
    }

    #[test]
    fn states_that_have_learned_nothing_keep_their_choice() {
        let [mut one, mut other] = [(); 2].map(|()| StateModel::new(&Periodicities::default()));
        choose_together(&mut [&mut one, &mut other], ModelKind::Mean);
        assert_eq!((one.choice(), one.alternatives().is_none()), (ModelKind::Spectral, true));
    }
}

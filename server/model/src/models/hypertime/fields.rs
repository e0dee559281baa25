//! The stored fields of a hypertime model. Tag 1 belongs to the training, and the method follows from where the model
//! is stored.
//!
//! Invariant: a model of a probability has the numbers of tag 3, any other those of tag 4; never both.

use super::{
    HypertimeAxis, HypertimeCluster, HypertimeFieldParts, HypertimeMethod, HypertimeOddsParts, HypertimeParts,
    HypertimePeriod,
};
use crate::{
    InvalidParts,
    fields::{FINITE, StoredFields, Visitor},
};

impl HypertimeParts {
    /// The method of clustering.
    pub(crate) fn method(&self) -> HypertimeMethod {
        match self {
            HypertimeParts::Probability(odds) => odds.method,
            HypertimeParts::Continuous(field) => field.method,
        }
    }

    /// A copy of the parts with another method.
    pub(crate) fn with_method(self, method: HypertimeMethod) -> HypertimeParts {
        match self {
            HypertimeParts::Probability(odds) => HypertimeParts::Probability(HypertimeOddsParts { method, ..odds }),
            HypertimeParts::Continuous(field) => HypertimeParts::Continuous(HypertimeFieldParts { method, ..field }),
        }
    }
}

impl Default for HypertimeParts {
    /// Parts without data.
    fn default() -> HypertimeParts {
        HypertimeParts::Continuous(HypertimeFieldParts {
            method: HypertimeMethod::Em,
            periods: Vec::new(),
            location: Vec::new(),
            value: Vec::new(),
            clusters: Vec::new(),
        })
    }
}

/// The numbers of both kinds of models.
#[derive(Debug, Default)]
struct Numbers {
    periods: Vec<HypertimePeriod>,
    /// Mean, background, ln of the factors of ones and of zeros.
    odds: Option<[f64; 4]>,
    /// Centre, scale, lowest and highest value.
    axis: Option<[f64; 4]>,
    /// Clusters of readings that are 1, or of values.
    clusters: Vec<HypertimeCluster>,
    zeros: Vec<HypertimeCluster>,
    gain: f64,
}

impl Numbers {
    fn of(parts: &HypertimeParts) -> Numbers {
        match parts {
            HypertimeParts::Probability(odds) => Numbers {
                periods: odds.periods.clone(),
                odds: Some([odds.mean, odds.background, odds.log_ones, odds.log_zeros]),
                clusters: odds.ones.clone(),
                zeros: odds.zeros.clone(),
                gain: odds.gain,
                ..Numbers::default()
            },
            // This is a model of the value only, without a location.
            HypertimeParts::Continuous(field) => Numbers {
                periods: field.periods.clone(),
                axis: field.value.first().map(|axis| [axis.centre, axis.scale, axis.low, axis.high]),
                clusters: field.clusters.clone(),
                ..Numbers::default()
            },
        }
    }

    fn parts(self, method: HypertimeMethod) -> Result<HypertimeParts, InvalidParts> {
        let Numbers { periods, odds, axis, clusters, zeros, gain } = self;
        match (odds, axis) {
            (Some([mean, background, log_ones, log_zeros]), None) => {
                let (ones, zeros) = (clusters, zeros);
                let parts =
                    HypertimeOddsParts { method, periods, mean, background, log_ones, log_zeros, gain, ones, zeros };
                Ok(HypertimeParts::Probability(parts))
            }
            (None, Some([centre, scale, low, high])) => {
                let value = vec![HypertimeAxis { centre, scale, low, high }];
                let parts = HypertimeFieldParts { method, periods, location: Vec::new(), value, clusters };
                Ok(HypertimeParts::Continuous(parts))
            }
            _ => Err(InvalidParts::OutOfRange { field: "scales of a hypertime model", found: f64::NAN }),
        }
    }
}

impl StoredFields for HypertimeParts {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        let mut numbers = Numbers::of(self);
        let mut divisors: Vec<u32> = numbers.periods.iter().map(|period| period.divisor).collect();
        visitor.integers(2, "divisors", &mut divisors)?;
        visitor.list(3, "odds of a hypertime model", FINITE, &mut numbers.odds)?;
        visitor.list(4, "axis of a hypertime model", FINITE, &mut numbers.axis)?;
        visitor.messages(5, "clusters", &mut numbers.clusters)?;
        visitor.messages(6, "clusters of zeros", &mut numbers.zeros)?;
        visitor.number(7, "gain of a hypertime model", FINITE, &mut numbers.gain)?;
        let mut cycles: Vec<i64> = numbers.periods.iter().map(|period| period.cycle_nanos).collect();
        visitor.integers(8, "cycles", &mut cycles)?;
        let method = self.method();
        let read = visitor.accept(|| {
            if cycles.len() != divisors.len() {
                return Err(InvalidParts::OutOfRange { field: "cycles", found: cycles.len() as f64 });
            }
            let period = |(&divisor, &cycle_nanos): (&u32, &i64)| HypertimePeriod { cycle_nanos, divisor };
            numbers.periods = divisors.iter().zip(&cycles).map(period).collect();
            numbers.parts(method)
        })?;
        if let Some(read) = read {
            *self = read;
        }
        Ok(())
    }
}

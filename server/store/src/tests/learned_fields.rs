//! The fields of learned states: what the reader skips and refuses, and models that come back as they were.

use tidemap_model::{
    AlternativesParts, InvalidParts, LocalDay, Periodicities, Sample, TrainedModelParts, TrainingRecordParts,
    fields::{StoredFields, Visitor},
    models::{
        CountRate, HypertimeMethod, HypertimeOddsParts, HypertimeParts, HypertimePeriod, PoissonSpectralParts, Readings,
    },
};

use super::wire::{self, Message};
use crate::record::fields::{read, write};

/// A message with a field of each form.
#[derive(Clone, Debug, Default, PartialEq)]
struct Example {
    count: u32,
    day: Option<LocalDay>,
    single: f32,
    double: Option<f64>,
    days: Vec<LocalDay>,
    pair: [f64; 2],
    inner: Vec<Inner>,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct Inner {
    is_set: bool,
}

impl StoredFields for Example {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "count", &mut self.count)?;
        visitor.integer(2, "day", &mut self.day)?;
        visitor.number(3, "single", 0.0..=1.0, &mut self.single)?;
        visitor.number(4, "double", 0.0..=1.0, &mut self.double)?;
        visitor.integers(5, "days", &mut self.days)?;
        visitor.list(6, "pair", 0.0..=1.0, &mut self.pair)?;
        visitor.messages(7, "inner", &mut self.inner)
    }

    fn finish(&mut self) -> Result<(), InvalidParts> {
        if self.count < 9 { Ok(()) } else { Err(InvalidParts::OutOfRange { field: "count", found: self.count.into() }) }
    }
}

impl StoredFields for Inner {
    fn fields<V: Visitor>(&mut self, visitor: &mut V) -> Result<(), V::Refused> {
        visitor.integer(1, "flag", &mut self.is_set)
    }
}

fn example() -> Example {
    Example {
        count: 5,
        day: Some(LocalDay(0)),
        single: 0.5,
        double: Some(0.0),
        days: vec![LocalDay(-1), LocalDay(300)],
        pair: [0.25, 0.75],
        inner: vec![Inner::default(), Inner { is_set: true }],
    }
}

#[test]
fn fields_are_written_in_the_form_of_protocol_buffers() {
    let bytes = b"\x08\x05\x10\x00\x1D\x00\x00\x00\x3F\x21\0\0\0\0\0\0\0\0\x2A\x03\x01\xD8\x04\
        \x32\x10\0\0\0\0\0\0\xD0\x3F\0\0\0\0\0\0\xE8\x3F\x3A\x00\x3A\x02\x08\x01";
    assert_eq!(write(example()), bytes);
    assert_eq!(read(Example::default(), bytes), Ok(example()));
    let empty = Example::default();
    assert_eq!(write(empty.clone()), Message::default().doubles(6, &[0.0; 2]).0, "what is 0 or absent is not written");
    assert_eq!(read(example(), &write(empty.clone())), Ok(empty), "what is not there becomes 0 or absent");
}

#[test]
fn the_reader_skips_unknown_fields_and_takes_the_later_of_two() {
    let more = Message(write(example())).signed(9, 1).bytes(10, [1, 2]).double(11, 0.5).integer(1, 6);
    assert_eq!(read(Example::default(), &more.0), Ok(Example { count: 6, ..example() }));
}

#[test]
fn fields_of_another_form_or_range_are_refused() {
    let bytes = write(example());
    let refused = |message: Message| read(Example::default(), &message.0).expect_err("it is not valid");
    let with = |tag| Message(wire::changed(&bytes, &[tag], None));
    let form = |field| InvalidParts::Bytes { field };
    let range = |field, found| InvalidParts::OutOfRange { field, found };
    assert_eq!(refused(with(1).double(1, 5.0)), form("count"));
    assert_eq!(refused(with(1).integer(1, 9)), range("count", 9.0));
    assert_eq!(refused(with(3).double(3, 0.5)), form("single"));
    assert_eq!(refused(with(4).double(4, 1.5)), range("double", 1.5));
    assert!(matches!(refused(with(4).double(4, f64::NAN)), InvalidParts::OutOfRange { field: "double", .. }));
    assert_eq!(refused(with(5).bytes(5, [0x80])), form("days"));
    assert_eq!(refused(with(5).signed(5, 3)), form("days"));
    assert_eq!(refused(with(6)), range("pair", 0.0));
    assert_eq!(refused(with(6).doubles(6, &[0.5; 3])), range("pair", 3.0));
    assert_eq!(refused(with(6).bytes(6, [0; 15])), form("pair"));
    assert_eq!(refused(with(6).doubles(6, &[0.5, -1.0])), range("pair", -1.0));
    assert_eq!(refused(with(7).bytes(7, [0x08])), form("inner"));
    assert_eq!(refused(with(7).integer(7, 1)), form("inner"));
    for cut in 1..bytes.len() {
        // A cut between two fields leaves a message without the later ones.
        let Ok(found) = read(Example::default(), &bytes[..cut]) else { continue };
        assert_eq!(found.count, 5);
        assert!(cut >= bytes.len() - 6, "{cut}: the pair must be there");
    }
}

fn come_back(model: TrainedModelParts, periodicities: &Periodicities) {
    let record = TrainingRecordParts { model, day: LocalDay(9), error_sum: Some(0.1) };
    let parts = AlternativesParts {
        hours: tidemap_model::models::HourTable::default().to_parts(),
        error_sums: vec![0.0],
        trained: vec![record],
        ..AlternativesParts::default()
    };
    let again = read(AlternativesParts::default(), &write(parts.clone()));
    assert_eq!(again.map(|read| read.with_periodicities(periodicities)), Ok(parts));
}

#[test]
fn the_rate_of_counts_comes_back_as_it_was() {
    let sample = |slot: i64| Sample {
        utc_nanos: slot * 1_200_000_000_000,
        offset_secs: 3600,
        value: f64::from(u8::from(slot % 72 > 20)) * (slot % 5) as f64,
    };
    let samples: Vec<Sample> = (0..720).map(sample).collect();
    let periodicities = Periodicities::default();
    let model = CountRate::train(Readings::new(&samples), &periodicities).expect("counts").to_parts();
    let PoissonSpectralParts { components, .. } = &model.bins;
    assert!(!components.is_empty());
    come_back(TrainedModelParts::Poisson(model), &periodicities);
}

#[test]
fn hypertime_comes_back_with_its_gain_and_its_periods() {
    const DAY: HypertimePeriod = HypertimePeriod { cycle_nanos: 604_800_000_000_000, divisor: 7 };
    const YEAR: HypertimePeriod = HypertimePeriod { cycle_nanos: 31_556_952_000_000_000, divisor: 1 };
    for (gain, periods) in [(0.75, &[DAY][..]), (1.0, &[DAY, YEAR]), (1.25, &[])] {
        for method in [HypertimeMethod::Em, HypertimeMethod::Km] {
            let model = HypertimeParts::Probability(HypertimeOddsParts {
                method,
                periods: periods.to_vec(),
                mean: 0.25,
                background: 1.0,
                log_ones: 0.5,
                log_zeros: 1.5,
                gain,
                ones: Vec::new(),
                zeros: Vec::new(),
            });
            come_back(TrainedModelParts::Hypertime(model), &Periodicities::default());
        }
    }
}

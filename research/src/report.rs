//! The output of an experiment: the comparison, every prediction, every trial of the tuning, and a picture.
//!
//! Invariant: the table on stdout and `results.csv` are the same.

use std::{
    fs,
    io::{self, BufWriter, Write},
    path::Path,
};

use anyhow::Context as _;
use tidemap_model::{Evaluation, StateKind};

use super::{
    Comparison, ModelResult, Protocol, picture,
    protocol::Predictions,
    score::{SetErrors, lags},
};
use tidemap_formats::table::{Cell, Format, TableWriter, write_rows};

/// Writes the comparison, a row for each lead time and model.
///
/// Columns: model, parameters, mse and error_rate (means over test sets that were not learned), mse of each test set,
/// the difference of mse to the baseline with its interval and p-value, and a verdict: better, worse, or no difference.
/// If the protocol has lead times, also ahead and log_loss (nats); if it tests training data, the error rate of each
/// test set.
pub fn summary<W: Write>(protocol: &Protocol, outcome: &Comparison, format: Format, writer: W) -> io::Result<()> {
    let mut columns = vec!["model".to_owned(), "parameters".to_owned()];
    columns.extend(has_lags(protocol).then(|| "ahead".to_owned()));
    columns.extend(["mse", "error_rate"].map(str::to_owned));
    columns.extend(has_lags(protocol).then(|| "log_loss".to_owned()));
    columns.extend(protocol.test.iter().map(|test| format!("mse_{}", test.label)));
    if tests_learned(protocol) {
        columns.extend(protocol.test.iter().map(|test| format!("error_rate_{}", test.label)));
    }
    columns.extend(["difference", "lower", "upper", "p_value", "verdict"].map(str::to_owned));
    write_rows(format, &columns, outcome.models.iter().map(|model| row(protocol, model)), writer)
}

fn has_lags(protocol: &Protocol) -> bool {
    !protocol.ahead.is_empty()
}

/// Whether a test set is a file of the training data.
fn tests_learned(protocol: &Protocol) -> bool {
    protocol.test.iter().any(|test| test.is_learned)
}

fn row(protocol: &Protocol, model: &ModelResult) -> Vec<Cell> {
    // Error rate and log loss have no meaning for a speed or a count.
    let has_rate = protocol.kind == StateKind::Probability;
    let score = &model.score;
    let unseen = score.has_unseen();
    let mut cells = vec![Cell::Text(model.label.clone()), Cell::Text(model.parameters.clone())];
    cells.extend(model.ahead.map(|ahead| Cell::Text(ahead.to_string())));
    cells.push(Cell::maybe(unseen.then(|| score.mse())));
    cells.push(Cell::maybe((has_rate && unseen).then(|| score.error_rate())));
    if has_lags(protocol) {
        cells.push(Cell::maybe((has_rate && unseen).then(|| score.log_loss())));
    }
    cells.extend(score.sets.iter().map(|set| Cell::from(set.errors.mse())));
    if tests_learned(protocol) {
        let rate = |set: &SetErrors| Cell::maybe(has_rate.then(|| set.errors.error_rate()));
        cells.extend(score.sets.iter().map(rate));
    }
    let mean = model.difference.filter(|_| unseen).map(|difference| difference.mean);
    let test = model.difference.and_then(|difference| difference.test);
    let interval = test.and_then(|test| test.interval);
    cells.push(Cell::maybe(mean));
    cells.push(Cell::maybe(interval.map(|(lower, _)| lower)));
    cells.push(Cell::maybe(interval.map(|(_, upper)| upper)));
    cells.push(Cell::maybe(test.map(|test| test.p_value)));
    cells.push(model.verdict(protocol.significance).map_or(Cell::Empty, Cell::from));
    cells
}

/// Writes the files of an experiment into its folder, which exists.
pub fn write(protocol: &Protocol, outcome: &Comparison, folder: &Path) -> anyhow::Result<()> {
    file(folder, "results.csv", |writer| summary(protocol, outcome, Format::Csv, writer))?;
    file(folder, "pairs.csv", |writer| pairs(protocol, outcome, writer))?;
    if !outcome.folds.is_empty() {
        file(folder, "folds.csv", |writer| trials(protocol, outcome, writer))?;
    }
    if protocol.predictions != Predictions::Off {
        file(folder, "predictions.csv", |writer| predictions(protocol, outcome, writer))?;
    }
    file(folder, "comparison.svg", |writer| writer.write_all(picture::draw(protocol, outcome).as_bytes()))
}

pub(super) fn file(
    folder: &Path,
    name: &str,
    write: impl FnOnce(&mut BufWriter<fs::File>) -> io::Result<()>,
) -> anyhow::Result<()> {
    let path = folder.join(name);
    let written = || -> io::Result<()> {
        let mut writer = BufWriter::new(fs::File::create(&path)?);
        write(&mut writer)?;
        writer.flush()
    };
    written().with_context(|| path.display().to_string())
}

/// The difference of every pair of models at a lead time, with its p-value as it is and corrected for the number of
/// pairs (Holm). The verdict uses the corrected p-value.
fn pairs<W: Write>(protocol: &Protocol, outcome: &Comparison, writer: W) -> io::Result<()> {
    let mut columns = vec!["model", "other"];
    columns.extend(has_lags(protocol).then_some("ahead"));
    columns.extend(["difference", "lower", "upper", "p_value", "corrected_p_value", "verdict"]);
    let label = |index: usize| Cell::Text(outcome.models[index].label.clone());
    let ahead = |index: usize| outcome.models[index].ahead.map(|ahead| Cell::Text(ahead.to_string()));
    let rows = outcome.pairs.iter().map(|pair| {
        let test = pair.difference.test;
        let interval = test.and_then(|test| test.interval);
        let verdict = pair.corrected_p_value.map(|corrected| match pair.difference.mean {
            _ if corrected > protocol.significance => "no difference",
            mean if mean < 0.0 => "better",
            _ => "worse",
        });
        let mut cells = vec![label(pair.model), label(pair.other)];
        cells.extend(ahead(pair.model));
        cells.extend([
            pair.difference.mean.into(),
            Cell::maybe(interval.map(|(lower, _)| lower)),
            Cell::maybe(interval.map(|(_, upper)| upper)),
            Cell::maybe(test.map(|test| test.p_value)),
            Cell::maybe(pair.corrected_p_value),
            verdict.map_or(Cell::Empty, Cell::from),
        ]);
        cells
    });
    write_rows(Format::Csv, &columns, rows, writer)
}

/// The error of every parameter set on every fold.
fn trials<W: Write>(protocol: &Protocol, outcome: &Comparison, writer: W) -> io::Result<()> {
    let columns = ["model", "parameters", "fold", "from", "until", "observations", "mse", "mean_mse", "chosen"];
    let rows = outcome.trials.iter().flat_map(|trial| {
        let model = &protocol.models[trial.model];
        (1_u64..).zip(outcome.folds.iter().zip(&trial.folds)).map(move |(number, (fold, errors))| {
            vec![
                Cell::Text(model.label.clone()),
                model.sets[trial.set].shown().into(),
                number.into(),
                Cell::Time(fold.from_nanos),
                Cell::Time(fold.until_nanos),
                errors.observations.into(),
                Evaluation::mse(errors).into(),
                trial.error.into(),
                Cell::Flag(trial.is_chosen),
            ]
        })
    });
    write_rows(Format::Csv, &columns, rows, writer)
}

/// The predictions and the observed values, by test set, by time, by state, by lead time.
fn predictions<W: Write>(protocol: &Protocol, outcome: &Comparison, writer: W) -> io::Result<()> {
    let mut columns = ["time", "state", "value"].map(str::to_owned).to_vec();
    columns.extend(has_lags(protocol).then(|| "ahead".to_owned()));
    let of_one_lag = outcome.models.iter().take(protocol.models.len());
    columns.extend(of_one_lag.map(|model| model.label.clone()));
    let mut table = TableWriter::new(Format::Csv, &columns, writer);
    for (set, test) in outcome.data.tests.iter().enumerate() {
        let mut readings: Vec<(i64, usize, usize)> = Vec::new();
        for (state, samples) in test.samples.iter().enumerate() {
            let mut interval = None;
            for (at, sample) in samples.iter().enumerate() {
                if let Predictions::Every { nanos } = protocol.predictions {
                    let own = Some(sample.utc_nanos.div_euclid(nanos));
                    if own == interval {
                        continue;
                    }
                    interval = own;
                }
                readings.push((sample.utc_nanos, state, at));
            }
        }
        readings.sort_unstable();
        for (time, state, at) in readings {
            let value = test.samples[state][at].value;
            for (ahead, models) in lags(protocol).into_iter().zip(outcome.models.chunks(protocol.models.len().max(1))) {
                let mut cells = vec![Cell::Time(time), outcome.data.states[state].as_str().into(), value.into()];
                cells.extend(ahead.map(|ahead| Cell::Text(ahead.to_string())));
                cells.extend(models.iter().map(|model| Cell::from(model.score.predictions[set][state][at])));
                table.row(cells)?;
            }
        }
    }
    table.finish()
}

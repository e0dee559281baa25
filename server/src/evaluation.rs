//! How well the models of a view tell given observations, which are not learned.
//!
//! Invariant: sums only, so that any number of observations needs a fixed amount of memory per state and model.

use std::{collections::HashMap, sync::Arc};

use tidemap_map::{
    event::StateId,
    predict::{ModelKind, ModelSelector},
    view::MapView,
};
use tidemap_model::{Evaluation, Sample};

/// Times whose phasors are held at once.
const TIMES_PER_BLOCK: usize = 1024;

/// Sums of errors per state and model.
#[derive(Debug)]
pub struct Evaluator {
    view: Arc<MapView>,
    /// One per row of a state: kinds without an order of their own are spread over all orders.
    rows: Vec<ModelSelector>,
    states: Vec<StateId>,
    sums: HashMap<StateId, Vec<Evaluation>>,
}

impl Evaluator {
    /// Compares these models. A spectral model without an order stands for the orders 0..=`max_order`.
    #[must_use]
    pub fn new(view: Arc<MapView>, models: Vec<ModelSelector>, max_order: usize) -> Self {
        let mut rows = Vec::new();
        for model in models {
            if model.kind == ModelKind::Spectral && model.order.is_none() {
                rows.extend((0..=max_order).map(|order| ModelSelector { order: Some(order), ..model }));
            } else {
                rows.push(model);
            }
        }
        Self { view, rows, states: Vec::new(), sums: HashMap::new() }
    }

    /// Sums kept for each state.
    #[must_use]
    pub fn sums_per_state(&self) -> usize {
        self.rows.len()
    }

    /// Adds observations, grouped by state; `order` lists the states.
    pub fn add(&mut self, order: &[StateId], by_state: &HashMap<StateId, Vec<Sample>>) {
        for id in order {
            let Some(samples) = by_state.get(id) else { continue };
            let sums = self.sums.entry(*id).or_insert_with(|| {
                self.states.push(*id);
                vec![Evaluation::default(); self.rows.len()]
            });
            for block in samples.chunks(TIMES_PER_BLOCK) {
                let times: Vec<i64> = block.iter().map(|sample| sample.utc_nanos).collect();
                let prepared = self.view.prepare(&times);
                let mut predicted = vec![0.0; block.len()];
                for (row, sum) in self.rows.iter().zip(sums.iter_mut()) {
                    self.view.predict_into(*id, &prepared, *row, &mut predicted);
                    for (sample, &probability) in block.iter().zip(&predicted) {
                        sum.add(probability, sample.value);
                    }
                }
            }
        }
    }

    /// The rows: name of the state, model with its order, sums.
    pub fn rows(&self) -> impl Iterator<Item = (&str, ModelSelector, &Evaluation)> {
        self.states.iter().flat_map(move |id| {
            let name = self.view.info(*id).map_or("", |info| info.name.as_str());
            let sums = self.sums.get(id).map_or(&[][..], Vec::as_slice);
            self.rows.iter().zip(sums).map(move |(row, sum)| {
                let order = Some(row.order_for(self.view.model(*id)));
                let order = order.filter(|_| matches!(row.kind, ModelKind::Auto | ModelKind::Spectral));
                (name, ModelSelector { order, ..*row }, sum)
            })
        })
    }
}

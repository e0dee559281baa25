//! `tidemap predict --where`: a state by place and time.
//!
//! Invariant: rows are in the order of the places, then of the times.

use std::process::ExitCode;

use tidemap_client::queries::{ModelKind, ModelSelector, PlaceQuery};
use tidemap_formats::table::Cell;

use super::{PredictArgs, Session, usage};
use crate::progress::status_line;

/// A vector and where it is.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Place {
    vector: String,
    at_m: Vec<f64>,
}

/// Reads `VECTOR=X,Y[,Z]`.
pub(super) fn place(text: &str) -> Result<Place, String> {
    let wrong = || format!("{text:?} is not a place: use VECTOR=X,Y or VECTOR=X,Y,Z in metres, such as robot=1.5,-2");
    let (vector, at) = text.rsplit_once('=').ok_or_else(wrong)?;
    let at_m: Option<Vec<f64>> = at.split(',').map(|number| number.trim().parse().ok()).collect();
    match at_m {
        Some(at_m) if matches!(at_m.len(), 2 | 3) && !vector.is_empty() => {
            Ok(Place { vector: vector.to_owned(), at_m })
        }
        _ => Err(wrong()),
    }
}

pub(super) async fn run(session: &Session, args: PredictArgs, times: Vec<i64>) -> anyhow::Result<ExitCode> {
    let [state] = args.states.as_slice() else {
        return Err(usage("--where predicts one state: give one name"));
    };
    let vector = args.places[0].vector.clone();
    if let Some(other) = args.places.iter().find(|place| place.vector != vector) {
        return Err(usage(format!("--where names two vectors, {vector} and {}: use a command each", other.vector)));
    }
    // The default of other predictions is the daemon's default here.
    let model = (args.model != ModelSelector::default() || args.model.kind != ModelKind::Auto).then_some(args.model);
    let query = PlaceQuery {
        position_state: vector,
        places_m: args.places.iter().map(|place| place.at_m.clone()).collect(),
        times: times.clone(),
        model,
        interval_level: args.interval,
        density_values: args.density.clone(),
    };
    let found = session.client.predict_at_places(&args.map, state, query).await?;
    let dimensions = args.places[0].at_m.len();
    let axes = ["x", "y", "z"].into_iter().take(dimensions).map(str::to_owned);
    let densities = args.density.iter().map(|value| format!("density_{value}"));
    let columns: Vec<String> = ["time", "state"]
        .map(str::to_owned)
        .into_iter()
        .chain(axes)
        .chain(["expected", "deviation", "lower", "upper"].map(str::to_owned))
        .chain(densities)
        .collect();
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let mut table = session.table(&columns);
    for row in &found.rows {
        let mut cells = vec![Cell::Time(times[row.time]), state.as_str().into()];
        cells.extend(args.places[row.place].at_m.iter().map(|&coordinate| Cell::from(coordinate)));
        cells.extend([row.expected.into(), row.deviation.into()]);
        cells.extend([Cell::maybe(row.interval.map(|(low, _)| low)), Cell::maybe(row.interval.map(|(_, high)| high))]);
        cells.extend(row.densities.iter().map(|&density| Cell::from(density)));
        table.row(cells)?;
    }
    table.finish()?;
    status_line(&format!(
        "from {} of {} observations, those with a position of the same time",
        found.trained_observations, found.observations
    ));
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_a_vector_and_its_coordinates() {
        assert_eq!(place("robot=1.5,-2"), Ok(Place { vector: "robot".to_owned(), at_m: vec![1.5, -2.0] }));
        assert_eq!(place("a=b=0,0,1").map(|place| place.vector), Ok("a=b".to_owned()));
        for wrong in ["", "robot", "robot=", "=1,2", "robot=1", "robot=1,2,3,4", "robot=x,y"] {
            assert!(place(wrong).is_err(), "{wrong}");
        }
    }
}

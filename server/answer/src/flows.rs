//! Flows of people, from the readings of their positions and directions.
//!
//! Invariant: a flow is trained on at least one detection, and only on detections that have both.

use tidemap_map::spec::MapSpec;
use tidemap_model::{
    Sample, StopSignal, direction_rad,
    models::{CannotTrain, FLOW_BINS_MAX, FlowDetection, FlowModel, FlowOptions, FlowRaster},
};

use crate::ModelUnavailable;

/// Edge of a cell if none is given, metres.
const EDGE_M: f64 = 1.0;

/// The raster and the directions of a flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowRequest {
    /// The lower and the upper corner in metres; `None`: the region of the detections.
    pub region_m: Option<[[f64; 2]; 2]>,
    /// Edge of a cell in metres; `None`: the default.
    pub edge_m: Option<f64>,
    /// Number of directions.
    pub directions: usize,
}

/// Trains a flow on the readings of the x and y axes of positions, and of two axes of their motion, each ascending by
/// time. If several readings have the same time, the first ones belong together, then the second ones, and so on.
///
/// # Errors
/// [`ModelUnavailable`] if positions and motion have no common time, nobody moves, nobody is in the region, the raster
/// is too large, or the training is stopped.
pub fn train_flow(
    request: &FlowRequest,
    places: [&[Sample]; 2],
    motions: [&[Sample]; 2],
    spec: &MapSpec,
    stop: StopSignal<'_>,
) -> Result<FlowModel, ModelUnavailable> {
    let Detected { detections, pairs } = detections(places, motions);
    match (detections.is_empty(), pairs) {
        (true, 0) => return Err(ModelUnavailable::NoPlaces),
        (true, _) => return Err(ModelUnavailable::NobodyMoves),
        (false, _) => {}
    }
    let raster = raster(request, &detections)?;
    let half_life_secs = spec.half_life_nanos.map(|nanos| nanos as f64 / 1e9);
    let options = FlowOptions { directions: request.directions, half_life_secs, ..FlowOptions::new(raster) };
    FlowModel::train(&detections, &spec.periodicities, &options, stop).map_err(|error| match error {
        CannotTrain::NoReadings => ModelUnavailable::NoneInRegion { elsewhere: detections.len() },
        error => error.into(),
    })
}

/// Detections with a direction.
struct Detected {
    detections: Vec<FlowDetection>,
    /// Number of detections, including people who stand.
    pairs: usize,
}

/// The positions that have a direction.
fn detections([x, y]: [&[Sample]; 2], [along, across]: [&[Sample]; 2]) -> Detected {
    let mut place = 0;
    let mut found = Detected { detections: Vec::new(), pairs: 0 };
    for (along, across) in along.iter().zip(across) {
        while x.get(place).is_some_and(|position| position.utc_nanos < along.utc_nanos) {
            place += 1;
        }
        let here = x.get(place).zip(y.get(place)).filter(|(x, _)| x.utc_nanos == along.utc_nanos);
        let Some((x, y)) = here else { continue };
        place += 1;
        found.pairs += 1;
        if along.value != 0.0 || across.value != 0.0 {
            let direction_rad = direction_rad([along.value, across.value]);
            found.detections.push(FlowDetection { moment: x.moment(), place_m: [x.value, y.value], direction_rad });
        }
    }
    found
}

/// The raster of a request; by default cells of a metre over all detections, or larger cells.
fn raster(request: &FlowRequest, detections: &[FlowDetection]) -> Result<FlowRaster, ModelUnavailable> {
    let bound = |axis: usize, start: f64, nearer: fn(f64, f64) -> f64| {
        detections.iter().map(|detection| detection.place_m[axis]).fold(start, nearer)
    };
    let (low_m, high_m) = match request.region_m {
        Some([low_m, high_m]) => (low_m, high_m),
        None => {
            let edge = request.edge_m.unwrap_or(EDGE_M);
            // The raster begins at whole cells from the origin, so that the cells stay in place when somebody walks
            // farther.
            let low = [0, 1].map(|axis| (bound(axis, f64::INFINITY, f64::min) / edge).floor() * edge);
            // The upper ends of cells are open.
            (low, [0, 1].map(|axis| bound(axis, f64::NEG_INFINITY, f64::max) + 1e-6 * edge))
        }
    };
    let sides = [0, 1].map(|axis| high_m[axis] - low_m[axis]);
    let counts = |edge: f64| sides.map(|side| (side / edge - 1e-9).ceil().max(1.0));
    let bins = |edge: f64| counts(edge).iter().product::<f64>() * request.directions as f64;
    let max = FLOW_BINS_MAX;
    let mut edge_m = request.edge_m.unwrap_or(EDGE_M);
    while request.edge_m.is_none() && bins(edge_m) > max as f64 {
        edge_m *= 2.0;
    }
    if bins(edge_m) > max as f64 {
        return Err(ModelUnavailable::RasterTooLarge { bins: bins(edge_m), max });
    }
    Ok(FlowRaster { low_m, edge_m, counts: counts(edge_m).map(|count| count as usize) })
}

#[cfg(test)]
mod tests {
    use tidemap_map::name::MapName;

    use super::*;

    fn samples(values: &[(i64, f64)]) -> Vec<Sample> {
        values.iter().map(|&(secs, value)| Sample { utc_nanos: secs * 1_000_000_000, offset_secs: 0, value }).collect()
    }

    const WHOLE: FlowRequest = FlowRequest { region_m: None, edge_m: None, directions: 8 };

    #[test]
    fn positions_and_directions_of_the_same_time_belong_together() {
        let x = samples(&[(1, 1.0), (2, 2.0), (2, 2.5), (3, 3.0), (4, 4.0)]);
        let y = samples(&[(1, 0.0), (2, 0.0), (2, 0.5), (3, 0.0), (4, 0.0)]);
        // There is no pair at time 1, two are at 2, one more motion than positions is at 3, and a person who stands at
        // 4.
        let along = samples(&[(2, 1.0), (2, 0.0), (3, -1.0), (3, 5.0), (4, 0.0)]);
        let across = samples(&[(2, 0.0), (2, 1.0), (3, 0.0), (3, 5.0), (4, 0.0)]);
        let Detected { detections: found, pairs } = detections([&x, &y], [&along, &across]);
        assert_eq!(pairs, 4);
        let places: Vec<([f64; 2], f64)> = found.iter().map(|seen| (seen.place_m, seen.direction_rad)).collect();
        let quarter = std::f64::consts::FRAC_PI_2;
        assert_eq!(places, [([2.0, 0.0], 0.0), ([2.5, 0.5], quarter), ([3.0, 0.0], -2.0 * quarter)]);
    }

    #[test]
    fn the_default_raster_holds_all_and_grows_with_the_region() {
        let x = samples(&[(1, -0.5), (2, 3.0)]);
        let y = samples(&[(1, 0.2), (2, 1.9)]);
        let spec = MapSpec::new(MapName::new("office").expect("valid"));
        let ones = samples(&[(1, 1.0), (2, 1.0)]);
        let train = |request: FlowRequest| {
            train_flow(&request, [&x, &y], [&ones, &ones], &spec, StopSignal::NEVER).map(|model| model.options().raster)
        };
        assert_eq!(train(WHOLE), Ok(FlowRaster { low_m: [-1.0, 0.0], edge_m: 1.0, counts: [5, 2] }));
        let region_m = Some([[-500.0, -500.0], [500.0, 500.0]]);
        let wide = train(FlowRequest { region_m, ..WHOLE }).expect("larger cells");
        assert_eq!((wide.edge_m, wide.counts), (8.0, [125, 125]));
        let fine = FlowRequest { region_m, edge_m: Some(0.5), ..WHOLE };
        assert!(matches!(train(fine), Err(ModelUnavailable::RasterTooLarge { .. })));
        let apart = FlowRequest { region_m: Some([[50.0, 50.0], [60.0, 60.0]]), ..WHOLE };
        assert_eq!(train(apart), Err(ModelUnavailable::NoneInRegion { elsewhere: 2 }));
    }
}

//! `GET /api/v1/maps/NAME/grid.png`: the columns of a grid at a time, north at the top, painted as all pictures are.
//!
//! Invariant: the number of pixels is checked before cells are selected. A column shows its most probable known cell of
//! the heights, as on the page. All of a picture is from one view.

use std::sync::Arc;

use axum::{
    extract::{Path, Request, State},
    http::{HeaderMap, HeaderValue},
    response::Response,
};
use tidemap_grid::{
    index::{CellBox, CellIndex},
    predict::{GridQuestion, TileCells},
    spec::GridSpec,
    view::GridView,
};
use tidemap_map::view::MapView;
use tidemap_model::{
    entropy_bits,
    selector::{ModelKind, ModelSelector},
};
use tidemap_picture::{Canvas, CellPaint, Layer, Legend, Painter, SCALE_MAX, fitting_scale};
use tidemap_rpc::{query::Queries, status::RpcError};

use super::{
    super::{Gateway, PREDICT_GRID},
    Failure, Parameter, Visitor, in_turn,
    parameters::Given,
    time,
};

/// Maximum width and height, pixels.
const SIDE_MAX: i64 = 8192;
/// Maximum number of pixels.
const PIXELS_MAX: i64 = 1 << 24;
/// Heights that are relevant to a robot, metres; the floor and the ceiling are always occupied.
const HEIGHTS_M: (f64, f64) = (0.1, 1.8);

/// The parameters of the address.
pub(in super::super) const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "at",
        description: "The time: RFC 3339, Unix seconds or `now`. Default: now.",
        example: "2025-03-18T10:00:00Z",
    },
    Parameter {
        name: "layer",
        description: "`probability` (the default), `entropy`, `difference` or `seen`, as on the page.",
        example: "probability",
    },
    Parameter {
        name: "than",
        description: "With layer `difference`: the other time. Default: 24 hours before.",
        example: "",
    },
    Parameter {
        name: "z",
        description: "Heights, metres, MIN:MAX. Default: 0.1:1.8, or all if the grid has nothing there.",
        example: "0.1:1.8",
    },
    Parameter { name: "x", description: "Only cells within MIN:MAX, metres along x. Default: all.", example: "" },
    Parameter { name: "y", description: "Only cells within MIN:MAX, metres along y. Default: all.", example: "" },
    Parameter {
        name: "scale",
        description: "Pixels along the side of a cell, 1 to 16, or `fit` for a size that can be read. Default: 1, or \
                      `fit` with a legend.",
        example: "4",
    },
    Parameter {
        name: "legend",
        description: "`true`: a legend and a scale bar below the picture, for people. Default: `false`.",
        example: "true",
    },
];

/// The names of layers in addresses, the layer that each shows, and the model that predicts it.
const LAYERS: [(&str, Layer, ModelKind); 4] = [
    ("probability", Layer::Probability, ModelKind::Auto),
    ("entropy", Layer::Entropy, ModelKind::Auto),
    ("seen", Layer::Probability, ModelKind::Latest),
    ("difference", Layer::Difference, ModelKind::Auto),
];

/// A column that is not known.
const UNKNOWN: u8 = 255;
/// A probability of 1; one byte per column keeps large pictures small.
const FULL: u8 = 254;

/// The byte that encodes a probability.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is clamped")]
fn entry(probability: f32) -> u8 {
    (probability.clamp(0.0, 1.0) * f32::from(FULL)).round() as u8
}

/// The probability that a byte encodes; `None`: not known.
fn probability(entry: u8) -> Option<f64> {
    (entry != UNKNOWN).then(|| f64::from(entry) / f64::from(FULL))
}

/// Columns of cells with their probabilities, rows from south to north.
#[derive(Clone)]
struct PixelColumns {
    region: CellBox,
    cells: Vec<u8>,
}

impl PixelColumns {
    fn empty(region: CellBox) -> Self {
        let [width, height] = sides(&region);
        Self { region, cells: vec![UNKNOWN; usize::try_from(width * height).unwrap_or(0)] }
    }

    /// Adds the columns of a projected tile that are within the region.
    fn add(&mut self, tile: &TileCells, levels: (f32, f32)) {
        let [width, height] = sides(&self.region);
        for (place, prediction) in tile.known_cells(levels) {
            let at = tile.index.cell(place);
            let x = i64::from(at.x) - i64::from(self.region.min.x);
            let y = i64::from(at.y) - i64::from(self.region.min.y);
            if (0..width).contains(&x)
                && (0..height).contains(&y)
                && let Ok(index) = usize::try_from(y * width + x)
                && let (Some(cell), Some(value)) = (self.cells.get_mut(index), prediction.value())
            {
                *cell = entry(value);
            }
        }
    }
}

/// The data from which a picture is painted.
struct Painting {
    layer: Layer,
    /// Probabilities after a free and an occupied reading.
    levels: (f64, f64),
    now: PixelColumns,
    /// The columns of the other time, for a difference.
    before: Option<PixelColumns>,
}

impl Painting {
    /// The columns in their colours, north at the top.
    fn canvas(&self, scale: u32) -> Canvas {
        // The levels are rounded as the columns are, so that a cell that never changes is white or black.
        let level = |level: f64| f64::from(entry(level as f32)) / f64::from(FULL);
        let painter = Painter::new(self.layer, (level(self.levels.0), level(self.levels.1)));
        let [width, _] = sides(&self.now.region);
        let width = usize::try_from(width).unwrap_or(0).max(1);
        let before = self.before.as_ref().unwrap_or(&self.now);
        let rows = self.now.cells.chunks(width).zip(before.cells.chunks(width)).rev();
        let cells = rows.flat_map(|(now, before)| now.iter().zip(before)).map(|(&now, &before)| {
            let known = probability(now).zip(probability(before));
            painter.colour(known.map(|(probability, before)| {
                let value = match self.layer {
                    Layer::Probability => probability,
                    Layer::Entropy => entropy_bits(probability),
                    Layer::Difference => probability - before,
                };
                CellPaint { probability, value }
            }))
        });
        Canvas::of_cells(width, cells, scale)
    }

    /// The picture as a PNG file, with a legend below it if there is one.
    fn png(&self, scale: u32, legend: Option<Legend>) -> Result<Vec<u8>, Failure> {
        let mut canvas = self.canvas(scale);
        if let Some(legend) = legend {
            let rows = Painter::new(self.layer, self.levels).legend();
            canvas = Legend { rows, ..legend }.below(&canvas);
        }
        canvas.png().map_err(|error| Failure::Refused(tonic::Status::internal(error.to_string())))
    }
}

/// Number of columns along x and y.
fn sides(CellBox { min, max }: &CellBox) -> [i64; 2] {
    let side = |min: i32, max: i32| (i64::from(max) - i64::from(min)).max(0);
    [side(min.x, max.x), side(min.y, max.y)]
}

/// The position of cells along an axis.
#[derive(Clone, Copy)]
struct Axis {
    name: &'static str,
    origin_m: f64,
    resolution_m: f64,
    /// The first cell, and the one after the last.
    cells: (i32, i32),
}

impl Axis {
    fn metres(self, cell: i32) -> f64 {
        self.origin_m + f64::from(cell) * self.resolution_m
    }

    /// The cells that a range of metres touches.
    #[allow(clippy::cast_possible_truncation, reason = "a float becomes the nearest i32")]
    fn within(self, range: Option<(f64, f64)>) -> Result<(i32, i32), Failure> {
        let Some((min, max)) = range else { return Ok(self.cells) };
        // A range that ends where a cell begins does not touch it.
        let cell = |metres: f64| (metres - self.origin_m) / self.resolution_m;
        let (first, end) = ((cell(min) + 1e-6).floor() as i32, (cell(max) - 1e-6).ceil() as i32);
        let cells = (first.max(self.cells.0), end.min(self.cells.1));
        if cells.0 < cells.1 {
            return Ok(cells);
        }
        Err(Failure::Invalid(format!(
            "the grid has nothing between {name}={min} and {name}={max}: it goes from {:.2} m to {:.2} m",
            self.metres(self.cells.0),
            self.metres(self.cells.1),
            name = self.name,
        )))
    }

    /// The heights that are shown if the address names none.
    fn usual(self) -> (i32, i32) {
        self.within(Some(HEIGHTS_M)).unwrap_or(self.cells)
    }
}

/// The parameters of an address.
struct Wanted {
    map: String,
    at: i64,
    /// The time that layer `difference` compares with.
    than: Option<i64>,
    layer: Layer,
    model: ModelKind,
    /// Pixels along the side of a cell; none: as many as are necessary for a readable picture.
    scale: Option<u32>,
    has_legend: bool,
    ranges: [Option<(f64, f64)>; 3],
}

impl Wanted {
    fn of(map: String, given: &Given) -> Result<Self, Failure> {
        let layer = given.get("layer").unwrap_or("probability");
        let Some((_, layer, model)) = LAYERS.into_iter().find(|(name, ..)| *name == layer) else {
            let names = LAYERS.map(|(name, ..)| name).join(", ");
            return Err(Failure::Invalid(format!("there is no layer {layer:.40}: the layers are {names}")));
        };
        let has_legend = match given.get("legend") {
            None | Some("false") => false,
            Some("true") => true,
            Some(legend) => return Err(Failure::Invalid(format!("legend={legend:.40} is neither true nor false"))),
        };
        let scale = match given.get("scale") {
            None if has_legend => None,
            None => Some(1),
            Some("fit") => None,
            Some(text) => match text.parse().ok().filter(|scale| (1..=SCALE_MAX).contains(scale)) {
                None => {
                    let right = format!("scale={text:.40} is not a number from 1 to {SCALE_MAX}, nor fit");
                    return Err(Failure::Invalid(right));
                }
                scale => scale,
            },
        };
        let at = time(given.get("at").unwrap_or("now"))?;
        let than = match (given.get("than").map(time).transpose()?, layer) {
            (None, Layer::Difference) => Some(at.saturating_sub(86_400_000_000_000).max(0)),
            (Some(_), layer) if layer != Layer::Difference => {
                return Err(Failure::Invalid("than is the other time of layer=difference".to_owned()));
            }
            (than, _) => than,
        };
        let ranges = [given.range("x")?, given.range("y")?, given.range("z")?];
        Ok(Self { map, at, than, layer, model, scale, has_legend, ranges })
    }

    fn selector(&self) -> ModelSelector {
        ModelSelector { kind: self.model, ..ModelSelector::default() }
    }

    fn question(&self, at: i64, region: CellBox) -> GridQuestion {
        let (selector, region) = (self.selector(), Some(region));
        GridQuestion { utc_nanos: at, selector, region, project: true, ..GridQuestion::default() }
    }

    /// Pixels along the side of a cell of a region.
    fn scale_of(&self, region: &CellBox) -> u32 {
        self.scale.unwrap_or_else(|| {
            let [width, height] = sides(region).map(|side| u32::try_from(side).unwrap_or(u32::MAX));
            fitting_scale(width, height)
        })
    }

    /// The text below a picture, without its colours.
    fn legend(&self, metres_per_pixel: f64) -> Legend {
        let text = tidemap_model::time::format_rfc3339;
        let than = self.than.map_or_else(String::new, |than| format!(", compared with {}", text(than)));
        let caption = format!("{} at {}{than}", self.map, text(self.at));
        Legend { caption, rows: Vec::new(), metres_per_pixel }
    }

    /// The selected part of a grid with these bounds.
    fn region(&self, spec: &GridSpec, bounds: &CellBox) -> Result<CellBox, Failure> {
        let CellBox { min, max } = bounds;
        let axis = |name, along: usize, cells| {
            let axis = Axis { name, origin_m: spec.origin_m[along], resolution_m: spec.resolution_m, cells };
            (axis, self.ranges[along])
        };
        let within = |(axis, range): (Axis, Option<(f64, f64)>)| axis.within(range);
        let x = within(axis("x", 0, (min.x, max.x)))?;
        let y = within(axis("y", 1, (min.y, max.y)))?;
        let z = match axis("z", 2, (min.z, max.z)) {
            (heights, Some(range)) => heights.within(Some(range))?,
            (heights, None) if spec.is_flat => heights.cells,
            (heights, None) => heights.usual(),
        };
        let region = CellBox { min: CellIndex { x: x.0, y: y.0, z: z.0 }, max: CellIndex { x: x.1, y: y.1, z: z.1 } };
        let [width, height] = sides(&region).map(|side| side * i64::from(self.scale_of(&region)));
        if width > SIDE_MAX || height > SIDE_MAX || width * height > PIXELS_MAX {
            return Err(Failure::TooLarge(format!(
                "the picture would have {width} × {height} pixels; at most {SIDE_MAX} along a side and {PIXELS_MAX} in \
                 all: select a part with x=MIN:MAX and y=MIN:MAX, or a smaller scale"
            )));
        }
        Ok(region)
    }
}

/// The data that was found for a picture.
struct Found {
    view: Arc<MapView>,
    spec: GridSpec,
    region: CellBox,
    painting: Painting,
}

/// Predicts the columns of a picture. The outer error is that of the query, the inner one is that of the address.
async fn find(queries: &Queries, wanted: &Wanted) -> Result<Result<Found, Failure>, RpcError> {
    let view = queries.grid_view(&wanted.map, wanted.selector()).await?;
    // The bounds of the grid are selected with all its heights.
    let whole = GridQuestion { utc_nanos: wanted.at, selector: wanted.selector(), ..GridQuestion::default() };
    let bounds = queries.select_cells(&view, whole).await?;
    let Some(grid) = view.grid().filter(|_| bounds.tile_count > 0) else {
        return Ok(Err(Failure::Invalid(format!("the grid of map {} has no scans yet: send some", wanted.map))));
    };
    let spec = grid.spec().clone();
    let region = match wanted.region(&spec, &bounds.region) {
        Ok(region) => region,
        Err(failure) => return Ok(Err(failure)),
    };
    let columns_at = async |at| {
        let question = wanted.question(at, region);
        let selection = queries.select_cells(&view, question).await?;
        let (low, high) = view.grid().map_or((0.0, 1.0), GridView::levels);
        let add = move |columns: &mut PixelColumns, tile: &TileCells| columns.add(tile, (low as f32, high as f32));
        queries.sum_cells(&view, (question, selection), PixelColumns::empty(region), add).await
    };
    let now = columns_at(wanted.at).await?;
    let before = match wanted.than {
        Some(than) => Some(columns_at(than).await?),
        None => None,
    };
    let painting = Painting { layer: wanted.layer, levels: spec.sensor.levels(), now, before };
    Ok(Ok(Found { view, spec, region, painting }))
}

async fn answer(gateway: &Gateway, map: String, request: Request) -> Result<Response, Failure> {
    let visitor = Visitor::of(&request);
    let (head, _) = request.into_parts();
    let wanted = Wanted::of(map, &Given::of(head.uri.query(), PARAMETERS)?)?;
    let work = find(gateway.queries.inner(), &wanted);
    let found = gateway.queries.answer(PREDICT_GRID, (&head.headers, &head.extensions), work).await??;
    let Found { view, spec, region, painting } = found;
    let scale = wanted.scale_of(&region);
    let metres_per_pixel = spec.resolution_m / f64::from(scale);
    let mut facts = HeaderMap::new();
    let corner = |along: usize, cell: i32| spec.origin_m[along] + f64::from(cell) * spec.resolution_m;
    for (name, value) in [
        ("tidemap-time", tidemap_model::time::format_rfc3339(wanted.at)),
        ("tidemap-generation", view.generation().to_string()),
        ("tidemap-metres-per-pixel", metres_per_pixel.to_string()),
        ("tidemap-lower-left-m", format!("{} {}", corner(0, region.min.x), corner(1, region.min.y))),
    ] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            facts.insert(name, value);
        }
    }
    let legend = wanted.has_legend.then(|| wanted.legend(metres_per_pixel));
    let file = in_turn(gateway, move || painting.png(scale, legend)).await?;
    Ok(visitor.answer("image/png", file, facts))
}

/// The response with the picture.
pub(in super::super) async fn grid_png(
    State(gateway): State<Gateway>,
    Path(map): Path<String>,
    request: Request,
) -> Response {
    answer(&gateway, map, request).await.unwrap_or_else(|failure| failure.response())
}

#[cfg(test)]
mod tests {
    use tidemap_grid::{index::TileIndex, mask::Mask};
    use tidemap_picture::palette;

    use super::*;

    const REGION: CellBox = CellBox { min: CellIndex { x: 7, y: 0, z: 0 }, max: CellIndex { x: 10, y: 2, z: 1 } };

    /// The cells (8, 0) free, (9, 0) occupied, (8, 1) with a value, and one outside the region.
    fn columns(value: f32) -> PixelColumns {
        let mut columns = PixelColumns::empty(REGION);
        let mut known = Mask::EMPTY;
        // Row 0: x of 8, 9 and 11; row 1: x of 8.
        [0, 1, 3, 8].into_iter().for_each(|place| known.insert(place));
        let index = TileIndex { x: 1, y: 0, z: 0 };
        let values = vec![0.0, 1.0, 1.0, value];
        let tile = TileCells { index, known, changed: Mask::EMPTY, high: Mask::EMPTY, values, all_values: true };
        columns.add(&tile, (0.0, 1.0));
        columns
    }

    fn painting(layer: Layer, before: Option<f32>) -> Painting {
        Painting { layer, levels: (0.0, 1.0), now: columns(0.25), before: before.map(columns) }
    }

    #[test]
    fn tiles_lie_in_their_columns() {
        assert_eq!(columns(0.25).cells, [UNKNOWN, 0, FULL, UNKNOWN, 64, UNKNOWN]);
        assert_eq!([0.0, 0.5, 1.0, 7.0, -1.0, f32::NAN].map(entry), [0, 127, 254, 254, 0, 0]);
    }

    #[test]
    fn columns_are_painted_with_north_at_the_top() {
        let canvas = painting(Layer::Probability, None).canvas(2);
        assert_eq!(canvas.size(), [6, 4]);
        let at = |x, y| canvas.at([x, y]).expect("a pixel");
        let grey = palette::UNKNOWN;
        assert_eq!([at(0, 3), at(2, 3), at(3, 2), at(5, 2)], [grey, [255; 3], [255; 3], [0; 3]]);
        assert_eq!([at(0, 0), at(2, 1), at(4, 0)], [grey, palette::occupancy(64.0 / 254.0), grey]);
    }

    #[test]
    fn a_difference_is_painted_over_the_walls() {
        let canvas = painting(Layer::Difference, Some(0.75)).canvas(1);
        let at = |x, y| canvas.at([x, y]).expect("a pixel");
        assert_eq!([at(0, 1), at(1, 1)], [palette::UNKNOWN, [255; 3]]);
        assert!(at(2, 1).iter().all(|&band| band < 64), "the wall: {:?}", at(2, 1));
        let [red, _, blue] = at(1, 0);
        assert!(blue > red, "freer is blue: {:?}", at(1, 0));
    }

    #[test]
    fn a_poor_sensor_has_white_floors_and_black_walls() {
        let mut painting = Painting { levels: (0.3, 0.7), ..painting(Layer::Probability, None) };
        painting.now.cells = vec![entry(0.3), entry(0.7), UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN];
        let canvas = painting.canvas(1);
        assert_eq!([[0, 1], [1, 1]].map(|at| canvas.at(at)), [[255; 3], [0; 3]].map(Some));
    }

    #[test]
    fn a_range_takes_the_cells_that_it_touches() {
        let axis = Axis { name: "z", origin_m: -1.0, resolution_m: 0.1, cells: (0, 32) };
        let within = |min, max| axis.within(Some((min, max))).ok();
        assert_eq!(within(0.1, 1.8), Some((11, 28)));
        assert_eq!(within(0.15, 0.16), Some((11, 12)));
        assert_eq!(within(-9.0, 99.0), Some((0, 32)));
        assert_eq!(within(5.0, 6.0), None);
        assert_eq!(axis.usual(), (11, 28));
        assert_eq!(Axis { cells: (0, 2), ..axis }.usual(), (0, 2), "everything, where the usual heights have nothing");
        assert_eq!(axis.within(None).ok(), Some((0, 32)));
    }
}

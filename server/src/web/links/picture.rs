//! `GET /api/v1/maps/NAME/grid.png`: the columns of a grid at a time, one byte a pixel, north at the top.
//!
//! Invariant: the number of pixels is checked before cells are asked for. A column shows its most probable known cell
//! of the heights, as on the page.

use axum::{
    extract::{Path, Request, State},
    http::{HeaderMap, HeaderValue},
    response::Response,
};
use tidemap_grid::{
    index::{CellBox, CellIndex},
    predict::GridQuestion,
    spec::GridSpec,
};
use tidemap_model::selector::{ModelKind, ModelSelector};
use tidemap_picture::{Canvas, Legend, LegendRow, SCALE_MAX, fitting_scale};

use super::{
    super::{Gateway, calls::Calls},
    Failure, Parameter, Visitor, in_turn,
    palette::{FULL, Layer, UNKNOWN, entry},
    parameters::Given,
    time,
};

/// Maximum width and height, pixels.
const SIDE_MAX: i64 = 8192;
/// Maximum number of pixels.
const PIXELS_MAX: i64 = 1 << 24;
/// Cells that were not observed, in a picture with a legend.
const BLANK: [u8; 3] = [255; 3];
/// Heights that matter to a robot, metres; the floor and the ceiling are always occupied.
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

/// Cells of columns with their values, rows from south to north.
struct PixelColumns {
    region: CellBox,
    cells: Vec<u8>,
}

impl PixelColumns {
    fn empty(region: CellBox) -> Self {
        let [width, height] = sides(&region);
        Self { region, cells: vec![UNKNOWN; usize::try_from(width * height).unwrap_or(0)] }
    }

    /// Paints a cell, if it lies within the region.
    fn paint(&mut self, at: CellIndex, value: f32) {
        let [width, height] = sides(&self.region);
        let x = i64::from(at.x) - i64::from(self.region.min.x);
        let y = i64::from(at.y) - i64::from(self.region.min.y);
        if (0..width).contains(&x)
            && (0..height).contains(&y)
            && let Ok(index) = usize::try_from(y * width + x)
            && let Some(cell) = self.cells.get_mut(index)
        {
            *cell = entry(value);
        }
    }

    /// (self - other + 1) / 2 where both are known.
    fn minus(&mut self, other: &Self) {
        for (cell, &before) in self.cells.iter_mut().zip(&other.cells) {
            *cell = match (*cell, before) {
                (UNKNOWN, _) | (_, UNKNOWN) => UNKNOWN,
                (now, before) => ((u16::from(now) + u16::from(FULL) - u16::from(before)) / 2) as u8,
            };
        }
    }

    /// The picture as a PNG file with a legend below it.
    fn framed_png(&self, layer: Layer, scale: u32, legend: &Legend) -> Result<Vec<u8>, Failure> {
        let [width, _] = sides(&self.region);
        let width = usize::try_from(width).unwrap_or(0).max(1);
        let colour = |&cell: &u8| {
            if cell == UNKNOWN { BLANK } else { layer.colour(f64::from(cell) / f64::from(FULL)) }
        };
        let cells = self.cells.chunks(width).rev().flatten().map(colour);
        let framed = legend.below(&Canvas::of_cells(width, cells, scale));
        framed.png().map_err(|error| Failure::from(tonic::Status::internal(error.to_string())))
    }

    /// The picture as a PNG file.
    fn png(&self, layer: Layer, scale: u32) -> Result<Vec<u8>, Failure> {
        let [width, height] = sides(&self.region).map(|side| u32::try_from(side).unwrap_or(0));
        let mut pixels = Vec::with_capacity(self.cells.len() * (scale * scale) as usize);
        for row in self.cells.chunks((width as usize).max(1)).rev() {
            let wide: Vec<u8> = row.iter().flat_map(|&cell| std::iter::repeat_n(cell, scale as usize)).collect();
            for _ in 0..scale {
                pixels.extend_from_slice(&wide);
            }
        }
        let failed = |error: png::EncodingError| Failure::from(tonic::Status::internal(error.to_string()));
        let mut file = Vec::new();
        let mut encoder = png::Encoder::new(&mut file, width * scale, height * scale);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(layer.palette());
        encoder.set_trns([[255; 255].as_slice(), &[0]].concat());
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(&pixels).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(file)
    }
}

/// Number of columns along x and y.
fn sides(CellBox { min, max }: &CellBox) -> [i64; 2] {
    let side = |min: i32, max: i32| (i64::from(max) - i64::from(min)).max(0);
    [side(min.x, max.x), side(min.y, max.y)]
}

/// Where cells lie along an axis.
#[derive(Clone, Copy)]
struct Axis {
    name: &'static str,
    origin_m: f64,
    resolution_m: f64,
    /// The first cell, and the one beyond the last.
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

    /// The heights that are shown if none were asked for.
    fn usual(self) -> (i32, i32) {
        self.within(Some(HEIGHTS_M)).unwrap_or(self.cells)
    }
}

/// What an address asks for.
struct Wanted {
    map: String,
    at: i64,
    /// The time that layer `difference` compares with.
    than: Option<i64>,
    layer: Layer,
    /// Pixels along the side of a cell; none: as many as the picture needs to be read.
    scale: Option<u32>,
    has_legend: bool,
    ranges: [Option<(f64, f64)>; 3],
}

impl Wanted {
    fn of(map: String, given: &Given) -> Result<Self, Failure> {
        let layer = given.get("layer").unwrap_or("probability");
        let Some((_, layer)) = Layer::ALL.into_iter().find(|(name, _)| *name == layer) else {
            let names = Layer::ALL.map(|(name, _)| name).join(", ");
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
        Ok(Self { map, at, than, layer, scale, has_legend, ranges })
    }

    fn question(&self, at: i64, region: Option<CellBox>) -> GridQuestion {
        let kind = if self.layer == Layer::Seen { ModelKind::Latest } else { ModelKind::Auto };
        GridQuestion {
            utc_nanos: at,
            selector: ModelSelector { kind, ..ModelSelector::default() },
            // The bounds of the grid are wanted with all its heights.
            project: region.is_some(),
            region,
            ..GridQuestion::default()
        }
    }

    /// Pixels along the side of a cell of a region.
    fn scale_of(&self, region: &CellBox) -> u32 {
        self.scale.unwrap_or_else(|| {
            let [width, height] = sides(region).map(|side| u32::try_from(side).unwrap_or(u32::MAX));
            fitting_scale(width, height)
        })
    }

    /// What stands below a picture.
    fn legend(&self, metres_per_pixel: f64) -> Legend {
        let text = tidemap_model::time::format_rfc3339;
        let than = self.than.map_or_else(String::new, |than| format!(", compared with {}", text(than)));
        Legend {
            caption: format!("{} at {}{than}", self.map, text(self.at)),
            rows: vec![self.layer.legend(), LegendRow::new(vec![BLANK], "not observed")],
            metres_per_pixel,
        }
    }

    /// The part of a grid with these bounds.
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

/// The columns of a region at a time, and the generation that answered.
async fn columns(calls: &Calls<'_>, wanted: &Wanted, at: i64, region: CellBox) -> Result<(PixelColumns, u64), Failure> {
    let mut columns = PixelColumns::empty(region);
    let question = wanted.question(at, Some(region));
    let header = calls.predict_grid(&question, false, |cell, value| columns.paint(cell, value)).await?;
    Ok((columns, header.generation))
}

async fn answer(gateway: &Gateway, map: String, request: Request) -> Result<Response, Failure> {
    let visitor = Visitor::of(&request);
    let wanted = Wanted::of(map, &Given::of(request.uri().query(), PARAMETERS)?)?;
    let calls = visitor.calls(gateway, &wanted.map);
    let header = calls.predict_grid(&wanted.question(wanted.at, None), true, |_, _| ()).await?;
    let spec = header.spec;
    let Some(bounds) = header.region.filter(|_| header.tiles > 0) else {
        return Err(Failure::Invalid(format!("the grid of map {} has no scans yet: send some", wanted.map)));
    };
    let region = wanted.region(&spec, &bounds)?;
    let (mut now, generation) = columns(&calls, &wanted, wanted.at, region).await?;
    if let Some(than) = wanted.than {
        let (before, _) = columns(&calls, &wanted, than, region).await?;
        now.minus(&before);
    }
    let scale = wanted.scale_of(&region);
    let metres_per_pixel = spec.resolution_m / f64::from(scale);
    let mut facts = HeaderMap::new();
    let corner = |along: usize, cell: i32| spec.origin_m[along] + f64::from(cell) * spec.resolution_m;
    for (name, value) in [
        ("tidemap-time", tidemap_model::time::format_rfc3339(wanted.at)),
        ("tidemap-generation", generation.to_string()),
        ("tidemap-metres-per-pixel", metres_per_pixel.to_string()),
        ("tidemap-lower-left-m", format!("{} {}", corner(0, region.min.x), corner(1, region.min.y))),
    ] {
        if let Ok(value) = HeaderValue::from_str(&value) {
            facts.insert(name, value);
        }
    }
    let legend = wanted.has_legend.then(|| wanted.legend(metres_per_pixel));
    let file = in_turn(gateway, move || match legend {
        Some(legend) => now.framed_png(wanted.layer, scale, &legend),
        None => now.png(wanted.layer, scale),
    })
    .await?;
    Ok(visitor.answer("image/png", file, facts))
}

/// Answers with the picture.
pub(in super::super) async fn grid_png(
    State(gateway): State<Gateway>,
    Path(map): Path<String>,
    request: Request,
) -> Response {
    answer(&gateway, map, request).await.unwrap_or_else(|failure| failure.response())
}

#[cfg(test)]
mod tests {
    use super::*;

    const REGION: CellBox = CellBox { min: CellIndex { x: 7, y: 0, z: 0 }, max: CellIndex { x: 10, y: 2, z: 1 } };

    /// The cells (8, 0) free, (9, 0) occupied, (8, 1) with a value, and one that lies outside.
    fn painted(value: f32) -> PixelColumns {
        let mut columns = PixelColumns::empty(REGION);
        for (x, y, value) in [(8, 0, 0.0), (9, 0, 1.0), (8, 1, value), (11, 1, 1.0)] {
            columns.paint(CellIndex { x, y, z: 0 }, value);
        }
        columns
    }

    #[test]
    fn tiles_are_painted_where_they_lie() {
        let mut columns = painted(0.25);
        assert_eq!(columns.cells, [UNKNOWN, 0, FULL, UNKNOWN, 64, UNKNOWN]);
        columns.minus(&painted(1.0));
        assert_eq!(columns.cells, [UNKNOWN, 127, 127, UNKNOWN, 32, UNKNOWN]);
    }

    #[test]
    fn a_file_is_read_back_pixel_by_pixel() -> Result<(), Box<dyn std::error::Error>> {
        let columns = painted(0.25);
        let Ok(file) = columns.png(Layer::Probability, 2) else { return Err("no file".into()) };
        let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!((frame.width, frame.height, frame.color_type), (6, 4, png::ColorType::Indexed));
        let (top, bottom) = ([UNKNOWN, UNKNOWN, 64, 64, UNKNOWN, UNKNOWN], [UNKNOWN, UNKNOWN, 0, 0, FULL, FULL]);
        assert_eq!(pixels, [top, top, bottom, bottom].concat());
        assert_eq!(
            reader.info().trns.as_deref().map(|alphas| (alphas[0], alphas[254], alphas[255])),
            Some((255, 255, 0))
        );
        Ok(())
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

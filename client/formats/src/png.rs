//! A picture of a map as PNG: a pixel for each cell, or a square of pixels, y upwards.
//!
//! Free cells are white, occupied ones black, unknown ones grey, and probabilities between have a scale of colours.
//!
//! Invariant: the colours come from [`tidemap_picture::Painter`]; the file has no metadata such as time or name.

use tidemap_picture::{
    Canvas, CanvasError, CellPaint, Colour, LETTER_HEIGHT, Layer, Legend, LegendRow, Painter, fitting_scale,
    palette::occupancy, text_width,
};

use super::{CELLS_MAX, MapPicture, PictureError, PictureValue, picture::same_size};

/// Pixels between pictures that stand beside each other, and around their titles.
const GAP: u32 = 8;
const PAPER: Colour = [255; 3];
const INK: Colour = [17; 3];

impl From<CanvasError> for PictureError {
    fn from(error: CanvasError) -> Self {
        Self::Encode(error.to_string())
    }
}

/// The picture as a PNG file; a cell has `scale` pixels along each side, at least 1.
///
/// # Errors
/// The picture is invalid, or has more pixels than a file takes.
pub fn write(picture: &MapPicture, scale: u32) -> Result<Vec<u8>, PictureError> {
    Ok(canvas(picture, scale)?.png()?)
}

/// The picture for people: with a legend and a scale bar below it. `scale`: as in [`write`]; none: a scale that makes
/// it readable. `caption`: a text about its content.
///
/// # Errors
/// The errors of [`write`].
pub fn write_for_people(picture: &MapPicture, scale: Option<u32>, caption: &str) -> Result<Vec<u8>, PictureError> {
    let [width, height, _] = picture.size_cells;
    let scale = scale.unwrap_or_else(|| fitting_scale(width, height));
    let drawn = canvas(picture, scale)?;
    let (caption, rows) = (caption.to_owned(), legend_rows(picture));
    let legend = Legend { caption, rows, metres_per_pixel: picture.resolution_m / f64::from(scale) };
    Ok(legend.below(&drawn).png()?)
}

/// Pictures of one map at several times beside each other, each below its title, with one legend; if there are two,
/// also the difference, the second minus the first. `scale` and `caption`: as in [`write_for_people`].
///
/// # Errors
/// The errors of [`write`], or the sizes of the pictures differ.
pub fn write_compared(
    panels: &[(String, MapPicture)],
    scale: Option<u32>,
    caption: &str,
) -> Result<Vec<u8>, PictureError> {
    let first = same_size(panels)?;
    let [width, height, _] = first.size_cells;
    let pair = if let [(_, before), (_, after)] = panels { Some((before, after)) } else { None };
    let count = u32::try_from(panels.len()).unwrap_or(u32::MAX).saturating_add(u32::from(pair.is_some()));
    // The number of columns that makes the longer side of the picture shortest, and two at least.
    let longer = |columns: u32| (width.saturating_mul(columns)).max(height.saturating_mul(count.div_ceil(columns)));
    let columns = (2..=count).rev().min_by_key(|&columns| longer(columns)).unwrap_or(1);
    let scale = scale.unwrap_or_else(|| {
        fitting_scale(width.saturating_mul(columns), height.saturating_mul(count.div_ceil(columns)))
    });
    let pixels = first.cells.len() as u128 * u128::from(scale).pow(2) * u128::from(count);
    if pixels > u128::from(CELLS_MAX) {
        return Err(PictureError::TooLarge { found: pixels });
    }
    let mut drawn = Vec::new();
    for (title, picture) in panels {
        drawn.push((title.as_str(), canvas(picture, scale)?));
    }
    let mut rows = legend_rows(first);
    if let Some((before, after)) = pair {
        let painter = Painter::new(Layer::Difference, first.levels);
        let cells = before.rows_from_top().flatten().zip(after.rows_from_top().flatten()).map(|(before, after)| {
            let known = after.probability().zip(before.difference(*after));
            painter.colour(known.map(|(after, value)| CellPaint { probability: after.into(), value: value.into() }))
        });
        drawn.push(("second minus first", Canvas::of_cells(width as usize, cells, scale)));
        // The rows already contain the colour of unknown cells.
        let differences = painter.legend();
        let known = differences.len().saturating_sub(1);
        rows.splice(rows.len().saturating_sub(1)..rows.len().saturating_sub(1), differences.into_iter().take(known));
    }
    let legend = Legend { caption: caption.to_owned(), rows, metres_per_pixel: first.resolution_m / f64::from(scale) };
    Ok(legend.below(&side_by_side(&drawn, columns)).png()?)
}

/// Canvases of one size in rows, each below its title.
fn side_by_side(panels: &[(&str, Canvas)], columns: u32) -> Canvas {
    let [width, height] = panels.first().map_or([0; 2], |(_, canvas)| canvas.size());
    let widest = panels.iter().map(|(title, _)| text_width(title)).max().unwrap_or(0).max(width);
    let (across, down) = (widest + GAP, GAP + LETTER_HEIGHT + GAP + height);
    let rows = u32::try_from(panels.len()).unwrap_or(u32::MAX).div_ceil(columns.max(1));
    let mut sheet = Canvas::new(columns * across + GAP, rows * down + GAP, PAPER);
    for ((title, panel), at) in panels.iter().zip(0..) {
        let [x, y] = [GAP + at % columns * across, GAP + at / columns * down];
        sheet.text([x, y], title, INK);
        sheet.put([x, y + LETTER_HEIGHT + GAP], panel);
    }
    sheet
}

/// The legend of the colours of a picture.
fn legend_rows(picture: &MapPicture) -> Vec<LegendRow> {
    let mut rows = picture.painter().legend();
    if let (PictureValue::AtLeast(_), Some(first)) = (picture.value, rows.first_mut()) {
        *first = LegendRow::new([0.0, 1.0].map(occupancy).to_vec(), &format!("0, 1: {}", picture.value.text()));
    }
    rows
}

/// The cells in their colours.
fn canvas(picture: &MapPicture, scale: u32) -> Result<Canvas, PictureError> {
    picture.check_flat()?;
    let scale = scale.max(1);
    let found = picture.cells.len() as u128 * u128::from(scale).pow(2);
    if found > u128::from(CELLS_MAX) {
        return Err(PictureError::TooLarge { found });
    }
    let cells = picture.rows_from_top().flatten().map(|&cell| picture.colour(cell));
    Ok(Canvas::of_cells(picture.size_cells[0] as usize, cells, scale))
}

#[cfg(test)]
mod tests {
    use tidemap_picture::palette::UNKNOWN;

    use super::{super::picture::samples, *};

    const HALF: [u8; 3] = [239, 84, 60];

    #[test]
    fn a_picture_is_read_back_pixel_by_pixel() -> Result<(), Box<dyn std::error::Error>> {
        let file = write(&samples::flat(), 1)?;
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!((frame.width, frame.height), (3, 2));
        assert_eq!((frame.color_type, frame.bit_depth), (::png::ColorType::Rgb, ::png::BitDepth::Eight));
        // The upper row is the one with the larger y, which is the second of the picture.
        let upper = [[255; 3], HALF, [0; 3]];
        let lower = [[255; 3], [0; 3], UNKNOWN];
        assert_eq!(pixels, [upper, lower].concat().concat());
        Ok(())
    }

    #[test]
    fn a_cell_may_have_several_pixels() -> Result<(), Box<dyn std::error::Error>> {
        let file = write(&samples::flat(), 2)?;
        let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
        let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
        let frame = reader.next_frame(&mut pixels)?;
        assert_eq!((frame.width, frame.height), (6, 4));
        assert_eq!(pixels[..6], [255; 6], "the first cell twice");
        assert_eq!(pixels[6..12], [HALF, HALF].concat(), "the second cell twice");
        assert_eq!(pixels[..18], pixels[18..36], "the first row twice");
        assert!(matches!(write(&samples::flat(), 9_000), Err(PictureError::TooLarge { .. })));
        Ok(())
    }

    #[test]
    fn people_get_larger_cells_and_a_legend() -> Result<(), Box<dyn std::error::Error>> {
        let mut sizes = Vec::new();
        for value in [PictureValue::Probability, PictureValue::Entropy, PictureValue::AtLeast(0.5)] {
            let picture = MapPicture { value, ..samples::flat() };
            let file = write_for_people(&picture, None, "office, Tue 10:00")?;
            let mut reader = ::png::Decoder::new(std::io::Cursor::new(&file)).read_info()?;
            let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
            let frame = reader.next_frame(&mut pixels)?;
            assert!(frame.width > 3 * 16 && frame.height > 2 * 16 + 80, "{frame:?}");
            let pixel = |x: usize, y: usize| &pixels[(y * frame.width as usize + x) * 3..][..3];
            assert_eq!((pixel(15, 15), pixel(47, 31)), (&[255; 3][..], &UNKNOWN[..]));
            assert_eq!(pixel(16, 0), picture.colour(picture.cells[4]), "{value:?}");
            sizes.push(frame.height);
        }
        assert!(sizes[0] < sizes[1], "entropy has a row for the walls beneath it: {sizes:?}");
        Ok(())
    }

    #[test]
    fn entropy_is_painted_over_the_walls() {
        let picture = MapPicture { value: PictureValue::Entropy, ..samples::flat() };
        let [free, wall, _, _, open, _] = picture.cells[..] else { unreachable!("six cells") };
        assert_eq!(picture.colour(free), [255; 3]);
        assert!(picture.colour(wall).iter().all(|&band| band < 64), "{:?}", picture.colour(wall));
        let [red, _, blue] = picture.colour(open);
        assert!(blue > red + 100, "an open cell is blue-green: {:?}", picture.colour(open));
    }

    #[test]
    fn layers_are_refused() {
        let mut picture = samples::flat();
        picture.size_cells = [3, 1, 2];
        assert_eq!(write(&picture, 1), Err(PictureError::Layers(2)));
    }

    #[test]
    fn two_times_stand_beside_each_other_with_their_difference() -> Result<(), Box<dyn std::error::Error>> {
        let before = samples::flat();
        let mut after = samples::flat();
        after.cells[3] = super::super::PictureCell::Changing { probability: 1.0 };
        let panels = [("ten".to_owned(), before), ("noon".to_owned(), after)];
        let read = |file: &[u8]| -> Result<([u32; 2], Vec<u8>), Box<dyn std::error::Error>> {
            let mut reader = ::png::Decoder::new(std::io::Cursor::new(file)).read_info()?;
            let mut pixels = vec![0; reader.output_buffer_size().ok_or("too large")?];
            let frame = reader.next_frame(&mut pixels)?;
            Ok(([frame.width, frame.height], pixels))
        };
        let ([width, height], pixels) = read(&write_compared(&panels, Some(16), "office")?)?;
        let count = |colour: Colour| pixels.chunks_exact(3).filter(|pixel| *pixel == colour).count();
        // The cell that became occupied is orange in the difference only, as the end of its legend.
        let orange =
            Painter::new(Layer::Difference, (0.0, 1.0)).colour(Some(CellPaint { probability: 1.0, value: 1.0 }));
        assert!((16 * 16..16 * 16 + 200).contains(&count(orange)), "{}", count(orange));
        assert!(count(UNKNOWN) >= 3 * 16 * 16, "unknown in all three");
        let ([_, three], _) = read(&write_compared(&[&panels[..], &panels[..1]].concat(), Some(16), "office")?)?;
        assert!(width > 3 * 16 && height > three, "only two times have a difference with a legend");
        assert!(write_compared(&[], None, "office").is_err());
        Ok(())
    }
}

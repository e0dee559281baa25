//! A tour over a predicted map as SVG: cells as in the pictures of maps, goals as numbered discs.
//!
//! The line is the path of the robot around obstacles.
//! Invariant: the same tour and map give the same bytes; y points upwards as in the map.

use crate::{
    MapPicture, PictureError,
    svg::{Svg, hex},
};

/// Pixels of the longer side.
const SIDE: f64 = 900.0;
/// Radius of a goal in pixels.
const DISC: f64 = 10.0;

/// Draws the cells, then the path, the start and the goals, all in metres of the map's frame.
pub fn write(
    picture: &MapPicture,
    start: Option<[f64; 2]>,
    goals: &[[f64; 2]],
    path: &[[f64; 2]],
) -> Result<String, PictureError> {
    picture.check_flat()?;
    let [width, height, _] = picture.size_cells.map(f64::from);
    let scale = SIDE / width.max(height);
    let place = |[x, y]: [f64; 2]| {
        let along = |at: f64, axis: usize| (at - picture.origin_m[axis]) / picture.resolution_m;
        [along(x, 0) * scale, (height - along(y, 1)) * scale]
    };
    let mut svg = Svg::with_attributes([width * scale, height * scale], 12.0, "shape-rendering=\"crispEdges\"");
    for (row, cells) in picture.rows_from_top().enumerate() {
        let mut column = 0;
        // Neighbours of one colour are one rectangle.
        for run in cells.chunk_by(|one, next| picture.colour(*one) == picture.colour(*next)) {
            if let Some(&cell) = run.first() {
                let area = [column as f64 * scale, row as f64 * scale, run.len() as f64 * scale, scale];
                svg.rectangle(area, &format!("fill=\"{}\"", hex(picture.colour(cell))));
            }
            column += run.len();
        }
    }
    let dashed = "stroke=\"#1a4fa3\" stroke-width=\"2\" stroke-dasharray=\"6 4\" shape-rendering=\"auto\"";
    svg.polyline(path.iter().copied().map(place).collect::<Vec<_>>(), dashed);
    if let Some([x, y]) = start.map(place) {
        let area = [x - DISC, y - DISC, 2.0 * DISC, 2.0 * DISC];
        svg.rectangle(area, "fill=\"#0a7a3c\" stroke=\"#ffffff\"");
    }
    for (number, [x, y]) in (1..).zip(goals.iter().copied().map(place)) {
        svg.circle([x, y], DISC, "fill=\"#1a4fa3\" stroke=\"#ffffff\" shape-rendering=\"auto\"");
        svg.text([x, y + 4.0], &number.to_string(), "text-anchor=\"middle\" fill=\"#ffffff\"");
    }
    Ok(svg.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::samples;

    #[test]
    fn goals_are_numbered_and_y_points_upwards() -> Result<(), PictureError> {
        let picture = samples::flat();
        let [x, y, _] = picture.origin_m;
        let side = picture.resolution_m;
        let low = [x + 0.5 * side, y + 0.5 * side];
        let high = [x + 2.5 * side, y + 1.5 * side];
        let corner = [low[0], high[1]];
        let svg = write(&picture, Some(low), &[high, low], &[low, corner, high])?;
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains(">1</text>") && svg.contains(">2</text>"));
        // 3 cells of 300 pixels: the first goal is in the upper row, the start in the lower one.
        assert!(svg.contains("points=\"150.0,450.0 150.0,150.0 750.0,150.0\""), "{svg}");
        Ok(())
    }
}

//! A tour over a predicted map as SVG: cells as in the pictures of maps, goals as numbered discs.
//!
//! The lines between goals show the order of the goals, not the robot's path around obstacles.
//! Invariant: the same tour and map give the same bytes; y points upwards as in the map.

use crate::{
    MapPicture, PictureError,
    svg::{Svg, hex},
};

/// Pixels of the longer side.
const SIDE: f64 = 900.0;
/// Radius of a goal in pixels.
const DISC: f64 = 10.0;

/// Draws the cells, then the path from the start through the goals, and back to the start unless `is_open`.
pub fn write(
    picture: &MapPicture,
    start: Option<[f64; 2]>,
    goals: &[[f64; 2]],
    is_open: bool,
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
    let mut path: Vec<[f64; 2]> = start.into_iter().chain(goals.iter().copied()).map(place).collect();
    if !is_open && start.is_some() && path.len() > 1 {
        path.extend(path.first().copied());
    }
    let dashed = "stroke=\"#1a4fa3\" stroke-width=\"2\" stroke-dasharray=\"6 4\" shape-rendering=\"auto\"";
    svg.polyline(path, dashed);
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
        let svg = write(&picture, Some(low), &[high, low], false)?;
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains(">1</text>") && svg.contains(">2</text>"));
        // 3 cells of 300 pixels: the first goal is in the upper row, the start in the lower one; the path returns.
        assert!(svg.contains("points=\"150.0,450.0 750.0,150.0 150.0,450.0 150.0,450.0\""), "{svg}");
        let open = write(&picture, Some(low), &[high], true)?;
        assert!(open.contains("points=\"150.0,450.0 750.0,150.0\""), "{open}");
        Ok(())
    }
}

//! A tour over a predicted map, as SVG for people: cells as in the pictures of maps, goals as numbered discs.
//!
//! The lines between goals say in which order they are driven to, not which way the robot takes around obstacles.
//! Invariant: the same tour and map give the same bytes; y points upwards as in the map.

use std::fmt::Write as _;

use super::{MapPicture, PictureError, colour::colour};

/// Pixels of the longer side.
const SIDE: f64 = 900.0;
/// Pixels of a goal's radius.
const DISC: f64 = 10.0;

/// Draws the cells, then the way from the start through the goals, and back unless it is open.
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
    let (w, h) = (width * scale, height * scale);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w:.0}\" height=\"{h:.0}\" viewBox=\"0 0 {w:.1} {h:.1}\" \
         font-family=\"sans-serif\" font-size=\"12\" shape-rendering=\"crispEdges\">\n"
    );
    for (row, cells) in picture.rows_from_top().enumerate() {
        let mut column = 0;
        // Neighbours of one colour are one rectangle.
        for run in cells.chunk_by(|one, next| colour(*one) == colour(*next)) {
            if let Some(&cell) = run.first() {
                let [r, g, b] = colour(cell);
                let (x, y, length) = (column as f64 * scale, row as f64 * scale, run.len() as f64 * scale);
                // Writing to a string cannot fail.
                let _ = writeln!(
                    svg,
                    "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{length:.2}\" height=\"{scale:.2}\" \
                     fill=\"#{r:02x}{g:02x}{b:02x}\"/>"
                );
            }
            column += run.len();
        }
    }
    let mut way: Vec<[f64; 2]> = start.into_iter().chain(goals.iter().copied()).map(place).collect();
    if !is_open && start.is_some() && way.len() > 1 {
        way.extend(way.first().copied());
    }
    let points: String = way.iter().map(|[x, y]| format!("{x:.1},{y:.1} ")).collect();
    let _ = writeln!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#1a4fa3\" stroke-width=\"2\" stroke-dasharray=\"6 4\" \
         shape-rendering=\"auto\"/>",
        points.trim_end()
    );
    if let Some([x, y]) = start.map(place) {
        let (x, y, side) = (x - DISC, y - DISC, 2.0 * DISC);
        let _ = writeln!(
            svg,
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{side}\" height=\"{side}\" fill=\"#0a7a3c\" stroke=\"#ffffff\"/>"
        );
    }
    for (number, [x, y]) in (1..).zip(goals.iter().copied().map(place)) {
        let _ = writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{DISC}\" fill=\"#1a4fa3\" stroke=\"#ffffff\" \
             shape-rendering=\"auto\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill=\"#ffffff\">{number}</text>",
            y + 4.0
        );
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::{super::picture::samples, *};

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
        // 3 cells of 300 pixels: the first goal is in the upper row, the start in the lower one; the way returns.
        assert!(svg.contains("points=\"150.0,450.0 750.0,150.0 150.0,450.0 150.0,450.0\""), "{svg}");
        let open = write(&picture, Some(low), &[high], true)?;
        assert!(open.contains("points=\"150.0,450.0 750.0,150.0\""), "{open}");
        Ok(())
    }
}

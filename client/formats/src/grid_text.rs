//! A map as text for a terminal: a character for a block of cells, with a legend.
//!
//! Invariant: at most 100 columns wide. A character shows the highest value of its block, so that thin walls stay; a
//! block without known cells is blank.

use std::fmt::Write as _;

use super::{
    MapPicture, PictureError,
    drawing::{SHADES, text_bar},
};

/// Maximum number of characters of a row.
const COLUMNS: usize = 96;
/// Maximum number of rows.
const ROWS: usize = 60;

/// The picture below a title, as lines of text.
///
/// # Errors
/// The picture is invalid, or has several layers.
pub fn write(picture: &MapPicture, title: &str) -> Result<String, PictureError> {
    picture.check_flat()?;
    let [width, height] = [picture.size_cells[0] as usize, picture.size_cells[1] as usize];
    // A character is about twice as high as wide. Cells of a small map have two characters each.
    let times = if width * 2 <= COLUMNS && height <= ROWS { 2 } else { 1 };
    let (across, down) = if times == 2 {
        (1, 1)
    } else {
        let across = width.div_ceil(COLUMNS).max(height.div_ceil(2 * ROWS));
        (across, 2 * across)
    };
    let mut text = format!("{title}\n");
    let rows: Vec<_> = picture.rows_from_top().collect();
    for block in rows.chunks(down) {
        let highest = |left: usize| {
            let cells = block.iter().flat_map(|row| row[left..(left + across).min(width)].iter());
            cells.filter_map(|&cell| picture.value_of(cell)).reduce(f32::max)
        };
        let line: String = (0..width).step_by(across).flat_map(|left| [shade(highest(left))].repeat(times)).collect();
        let _ = writeln!(text, "  {}", line.trim_end());
    }
    let shades: Vec<String> = SHADES.iter().map(ToString::to_string).collect();
    let _ = writeln!(text, "  {}: 0 {} 1; blank: not observed", picture.value.text(), shades.join(" "));
    if let Some(bar) = text_bar(times as f64 / (across as f64 * picture.resolution_m)) {
        let _ = writeln!(text, "  {bar}");
    }
    if across > 1 {
        let _ = writeln!(text, "  a character shows the highest value of {across} x {down} cells");
    } else if down > 1 {
        let _ = writeln!(text, "  a character shows the higher value of 2 cells");
    }
    Ok(text)
}

fn shade(value: Option<f32>) -> char {
    let last = SHADES.len() - 1;
    value.map_or(' ', |value| SHADES[((value.clamp(0.0, 1.0) * last as f32).round() as usize).min(last)])
}

#[cfg(test)]
mod tests {
    use super::{super::picture::samples, *};
    use crate::PictureCell::{Static, Unknown};

    #[test]
    fn a_small_map_has_two_characters_a_cell() -> Result<(), PictureError> {
        let text = write(&samples::flat(), "office")?;
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[..3], ["office", "  ··▒▒██", "  ··██"]);
        assert_eq!(lines[3], "  probability of occupied: 0 · ░ ▒ ▓ █ 1; blank: not observed");
        // Two characters are 5 cm: 20 characters are half a metre.
        assert_eq!(lines[4], format!("  scale: ├{}┤ 0.5 m", "─".repeat(18)));
        Ok(())
    }

    #[test]
    fn a_wall_of_a_large_map_stays() -> Result<(), PictureError> {
        let mut cells = vec![Static { probability: 0.0 }; 1000 * 300];
        (0..300).for_each(|row| cells[row * 1000 + 500] = Static { probability: 1.0 });
        cells[..1000].fill(Unknown);
        let picture = MapPicture { size_cells: [1000, 300, 1], cells, ..samples::flat() };
        let text = write(&picture, "hall")?;
        let rows: Vec<&str> = text.lines().filter(|line| line.contains('·') && !line.contains("blank")).collect();
        assert_eq!(rows.len(), 300_usize.div_ceil(22));
        assert!(rows.iter().all(|row| row.chars().filter(|&shown| shown == '█').count() == 1), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        assert!(text.contains("highest value of 11 x 22 cells"), "{text}");
        Ok(())
    }
}

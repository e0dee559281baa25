//! A map as text for a terminal: a character for a block of cells, with a legend.
//!
//! Invariant: at most 100 columns wide. A character shows the highest value of its block, so that thin walls stay; a
//! block without known cells is blank.

use std::fmt::Write as _;

use super::{
    MapPicture, PictureCell, PictureError,
    drawing::{SHADES, text_bar},
    picture::same_size,
};

/// Maximum number of characters of a row.
const COLUMNS: usize = 96;
/// Maximum number of characters of a row of one of two pictures that stand beside each other.
const PANEL_COLUMNS: usize = 46;
/// Maximum number of rows.
const ROWS: usize = 60;

/// The picture below a title, as lines of text.
///
/// # Errors
/// The picture is invalid, or has several layers.
pub fn write(picture: &MapPicture, title: &str) -> Result<String, PictureError> {
    picture.check_flat()?;
    let values = values(picture);
    let blocks = Blocks::new(picture, COLUMNS);
    let mut text = format!("{title}\n");
    blocks.lines(&values, shade).iter().for_each(|line| text += &format!("  {}\n", line.trim_end()));
    text += &values_legend(picture);
    text += &blocks.legend(picture);
    Ok(text)
}

/// Pictures of one map at several times, each below its title, two beside each other; if there are two, also the
/// difference, the second minus the first.
///
/// # Errors
/// A picture is invalid, has several layers, or another size than the first.
pub fn write_compared(panels: &[(String, MapPicture)], title: &str) -> Result<String, PictureError> {
    let first = same_size(panels)?;
    let blocks = Blocks::new(first, PANEL_COLUMNS);
    let mut text = format!("{title}\n");
    for pair in panels.chunks(2) {
        let mut columns = pair.iter().map(|(name, picture)| blocks.panel(name, &values(picture), shade));
        let (left, right) = (columns.next().unwrap_or_default(), columns.next().unwrap_or_default());
        for (at, line) in left.iter().enumerate() {
            let beside = right.get(at).map_or("", String::as_str);
            text += &format!("  {}\n", format!("{line:<PANEL_COLUMNS$}    {beside}").trim_end());
        }
    }
    if let [(_, before), (_, after)] = panels {
        let lines = blocks.panel("difference, the second minus the first", &differences(before, after), sign);
        lines.iter().for_each(|line| text += &format!("  {}\n", line.trim_end()));
    }
    text += &values_legend(first);
    if panels.len() == 2 {
        text += "  difference: = freer by 0.5 or more, - freer by 0.1, . less, + fuller by 0.1, # by 0.5 or more\n";
    }
    text += &blocks.legend(first);
    Ok(text)
}

/// The blocks of cells that one character shows.
struct Blocks {
    across: usize,
    down: usize,
    /// Characters of a cell: a character is about twice as high as wide, so cells of a small map have two.
    times: usize,
    width: usize,
}

impl Blocks {
    fn new(picture: &MapPicture, columns_max: usize) -> Self {
        let [width, height] = [picture.size_cells[0] as usize, picture.size_cells[1] as usize];
        if width * 2 <= columns_max && height <= ROWS {
            return Self { across: 1, down: 1, times: 2, width };
        }
        let across = width.div_ceil(columns_max).max(height.div_ceil(2 * ROWS));
        Self { across, down: 2 * across, times: 1, width }
    }

    /// The lines of rows of values; a character shows the value of its block that differs from 0 by the greatest
    /// number.
    fn lines(&self, rows: &[Vec<Option<f32>>], character: fn(Option<f32>) -> char) -> Vec<String> {
        let line = |block: &[Vec<Option<f32>>]| {
            let strongest = |left: usize| {
                let cells = block.iter().flat_map(|row| row[left..(left + self.across).min(self.width)].iter());
                cells.flatten().copied().reduce(|one, other| if other.abs() > one.abs() { other } else { one })
            };
            let lefts = (0..self.width).step_by(self.across);
            lefts.flat_map(|left| std::iter::repeat_n(character(strongest(left)), self.times)).collect()
        };
        rows.chunks(self.down).map(line).collect()
    }

    fn panel(&self, name: &str, rows: &[Vec<Option<f32>>], character: fn(Option<f32>) -> char) -> Vec<String> {
        [name.to_owned()].into_iter().chain(self.lines(rows, character)).collect()
    }

    /// The scale, and the meaning of a character.
    fn legend(&self, picture: &MapPicture) -> String {
        let Self { across, down, times, .. } = self;
        let mut text = String::new();
        if let Some(bar) = text_bar(*times as f64 / (*across as f64 * picture.resolution_m)) {
            let _ = writeln!(text, "  {bar}");
        }
        if *across > 1 {
            let _ = writeln!(text, "  a character shows the highest value of {across} x {down} cells");
        } else if *down > 1 {
            let _ = writeln!(text, "  a character shows the higher value of 2 cells");
        }
        text
    }
}

/// The legend of the characters of a picture.
fn values_legend(picture: &MapPicture) -> String {
    let shades: Vec<String> = SHADES.iter().map(ToString::to_string).collect();
    format!("  {}: 0 {} 1; blank: not observed\n", picture.value.text(), shades.join(" "))
}

/// The values of the cells, row by row from the top.
fn values(picture: &MapPicture) -> Vec<Vec<Option<f32>>> {
    picture.rows_from_top().map(|row| row.iter().map(|&cell| picture.value_of(cell)).collect()).collect()
}

/// The differences of the probabilities where both are known, row by row from the top.
fn differences(before: &MapPicture, after: &MapPicture) -> Vec<Vec<Option<f32>>> {
    let row = |(before, after): (&[PictureCell], &[PictureCell])| {
        before.iter().zip(after).map(|(before, after)| before.difference(*after)).collect()
    };
    before.rows_from_top().zip(after.rows_from_top()).map(row).collect()
}

fn shade(value: Option<f32>) -> char {
    let last = SHADES.len() - 1;
    value.map_or(' ', |value| SHADES[((value.clamp(0.0, 1.0) * last as f32).round() as usize).min(last)])
}

/// The character of a difference from -1 to 1.
fn sign(difference: Option<f32>) -> char {
    match difference {
        None => ' ',
        Some(difference) if difference <= -0.5 => '=',
        Some(difference) if difference <= -0.1 => '-',
        Some(difference) if difference < 0.1 => '.',
        Some(difference) if difference < 0.5 => '+',
        Some(_) => '#',
    }
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

    #[test]
    fn two_times_stand_beside_each_other_with_their_difference() -> Result<(), PictureError> {
        let before = samples::flat();
        let mut after = samples::flat();
        after.cells[0] = Static { probability: 1.0 };
        after.cells[1] = Static { probability: 0.3 };
        after.cells[4] = Static { probability: 0.35 };
        let panels = [("ten".to_owned(), before), ("noon".to_owned(), after)];
        let text = write_compared(&panels, "office")?;
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "office");
        assert_eq!(lines[1].split_whitespace().collect::<Vec<_>>(), ["ten", "noon"]);
        assert_eq!(lines[2].split_whitespace().collect::<Vec<_>>(), ["··▒▒██", "··░░██"]);
        assert_eq!(lines[3].split_whitespace().collect::<Vec<_>>(), ["··██", "██░░"]);
        assert_eq!(lines[4..7], ["  difference, the second minus the first", "  ..--..", "  ##=="]);
        assert!(lines.iter().any(|line| line.contains("# by 0.5 or more")), "{text}");
        let third = write_compared(&[&panels[..], &panels[..1]].concat(), "office")?;
        assert!(!third.contains("difference") && third.matches("ten").count() == 2, "{third}");
        let mut narrow = samples::flat();
        (narrow.size_cells, narrow.cells) = ([2, 2, 1], narrow.cells[..4].to_vec());
        let error = write_compared(&[panels[0].clone(), ("noon".to_owned(), narrow)], "office");
        assert!(matches!(error, Err(PictureError::Sizes(..))), "{error:?}");
        Ok(())
    }
}

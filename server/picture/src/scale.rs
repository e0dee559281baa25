//! Scales of maps: the bar in metres, and the size of a drawn cell.
//!
//! Invariant: the length of a bar is 1, 2 or 5 times a power of ten metres.

/// Maximum number of pixels along the side of a cell.
pub const SCALE_MAX: u32 = 16;
/// Pixels of the longer side of a picture that people can read.
const READABLE: u32 = 960;

/// Pixels along the side of a cell of a picture that is large enough to be read, 1 to [`SCALE_MAX`].
pub fn fitting_scale(columns: u32, rows: u32) -> u32 {
    (READABLE / columns.max(rows).max(1)).clamp(1, SCALE_MAX)
}

/// Formats a number with three significant digits, for scales.
pub fn short(number: f64) -> String {
    let rounded: f64 = format!("{number:.2e}").parse().unwrap_or(number);
    let is_plain = rounded == 0.0 || (1e-3..1e6).contains(&rounded.abs());
    if is_plain { rounded.to_string() } else { format!("{rounded:e}") }
}

/// The scale bar of a drawing: its length, at most `longest`, and its text. A metre is `per_m` characters or pixels
/// long, and the lengths are in the same unit. The bar shows 1, 2 or 5 times a power of ten metres; `None` if there is
/// no such bar.
pub fn scale_bar(per_m: f64, longest: f64) -> Option<(f64, String)> {
    let longest_m = longest / per_m;
    if !(longest_m.is_finite() && longest_m > 0.0) {
        return None;
    }
    let power = 10_f64.powf(longest_m.log10().floor());
    let metres =
        [5.0, 2.0, 1.0].into_iter().map(|step| step * power).find(|metres| *metres <= longest_m * (1.0 + 1e-9))?;
    Some((metres * per_m, format!("{} m", short(metres))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_have_round_lengths() {
        assert_eq!(scale_bar(20.0, 200.0), Some((200.0, "10 m".to_owned())));
        assert_eq!(scale_bar(20.0, 190.0), Some((100.0, "5 m".to_owned())));
        assert_eq!(scale_bar(1000.0, 200.0), Some((200.0, "0.2 m".to_owned())));
        assert_eq!((scale_bar(0.0, 200.0), scale_bar(f64::NAN, 200.0)), (None, None));
    }

    #[test]
    fn small_maps_are_drawn_larger() {
        assert_eq!(
            [(8, 3), (240, 100), (640, 336), (2000, 9), (0, 0)].map(|(x, y)| fitting_scale(x, y)),
            [16, 4, 1, 1, 16]
        );
    }
}

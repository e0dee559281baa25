//! Pictures in pixels, which the daemon and the command line draw: the palette
//! and the painter of grids, a canvas, letters, a legend and a scale bar.
//!
//! Invariant: pure; the same calls give the same bytes, and a file has no metadata such as time or name. Drawing
//! outside of a canvas changes nothing.

mod canvas;
mod legend;
mod letters;
mod painter;
pub mod palette;
mod scale;

pub use canvas::{Canvas, CanvasError};
pub use legend::{Legend, LegendRow};
pub use letters::{LETTER_HEIGHT, text_width};
pub use painter::{CellPaint, Layer, Painter};
pub use scale::{SCALE_MAX, fitting_scale, scale_bar, short};

/// Red, green, blue.
pub type Colour = [u8; 3];

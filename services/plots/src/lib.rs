//! SVG plots, and the plots that both the service and the commands draw.

mod price_curve;
mod time_axis;

pub use price_curve::{Offer, price_curve};
pub use time_axis::{clock, time_ticks};

use plotters::coord::Shift;
use plotters::prelude::*;

/// The drawing area of a plot.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The result of drawing, with any error of the drawing library.
pub type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Drawing a plot failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot draw the plot: {0}")]
pub struct PlotError(String);

/// Makes a white picture of `size` (width and height, pixels) and lets `draw` draw on it. Returns SVG.
///
/// # Errors
/// If drawing fails.
pub fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String, PlotError> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        let draw = || -> Drawn {
            area.fill(&WHITE)?;
            draw(&area)?;
            Ok(area.present()?)
        };
        draw().map_err(|error| PlotError(error.to_string()))?;
    }
    Ok(text)
}

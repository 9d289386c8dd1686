//! Plots as SVG, and those of them that the service and the commands both draw.

mod price_curve;
mod time_axis;

pub use price_curve::{Offer, price_curve};
pub use time_axis::{clock, time_ticks};

use plotters::coord::Shift;
use plotters::prelude::*;

/// What is drawn on.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Whether drawing worked: with any error of the drawing library.
pub type Drawn = Result<(), Box<dyn std::error::Error>>;

/// A plot that could not be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot draw the plot: {0}")]
pub struct PlotError(String);

/// A white picture of a width and height in pixels, with what `draw` draws on it.
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

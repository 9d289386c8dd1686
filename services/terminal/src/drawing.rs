//! Plots as SVG.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;

/// A drawing area.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// The result of drawing, with any error of the drawing library.
pub type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Draws on a white picture of this size, pixels.
pub fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
        let draw = || -> Drawn {
            area.fill(&WHITE)?;
            draw(&area)?;
            Ok(area.present()?)
        };
        draw().map_err(|error| anyhow!("cannot draw the plot: {error}"))?;
    }
    Ok(text)
}

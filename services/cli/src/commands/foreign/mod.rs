//! Commands for scenes of other renderers.

mod forecast;
mod render;

pub use forecast::{Asked as AskedForecast, forecast};
pub use render::{Asked as AskedRender, render};

//! What the pixels of a frame will cost, each for itself.

use crate::quote::Quote;
use crate::renderer::Renderer;
use crate::shot::{ShotError, forecast_strata, stratum_ids};
use forelight_forecast::PixelCosts;
use forelight_protocol::RenderSettings;

impl Quote {
    /// Work of each pixel of one of the quote's frames, in row order: what it costs on average where it shows what it does, or what it costs at most
    /// with a probability. Of quotes by the strategy Snapshot; records of an irradiance cache are no pixel's. `None` where too few pixels
    /// were profiled to say how likely anything is, or if the quote is not of that frame.
    ///
    /// # Errors
    /// If the frame cannot be previewed.
    pub fn pixel_work(
        &self,
        renderer: &dyn Renderer,
        settings: &RenderSettings,
        frame: u32,
        probability: Option<f64>,
    ) -> Result<Option<Vec<f64>>, ShotError> {
        let frames = self.document.frames.iter().map(|frame| frame.frame);
        let Some(at) = frames.clone().position(|number| number == frame) else { return Ok(None) };
        let strata = forecast_strata(&renderer.info().strata, settings);
        let means = |at: usize| -> Vec<f64> {
            let known = self.forecast.frames[at].strata.iter().take(strata.len());
            known.map(|stratum| stratum.mean.work).collect()
        };
        let costs = match probability {
            None => Some(means(at)),
            Some(probability) => {
                // Frames beside each other vary alike.
                let nearest = self.profiled.iter().min_by_key(|profiled| profiled.frame.abs_diff(frame));
                let Some(nearest) = nearest else { return Ok(None) };
                let Some(there) = frames.clone().position(|number| number == nearest.frame) else {
                    return Ok(None);
                };
                let (counts, seen) = (&self.counted.counts, &nearest.observations);
                let known = PixelCosts::new(&strata, &counts[there], seen).at(probability);
                let cost = |(stratum, (here, there)): (usize, (f64, f64))| match counts[at][stratum] {
                    // What no pixel shows has no price, and needs none.
                    0 => Some(here),
                    _ => known.of(stratum, there, here),
                };
                means(at).into_iter().zip(means(there)).enumerate().map(cost).collect()
            }
        };
        let Some(costs) = costs else { return Ok(None) };
        let ready = renderer.frame(frame, settings)?;
        let ids = stratum_ids(&ready.preview()?.preview);
        Ok(Some(ids.into_iter().map(|stratum| costs[stratum as usize]).collect()))
    }
}

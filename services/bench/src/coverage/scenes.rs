//! Small shots of real scenes, with the true cost of every pixel.

use super::case::{Known, KnownFrame};
use anyhow::Result;
use forelight_forecast::Cost;
use forelight_protocol::{RenderSettings, RenderSettingsRequest};
use forelight_renderer_own::{cost_of, forecast_strata, stratum_ids};
use forelight_terminal::failure::Interrupted;
use forelight_terminal::interrupt::Interrupt;
use forelight_terminal::local::Local;
use forelight_terminal::output::Bars;

/// A quality to render a scene at.
#[derive(Debug, Clone, Copy)]
pub struct Quality {
    pub title: &'static str,
    spp: u32,
    bounces: u32,
}

/// Direct light has uneven costs, by material and mirror. With one bounce, gathers make costs even. The last
/// has several camera samples per pixel.
pub const QUALITIES: [Quality; 3] = [
    Quality { title: "direct light", spp: 1, bounces: 0 },
    Quality { title: "one bounce", spp: 1, bounces: 1 },
    Quality { title: "direct light, 4 samples", spp: 4, bounces: 0 },
];

impl Quality {
    fn settings(self, width: u32, camera: (u32, u32)) -> RenderSettings {
        let height = (u64::from(width) * u64::from(camera.1) / u64::from(camera.0.max(1))).max(1) as u32;
        let request = RenderSettingsRequest {
            width: Some(width),
            height: Some(height),
            spp: Some(self.spp),
            ambient_bounces: Some(self.bounces),
            ..RenderSettingsRequest::default()
        };
        request.complete(camera)
    }
}

/// The shot at a quality, with `views` evenly spaced frames.
pub fn shot(
    local: &Local,
    quality: Quality,
    width: u32,
    views: u32,
    bars: &Bars,
    interrupt: &Interrupt,
) -> Result<Known> {
    let info = local.shot.info();
    let settings = quality.settings(width, (info.summary.width, info.summary.height));
    let all = info.summary.frames;
    let views = views.min(all);
    let bar = bars.bar("rendering", views.into());
    let mut frames = Vec::with_capacity(views as usize);
    for view in 0..views {
        // The middle of each of `views` equal parts.
        let number = ((2 * u64::from(view) + 1) * u64::from(all) / (2 * u64::from(views))) as u32;
        frames.push(local.pool.install(|| frame(local, number, &settings, interrupt))?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Known { strata: forecast_strata(&info.strata, &settings), width: settings.width, frames })
}

fn frame(local: &Local, number: u32, settings: &RenderSettings, interrupt: &Interrupt) -> Result<KnownFrame> {
    let ready = local.shot.frame(number, settings)?;
    let ids = stratum_ids(&ready.preview()?.preview);
    let finished = ready.render(None, &|_| (), &|_| (), interrupt.flag())?.ok_or(Interrupted)?;
    let fixed = Cost { work: ready.fixed().total().work, ..Cost::default() };
    Ok(KnownFrame {
        number: number.into(),
        ids,
        costs: finished.image.pixels.iter().map(cost_of).collect(),
        fixed,
    })
}

//! A picture of what pixels will cost.

use anyhow::Result;
use clap::ValueEnum;
use forelight_forecast::Strategy;
use forelight_protocol::RenderSettings;
use forelight_renderer_own::Quote;
use forelight_terminal::cost_picture::{Paint, Scale, map};
use forelight_terminal::failure::BadInput;
use forelight_terminal::local::Local;
use forelight_terminal::output::Bars;
use forelight_terminal::quantities::count;
use image::RgbImage;

/// What a picture of forecast costs shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum At {
    /// What they cost on average
    Mean,
    /// What half of them stay below
    P50,
    /// What four in five stay below; takes 4 profiled pixels
    P80,
    /// What 19 in 20 stay below; takes 19 profiled pixels
    P95,
}

impl At {
    const fn probability(self) -> Option<f64> {
        match self {
            At::Mean => None,
            At::P50 => Some(0.50),
            At::P80 => Some(0.80),
            At::P95 => Some(0.95),
        }
    }
}

/// Whether a strategy knows what pixels show, and so many of them can say how likely it is what they cost.
pub fn check(at: At, strategy: Strategy, samples: u32) -> Result<()> {
    if strategy != Strategy::Snapshot {
        let reason = format!("--cost-map: the strategy {} does not tell strata apart", strategy.name());
        return Err(BadInput::new(reason).into());
    }
    // Of n and one more, that one is no dearer than the dearest of the n with probability n / (n + 1).
    let takes = at.probability().map_or(0, |probability| (probability / (1.0 - probability)).round() as u32);
    if samples < takes {
        let reason = format!(
            "--cost-map-at: it takes at least {takes} profiled pixels to say; --samples is {samples}"
        );
        return Err(BadInput::new(reason).into());
    }
    Ok(())
}

/// A picture of what the pixels of the first frame are forecast to cost.
pub fn picture(
    at: At,
    local: &Local,
    quoted: &Quote,
    settings: &RenderSettings,
    bars: &Bars,
) -> Result<RgbImage> {
    let frame = quoted.document.frames.first().map_or(0, |frame| frame.frame);
    let work = || quoted.pixel_work(&local.shot, settings, frame, at.probability());
    let Some(work) = local.pool.install(work)? else {
        let reason = "--cost-map-at: too few pixels were profiled to say how they vary";
        return Err(BadInput::new(reason).hint("profile more of them by --samples").into());
    };
    let scale = Scale::of(&work);
    let (least, most) = (count(scale.lowest), count(scale.highest));
    bars.note(format!("cost map of frame {frame}: cyan is {least} operations a pixel, red {most}"));
    Ok(map(settings.width, &work, scale, Paint::Colour))
}

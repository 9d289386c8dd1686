//! The forecast cost of each pixel as a picture.

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

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum At {
    /// The mean cost of a pixel
    Mean,
    /// The cost that half of the pixels stay below
    P50,
    /// The cost that 80 % of the pixels stay below. Needs 4 profiled pixels
    P80,
    /// The cost that 95 % of the pixels stay below. Needs 19 profiled pixels
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

/// Checks that the strategy knows what each pixel shows, with enough profiled pixels for the quantile.
pub fn check(at: At, strategy: Strategy, samples: u32) -> Result<()> {
    if strategy != Strategy::Snapshot {
        let reason = format!(
            "--cost-map: the strategy {} does not tell strata apart; use the strategy snapshot",
            strategy.name()
        );
        return Err(BadInput::new(reason).into());
    }
    // One more pixel is at most as expensive as the most expensive of n with probability n / (n + 1).
    let takes = at.probability().map_or(0, |probability| (probability / (1.0 - probability)).round() as u32);
    if samples < takes {
        let reason = format!(
            "--cost-map-at: this quantile needs at least {takes} profiled pixels, but --samples is {samples}"
        );
        return Err(BadInput::new(reason).into());
    }
    Ok(())
}

/// The forecast cost of the first frame's pixels as a picture.
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
        let reason = "--cost-map-at: too few pixels were profiled for this quantile";
        return Err(BadInput::new(reason).hint("profile more pixels with --samples").into());
    };
    let scale = Scale::of(&work);
    let (least, most) = (count(scale.lowest), count(scale.highest));
    bars.note(format!("cost map of frame {frame}: cyan is {least} operations per pixel, red is {most}"));
    Ok(map(settings.width, &work, scale, Paint::Colour))
}

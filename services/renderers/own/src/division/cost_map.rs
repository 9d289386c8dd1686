//! What the pixels of a frame will cost, from a few camera samples, and so where parts of equal cost end. The
//! same samples make a coarse picture.

use crate::costs::spent;
use crate::frame::OwnFrame;
use crate::results::uncovered_gathers;
use forelight_forecast::{PixelCurve, Probe, Stretch, parts_of_equal_cost, probes, probing_samples};
use forelight_pictures::tone_map;
use forelight_protocol::{PixelRange, RenderSettings, Spent};
use forelight_tracer::Pixel;
use image::{Rgb, RgbImage};
use std::ops::Range;

/// A frame, divided into parts along the [`PixelCurve`] of its image.
#[derive(Debug, Clone, PartialEq)]
pub struct Divided {
    /// Where each part ends, and its forecast work.
    pub parts: Vec<Stretch>,
    /// The samples: the runs of pixels along the curve that each stands for, and its colour.
    pub seen: Vec<(PixelRange, [f32; 3])>,
    /// Cost of probing.
    pub spent: Spent,
}

impl OwnFrame<'_> {
    /// Divides the frame into parts of equal forecast work. `finished` are pixels that cost nothing any more.
    /// The irradiance cache is planned if it is needed, but not filled. `None` if `stop` returned true.
    pub fn divide(
        &self,
        parts: u32,
        finished: &[(u32, Pixel)],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Divided> {
        self.divided(self.tracer.settings().spp, self.places(), parts, finished, stop)
    }

    /// The same for some of the frame's places, of which nothing is finished.
    pub fn divide_places(
        &self,
        places: Range<u32>,
        parts: u32,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Divided> {
        self.divided(self.tracer.settings().spp, places, parts, &[], stop)
    }

    /// The order of the image's pixels, of which a part is a range.
    pub(crate) fn curve(&self) -> PixelCurve {
        let camera = &self.frame().camera;
        PixelCurve::new(camera.width, camera.height)
    }

    /// The places of all pixels along the curve.
    pub(crate) fn places(&self) -> Range<u32> {
        0..self.curve().count()
    }

    /// The same for a pass that gives every pixel its first samples.
    pub fn divide_first_pass(
        &self,
        samples: u32,
        parts: u32,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Divided> {
        self.divided(samples, self.places(), parts, &[], stop)
    }

    fn divided(
        &self,
        samples: u32,
        places: Range<u32>,
        parts: u32,
        finished: &[(u32, Pixel)],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Option<Divided> {
        let settings = RenderSettings { spp: samples, ..self.tracer.settings().into() };
        let curve = self.curve();
        let growth = Growth::of(&settings);
        let count = probing_samples(places.len() as u64 * u64::from(settings.spp), parts);
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        let first = places.start;
        let moved =
            |probe: Probe| Probe { from: first + probe.from, to: first + probe.to, at: first + probe.at };
        let probes = probes(places.end - first, count, settings.seed);
        let probes: Vec<Probe> = probes.into_iter().map(moved).collect();
        let pixels: Vec<u32> = probes.iter().map(|probe| curve.pixel(probe.at)).collect();
        let (traced, probing) = self.tracer.first_samples(&pixels, growth.samples(), stop)?;
        let open = open_pixels(&curve, &probes, finished);
        let run = |((probe, after), open): ((&Probe, &Vec<Pixel>), u32)| Stretch {
            to: probe.to - first,
            cost: (growth.whole(after) * f64::from(open)).round() as u64,
        };
        let runs: Vec<Stretch> = probes.iter().zip(&traced).zip(open).map(run).collect();
        let color = |after: &Vec<Pixel>| after.last().map_or([0.0; 3], |pixel| pixel.color);
        let seen = probes.iter().zip(&traced);
        let seen = seen.map(|(probe, after)| (PixelRange { from: probe.from, to: probe.to }, color(after)));
        let parts = parts_of_equal_cost(&runs, parts).into_iter();
        Some(Divided {
            parts: parts.map(|part| Stretch { to: first + part.to, ..part }).collect(),
            seen: seen.collect(),
            spent: spent(probing),
        })
    }

    /// A coarse picture: the colour of each sample for the pixels that it stands for, and finished pixels.
    pub fn coarse_picture(&self, seen: &[(PixelRange, [f32; 3])], finished: &[(u32, Pixel)]) -> RgbImage {
        let camera = &self.frame().camera;
        let (width, curve) = (camera.width, self.curve());
        let mut picture = RgbImage::new(width, camera.height);
        let mut paint = |pixel: u32, color| picture.put_pixel(pixel % width, pixel / width, color);
        for (run, color) in seen {
            let color = Rgb(tone_map(*color));
            curve.pixels(run.from..run.to).into_iter().for_each(|pixel| paint(pixel, color));
        }
        finished.iter().for_each(|(pixel, finished)| paint(*pixel, Rgb(tone_map(finished.color))));
        picture
    }
}

/// Number of pixels of each run that are not finished.
fn open_pixels(curve: &PixelCurve, probes: &[Probe], finished: &[(u32, Pixel)]) -> Vec<u32> {
    let mut done = vec![false; curve.count() as usize];
    finished.iter().for_each(|(index, _)| done[*index as usize] = true);
    let open =
        |probe: &Probe| curve.pixels(probe.from..probe.to).iter().filter(|&&i| !done[i as usize]).count();
    // A run has at most as many pixels as an image.
    probes.iter().map(|probe| open(probe) as u32).collect()
}

/// How a pixel's work grows with its camera samples.
struct Growth {
    /// Samples of a pixel in the image.
    samples: u32,
    /// With an irradiance cache: what the rays at uncovered points cost from the second sample to the last,
    /// over what they cost in the second.
    uncovered: Option<f64>,
}

impl Growth {
    fn of(settings: &RenderSettings) -> Self {
        let beyond = |gathers: forelight_protocol::UncoveredGathers| {
            let second = gathers.growth(1, 2) - 1.0;
            if second > 0.0 { (gathers.growth(1, settings.spp) - 1.0) / second } else { 0.0 }
        };
        Self { samples: settings.spp, uncovered: uncovered_gathers(settings).map(beyond) }
    }

    /// Number of samples to trace of a pixel. A cache is planned for the first sample of every pixel, so
    /// records cover later ones less often, and the second has to tell of them. Pixels are few of such a
    /// frame's costs, so as many are probed as without a cache.
    fn samples(&self) -> u32 {
        if self.uncovered.is_some() { self.samples.min(2) } else { 1 }
    }

    /// Work of a pixel in the image, from itself after its first samples.
    fn whole(&self, after: &[Pixel]) -> f64 {
        let rest = f64::from(self.samples - 1);
        match after {
            [] => 0.0,
            [first] => first.work as f64 * (1.0 + rest),
            [first, .., last] => {
                let extra = (last.extra_work - first.extra_work) as f64;
                let plain = (last.work - first.work) as f64 - extra;
                first.work as f64 + plain * rest + extra * self.uncovered.unwrap_or(rest)
            }
        }
    }
}

//! Chooses one light of a frame: first the kind, then emitters by their tree, suns by their irradiance, or
//! the environment's image.

use super::bounds::Receiver;
use super::emitters::{Emitter, Emitters};
use super::tree::{BELOW_ONE, Choice};
use crate::Reach;
use crate::environment::Sky;
use forelight_scene::{Frame, Material, Sun};

/// A chosen light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Light {
    /// An emitting patch, by its index in [`Emitters`].
    Patch(usize),
    /// A point light, by its index in the frame.
    Point(usize),
    /// A sun, by its index in the frame.
    Sun(usize),
    /// The environment's image.
    Sky,
}

/// All lights that are sampled. BSDF sampling alone finds a constant environment.
#[derive(Debug, Clone, Default)]
pub struct Lights {
    pub emitters: Emitters,
    /// Cumulative irradiance of the suns in the strongest channel, W/m².
    suns: Vec<f64>,
    /// The only sun, if there is exactly one. Its height above the receiver's horizon is taken into account.
    only_sun: Option<Sun>,
    /// Mean irradiance from the environment's image, W/m².
    sky: f64,
}

/// Probabilities of the kinds of light at a receiver.
#[derive(Debug, Clone, Copy)]
struct Kinds {
    emitters: f64,
    suns: f64,
    sky: f64,
}

impl Lights {
    /// Collects the lights that can affect the image.
    pub fn new(frame: &Frame, materials: &[Material], sky: &Sky, reach: &Reach) -> Self {
        let mut sum = 0.0;
        let suns = frame.suns.iter().enumerate().map(|(i, sun)| {
            let irradiance = f64::from(sun.irradiance.max_element());
            let counts = irradiance > 0.0 && sun.irradiance.is_finite() && reach.sun(i);
            sum += if counts { irradiance } else { 0.0 };
            sum
        });
        Self {
            emitters: Emitters::new(frame, materials, reach),
            suns: suns.collect(),
            only_sun: if let [sun] = frame.suns[..] { Some(sun) } else { None },
            sky: match sky {
                Sky::Image(image) if reach.environment() => std::f64::consts::PI * image.mean_radiance(),
                _ => 0.0,
            },
        }
    }

    /// Chooses a light for the uniform random number `u` in [0, 1), with the probability of the choice.
    /// `None` if no light can reach the receiver. `visited` counts the tree nodes visited.
    pub fn choose(&self, receiver: &Receiver, u: f64, visited: &mut u64) -> Option<(Light, f64)> {
        let kinds = self.kinds(receiver)?;
        if u < kinds.emitters {
            let mut choice = Choice::by((u / kinds.emitters).min(BELOW_ONE));
            self.emitters.choose(receiver, std::slice::from_mut(&mut choice), visited);
            let light = match self.emitters.chosen(&choice)? {
                Emitter::Patch(index) => Light::Patch(index),
                Emitter::Point(index) => Light::Point(index),
            };
            return Some((light, kinds.emitters * choice.probability));
        }
        let u = u - kinds.emitters;
        if u < kinds.suns {
            let total = self.suns.last()?;
            let position = u / kinds.suns * total;
            let index = self.suns.partition_point(|&sum| sum <= position).min(self.suns.len() - 1);
            return Some((Light::Sun(index), kinds.suns * self.share_of_sun(index)));
        }
        (kinds.sky > 0.0).then_some((Light::Sky, kinds.sky))
    }

    /// Probability with which [`Self::choose`] chooses an emitting patch.
    pub fn of_patch(&self, receiver: &Receiver, emitter: usize, visited: &mut u64) -> f64 {
        let kinds = self.kinds(receiver).map_or(0.0, |kinds| kinds.emitters);
        kinds * self.emitters.probability(receiver, emitter, visited)
    }

    /// Probability with which [`Self::choose`] chooses a sun.
    pub fn of_sun(&self, receiver: &Receiver, index: usize) -> f64 {
        self.kinds(receiver).map_or(0.0, |kinds| kinds.suns * self.share_of_sun(index))
    }

    /// Probability with which [`Self::choose`] chooses the environment.
    pub fn of_sky(&self, receiver: &Receiver) -> f64 {
        self.kinds(receiver).map_or(0.0, |kinds| kinds.sky)
    }

    fn share_of_sun(&self, index: usize) -> f64 {
        let below = if index == 0 { 0.0 } else { self.suns[index - 1] };
        (self.suns[index] - below) / self.suns[self.suns.len() - 1]
    }

    /// Half of the probability is distributed evenly among the kinds of light that can reach the receiver,
    /// because the estimates ignore occlusion. The other half is in proportion to the estimates.
    fn kinds(&self, receiver: &Receiver) -> Option<Kinds> {
        let suns = self.suns.last().copied().unwrap_or(0.0);
        let suns = match (self.only_sun, receiver.normal) {
            (Some(sun), Some(normal)) => {
                let margin = libm::sinf(sun.angle_deg.to_radians() * 0.5) + 1e-3;
                suns * f64::from((normal.dot(sun.direction) + margin).max(0.0))
            }
            _ => suns,
        };
        let expected = [self.emitters.importance(receiver), suns, self.sky];
        let sum: f64 = expected.iter().sum();
        let count = expected.iter().filter(|&&e| e > 0.0).count() as f64;
        let share = |e: f64| if e > 0.0 { 0.5 / count + 0.5 * e / sum } else { 0.0 };
        let [emitters, suns, sky] = expected.map(share);
        (sum > 0.0).then_some(Kinds { emitters, suns, sky })
    }
}

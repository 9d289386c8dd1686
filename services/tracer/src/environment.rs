//! Light from outside the scene: black, constant, or a latitude-longitude image.
//!
//! An image is importance-sampled: directions are chosen in proportion to the light of their texels.

use crate::geometry::{direction_to_lat_long, lat_long_to_direction};
use forelight_scene::{Environment, Frame, Texture};
use glam::{DVec2, Vec2, Vec3};
use std::f32::consts::PI;
use std::sync::Arc;

/// Radiance that a ray receives when it leaves the scene.
#[derive(Debug, Clone)]
pub enum Sky {
    Black,
    Constant(Vec3),
    Image(Box<SkyImage>),
}

/// A latitude-longitude image with a distribution for importance sampling.
#[derive(Debug, Clone)]
pub struct SkyImage {
    textures: Arc<[Texture]>,
    texture: usize,
    scale: f32,
    /// Cosine and sine of the rotation about +y.
    rotation: (f32, f32),
    /// Cumulative distribution of light over rows, and over the texels of each. The last entries are 1.
    rows: Vec<f32>,
    columns: Vec<Vec<f32>>,
    /// Upper bound of the mean radiance over all directions, in the strongest channel, W/(m² sr).
    mean: f64,
}

impl Sky {
    pub fn new(frame: &Frame) -> Self {
        match frame.environment {
            Environment::Black => Self::Black,
            Environment::Constant(radiance) if radiance.max_element() <= 0.0 => Self::Black,
            Environment::Constant(radiance) => Self::Constant(radiance),
            Environment::Image { texture, scale, rotation_deg } => {
                SkyImage::new(frame, texture.0 as usize, scale, rotation_deg)
                    .map_or(Self::Black, |image| Self::Image(Box::new(image)))
            }
        }
    }

    pub fn is_black(&self) -> bool {
        matches!(self, Self::Black)
    }

    /// Radiance from direction `d` (unit).
    pub fn radiance(&self, d: Vec3) -> Vec3 {
        match self {
            Self::Black => Vec3::ZERO,
            Self::Constant(radiance) => *radiance,
            Self::Image(image) => image.radiance(d),
        }
    }
}

impl SkyImage {
    fn new(frame: &Frame, texture: usize, scale: f32, rotation_deg: f32) -> Option<Self> {
        let image = frame.textures.get(texture)?;
        let (width, height) = (image.width as usize, image.height as usize);
        let (mut rows, mut columns) = (Vec::with_capacity(height), Vec::with_capacity(height));
        let mut total = 0.0f64;
        for y in 0..height {
            // A texel's weight is the largest channel of its neighbourhood times the solid angle of its row.
            // Bilinear lookup spreads light to neighbours, and no direction with light may have density zero.
            let sin = libm::sin((y as f64 + 0.5) / height as f64 * std::f64::consts::PI);
            let mut sum = 0.0f64;
            let row: Vec<f64> = (0..width)
                .map(|x| {
                    let mut weight = 0.0f32;
                    for dy in [-1i64, 0, 1] {
                        let row = (y as i64 + dy).clamp(0, height as i64 - 1) as usize;
                        for dx in [width - 1, 0, 1] {
                            weight =
                                weight.max(image.texel_color(row * width + (x + dx) % width).max_element());
                        }
                    }
                    sum += f64::from(weight.max(0.0)) * sin;
                    sum
                })
                .collect();
            columns.push(row.iter().map(|&c| if sum > 0.0 { (c / sum) as f32 } else { 1.0 }).collect());
            total += sum;
            rows.push(total);
        }
        if !(total > 0.0 && total.is_finite() && scale > 0.0) {
            return None;
        }
        let rows = rows.iter().map(|&r| (r / total) as f32).collect();
        // the sum of sin θ over all texels
        let solid_angle: f64 = 2.0 / std::f64::consts::PI * (height * width) as f64;
        let mean = total / solid_angle * f64::from(scale);
        let angle = rotation_deg.to_radians();
        let rotation = (libm::cosf(angle), libm::sinf(angle));
        Some(Self { textures: frame.textures.clone(), texture, scale, rotation, rows, columns, mean })
    }

    /// Image coordinates of a direction; v points down.
    fn coordinates(&self, d: Vec3) -> Vec2 {
        let (c, s) = self.rotation;
        direction_to_lat_long(Vec3::new(c * d.x - s * d.z, d.y, s * d.x + c * d.z))
    }

    /// Upper bound of the mean radiance over all directions, in the strongest channel, W/(m² sr).
    pub fn mean_radiance(&self) -> f64 {
        self.mean
    }

    fn radiance(&self, d: Vec3) -> Vec3 {
        let uv = self.coordinates(d);
        self.scale * self.textures[self.texture].sky(Vec2::new(uv.x, 1.0 - uv.y))
    }

    /// Density per steradian with which [`Self::sample`] chooses direction `d` (unit).
    pub fn density(&self, d: Vec3) -> f32 {
        let uv = self.coordinates(d);
        let (width, height) = (self.columns[0].len(), self.rows.len());
        let y = ((uv.y * height as f32) as usize).min(height - 1);
        let x = ((uv.x * width as f32) as usize).min(width - 1);
        let share =
            |cumulative: &[f32], i: usize| cumulative[i] - if i == 0 { 0.0 } else { cumulative[i - 1] };
        let sin = ((1.0 - d.y) * (1.0 + d.y)).max(0.0).sqrt();
        let texel = share(&self.rows, y) * share(&self.columns[y], x);
        let density = texel * (width * height) as f32 / (2.0 * PI * PI * sin);
        if density.is_finite() { density } else { 0.0 }
    }

    /// Samples a direction in proportion to its light. Returns it with its density per steradian.
    pub fn sample(&self, u: DVec2) -> Option<(Vec3, f32)> {
        let (y, v, row_share) = invert(&self.rows, u.y);
        let (x, w, texel_share) = invert(&self.columns[y], u.x);
        let (width, height) = (self.columns[y].len() as f32, self.rows.len() as f32);
        let (local, sin) = lat_long_to_direction(Vec2::new((x as f32 + w) / width, (y as f32 + v) / height));
        let density = row_share * texel_share * width * height / (2.0 * PI * PI * sin);
        let (c, s) = self.rotation;
        let world = Vec3::new(c * local.x + s * local.z, local.y, -s * local.x + c * local.z);
        (density.is_finite() && density > 0.0).then_some((world, density))
    }
}

/// Inverts a cumulative distribution at `u`: entry, position within it in [0, 1), probability.
fn invert(cumulative: &[f32], u: f64) -> (usize, f32, f32) {
    let index = cumulative.partition_point(|&c| f64::from(c) <= u).min(cumulative.len() - 1);
    let below = if index == 0 { 0.0 } else { cumulative[index - 1] };
    let share = cumulative[index] - below;
    let within = ((u - f64::from(below)) / f64::from(share)) as f32;
    (index, if share > 0.0 { within.clamp(0.0, 0.999_999_9) } else { 0.5 }, share)
}

//! Chooses between GPU and CPU, and keeps what frames share.

use crate::cost::Cost;
use crate::cpu::Cpu;
use crate::error::PreviewError;
use crate::gpu::Gpu;
use crate::preview::{Counts, Preview};
use forelight_scene::Frame;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Where previews are made: the value of `--preview`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Choice {
    /// On the GPU if a usable Vulkan device exists and the scene fits. Otherwise on the CPU.
    #[default]
    Auto,
    /// On the GPU. Fails if that is not possible.
    Gpu,
    /// On the CPU.
    Cpu,
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Gpu => "gpu",
            Self::Cpu => "cpu",
        })
    }
}

/// A word that is not a [`Choice`].
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0:?} is not one of auto, gpu, cpu")]
pub struct ParseChoiceError(String);

impl FromStr for Choice {
    type Err = ParseChoiceError;

    fn from_str(word: &str) -> Result<Self, Self::Err> {
        match word {
            "auto" => Ok(Self::Auto),
            "gpu" => Ok(Self::Gpu),
            "cpu" => Ok(Self::Cpu),
            _ => Err(ParseChoiceError(word.into())),
        }
    }
}

/// Makes previews. Keeps geometry and textures that a frame shares with the previous one.
pub struct Previewer {
    choice: Choice,
    gpu: Option<Gpu>,
    cpu: Cpu,
    /// Whether the log already says that a scene did not fit the device.
    warned: bool,
    cost: Cost,
}

impl Previewer {
    /// Opens a device if `choice` asks for one, and logs the outcome once. Fails with
    /// [`PreviewError::NoDevice`] or [`PreviewError::Device`], for [`Choice::Gpu`] only.
    pub fn new(choice: Choice) -> Result<Self, PreviewError> {
        let gpu = match choice {
            Choice::Cpu => {
                tracing::info!("previews on the CPU, as requested");
                None
            }
            Choice::Gpu | Choice::Auto => match Gpu::open() {
                Ok(gpu) => {
                    tracing::info!(adapter = gpu.name(), "previews on the GPU");
                    Some(gpu)
                }
                Err(error) if choice == Choice::Gpu => return Err(error),
                Err(error) => {
                    tracing::info!(reason = %error, "previews on the CPU");
                    None
                }
            },
        };
        Ok(Self { choice, gpu, cpu: Cpu::default(), warned: false, cost: Cost::default() })
    }

    /// The implementation in use: `"gpu"` or `"cpu"`.
    pub fn backend(&self) -> &'static str {
        if self.gpu.is_some() { "gpu" } else { "cpu" }
    }

    /// Name, kind and driver of the GPU in use. `None` on the CPU.
    pub fn adapter(&self) -> Option<&str> {
        self.gpu.as_ref().map(Gpu::name)
    }

    /// Whether a hardware GPU is in use, rather than a software driver or the CPU.
    pub fn is_hardware(&self) -> bool {
        self.gpu.as_ref().is_some_and(Gpu::is_hardware)
    }

    /// Cost of the last call of `preview` or `counts`. Zero after an error.
    pub fn cost(&self) -> Cost {
        self.cost
    }

    /// What each pixel of the frame shows at its centre. Fails with [`PreviewError::EmptyImage`],
    /// [`PreviewError::ImageTooLarge`] or [`PreviewError::Camera`], and on device failures for
    /// [`Choice::Gpu`] only.
    pub fn preview(&mut self, frame: &Frame) -> Result<Preview, PreviewError> {
        self.make(|gpu| gpu.preview(frame), |cpu| cpu.preview(frame))
    }

    /// Number of pixels per stratum, as in `preview(frame)?.counts()`, with less read-back. Errors as for
    /// [`Previewer::preview`].
    pub fn counts(&mut self, frame: &Frame) -> Result<Counts, PreviewError> {
        self.make(|gpu| gpu.counts(frame), |cpu| cpu.counts(frame))
    }

    fn make<T>(
        &mut self,
        on_gpu: impl FnOnce(&mut Gpu) -> Result<(T, Cost), PreviewError>,
        on_cpu: impl FnOnce(&mut Cpu) -> Result<(T, Cost), PreviewError>,
    ) -> Result<T, PreviewError> {
        self.cost = Cost::default();
        if let Some(gpu) = &mut self.gpu {
            match on_gpu(gpu) {
                Ok((value, cost)) => {
                    self.cost = cost;
                    return Ok(value);
                }
                Err(error) if self.choice == Choice::Gpu => return Err(error),
                Err(error @ PreviewError::DoesNotFit { .. }) => {
                    if !self.warned {
                        tracing::warn!(reason = %error, "the scene does not fit the GPU; previewing it on the CPU");
                        self.warned = true;
                    }
                }
                Err(
                    error @ (PreviewError::Timeout { .. }
                    | PreviewError::Device(_)
                    | PreviewError::NoDevice(_)),
                ) => {
                    tracing::warn!(reason = %error, "the GPU failed; all further previews are made on the CPU");
                    self.gpu = None;
                }
                Err(error) => return Err(error),
            }
        }
        let (value, cost) = on_cpu(&mut self.cpu)?;
        self.cost = cost;
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use forelight_scene::{Color, Environment, Geometry, Material, Strata, Surface};
    use glam::{Vec2, Vec3};

    #[test]
    fn a_choice_reads_as_it_is_written() {
        for choice in [Choice::Auto, Choice::Gpu, Choice::Cpu] {
            assert_eq!(choice.to_string().parse(), Ok(choice));
        }
        let error = "both".parse::<Choice>().expect_err("no choice");
        assert_eq!(error.to_string(), "\"both\" is not one of auto, gpu, cpu");
    }

    /// A triangle in front of a camera of 8 × 8 pixels.
    fn frame() -> Frame {
        let camera = forelight_scene::Camera {
            origin: Vec3::ZERO,
            right: Vec3::X,
            up: Vec3::Y,
            forward: Vec3::NEG_Z,
            tan_half_x: 1.0,
            tan_half_y: 1.0,
            width: 8,
            height: 8,
            aperture_radius: 0.0,
            focus_distance: 1.0,
        };
        let geometry = Geometry {
            positions: vec![
                Vec3::new(-1.0, -1.0, -2.0),
                Vec3::new(1.0, -1.0, -2.0),
                Vec3::new(0.0, 1.0, -2.0),
            ],
            normals: vec![Vec3::ZERO; 3],
            uvs: vec![Vec2::ZERO; 3],
            triangles: vec![[0, 1, 2]],
            triangle_stratum: vec![0],
            strata: Strata { objects: vec!["triangle".into()], pairs: vec![(0, 0)] },
        };
        let material = Material {
            name: "grey".into(),
            surface: Surface::Lambert { albedo: Color::plain(Vec3::ONE) },
            emission: Color::plain(Vec3::ZERO),
            emits_both_sides: false,
            opacity: 1.0,
            mask: None,
        };
        Frame {
            number: 0,
            camera,
            geometry: geometry.into(),
            materials: [material].into(),
            textures: [].into(),
            points: Vec::new(),
            suns: Vec::new(),
            environment: Environment::Black,
        }
    }

    #[test]
    fn a_lost_device_is_an_error_for_gpu_and_no_more_than_a_change_of_maker_for_auto() {
        let Ok(mut gpu) = Previewer::new(Choice::Gpu) else {
            return forelight_test_needs::not_run("no Vulkan device");
        };
        let frame = frame();
        let expected = gpu.counts(&frame).expect("counts");
        assert!(expected.per_stratum[0] > 0);
        gpu.gpu.as_ref().expect("the GPU was asked for").lose();
        for _ in 0..2 {
            assert!(matches!(gpu.counts(&frame), Err(PreviewError::Device(_))));
            assert!(matches!(gpu.preview(&frame), Err(PreviewError::Device(_))));
        }
        let mut auto = Previewer::new(Choice::Auto).expect("auto never fails");
        auto.preview(&frame).expect("a preview");
        auto.gpu.as_ref().expect("there is a device here").lose();
        assert_eq!(auto.counts(&frame), Ok(expected));
        assert_eq!((auto.backend(), auto.adapter()), ("cpu", None));
    }
}

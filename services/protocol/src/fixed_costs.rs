//! Costs that do not depend on the pixels of a frame.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::Spent;

/// Costs of a frame that do not depend on its pixels.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FixedCosts {
    /// Setting up the frame: applying its animation.
    pub load: Spent,
    /// Building the acceleration structure.
    pub build: Spent,
    /// Planning the irradiance cache, and reading the shared one if there is one. 0 without a cache.
    #[serde(default)]
    pub plan: Spent,
    /// Rays of `plan` by category: primary, shadow, transparent, reflected, refracted, ambient, specular.
    #[serde(default)]
    #[schema(min_items = 7, max_items = 7)]
    pub plan_rays: [u64; 7],
    /// Writing the files of a finished frame, pictures included. CPU time only. 0 if no files are written.
    pub write: Spent,
    /// Removing the noise of the image, and measuring the error that is left. CPU time only. 0 if the noise stays.
    #[serde(default, skip_serializing_if = "crate::is_zero")]
    pub denoise: Spent,
}

impl FixedCosts {
    /// The sum without `build`, which depends on the frame's number of triangles.
    pub const fn without_build(self) -> Spent {
        let Self { load, build: _, plan, plan_rays: _, write, denoise } = self;
        load.plus(plan).plus(write).plus(denoise)
    }

    /// The same without planning the irradiance cache.
    #[must_use]
    pub fn without_plan(self) -> Self {
        Self { plan: Spent::default(), plan_rays: [0; 7], ..self }
    }

    /// The sum of all.
    pub const fn total(self) -> Spent {
        self.without_build().plus(self.build)
    }

    /// The mean. `None` if there are none.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let mean = |of: fn(&Self) -> Spent| Spent::mean(all.iter().map(of));
        Some(Self {
            load: mean(|fixed| fixed.load)?,
            build: mean(|fixed| fixed.build)?,
            plan: mean(|fixed| fixed.plan)?,
            plan_rays: std::array::from_fn(|kind| {
                all.iter().map(|fixed| fixed.plan_rays[kind]).sum::<u64>() / all.len() as u64
            }),
            write: mean(|fixed| fixed.write)?,
            denoise: mean(|fixed| fixed.denoise)?,
        })
    }

    /// Converts costs that a node of this speed measured to a node of speed 1.
    #[must_use]
    pub fn at_speed_one(self, speed: f64) -> Self {
        let on = |spent: Spent| spent.at_speed_one(speed);
        let Self { load, build, plan, plan_rays, write, denoise } = self;
        Self {
            load: on(load),
            build: on(build),
            plan: on(plan),
            plan_rays,
            write: on(write),
            denoise: on(denoise),
        }
    }
}

/// Costs that each process pays once per shot, unless its machine keeps the scene and the structure. They are
/// not part of any frame or total.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ProcessCosts {
    /// Reading the bundle. It is CPU time only, because `work` counts tracing.
    pub load: Spent,
    /// Building the acceleration structures that frames share because nothing moves: one for each closed room
    /// that the camera visits. 0 if each frame builds its own.
    pub build: Spent,
}

impl ProcessCosts {
    /// The mean. `None` if there are none.
    pub fn mean(all: &[Self]) -> Option<Self> {
        let mean = |of: fn(&Self) -> Spent| Spent::mean(all.iter().map(of));
        Some(Self { load: mean(|once| once.load)?, build: mean(|once| once.build)? })
    }

    /// Converts costs that a node of this speed measured to a node of speed 1.
    #[must_use]
    pub fn at_speed_one(self, speed: f64) -> Self {
        Self { load: self.load.at_speed_one(speed), build: self.build.at_speed_one(speed) }
    }
}

//! How light gets from the lights to the camera, and what finding out took.
//!
//! A [`Tracer`] holds what one frame needs (tree, lights, materials); [`Tracer::pixel`] computes one finished
//! [`Pixel`]: its colour, the rays by category, the deterministic `work` and the CPU time. A pixel depends on the
//! frame, the [`Settings`] and its own index alone, so an image has the same bits whatever the threads, the tiles, the
//! order, and whether some pixels came from a [`Profile`].
//!
//! | file | subject |
//! | --- | --- |
//! | `settings` | what the user asks for |
//! | `random` | counter-based random numbers, scrambled (0,2)-sequences |
//! | `geometry` | frames of reference and maps from the square to disc, hemisphere and cap |
//! | `fresnel`, `microfacet` | reflectance of interfaces, GGX |
//! | `response`, `bsdf` | a material at a point, ready to be lit; the same as a BSDF to choose directions by |
//! | `lights`, `environment` | where light comes from, and how to choose points on it |
//! | `effects`, `kernel` | what a frame calls for, and the code that is put together for it |
//! | `integrator` | how a path goes: `ambient`, its direct light, what lies between a point and a light |
//! | `cache` | indirect light by interpolation: planned, filled, read |
//! | `reach` | which lights and objects cannot matter to the picture |
//! | `cost` | counters, `work`, clocks |
//! | `tree` | the tree over what matters |
//! | `tracer`, `profile`, `image` | a frame's pixels, some of them, and all of them |
//! | `samples`, `passes` | camera samples that differ by pixel, and that are added bit by bit |
//! | `tiling` | an image, cut into square tiles |

mod bounds;
pub mod bsdf;
mod cache;
mod cost;
mod effects;
mod environment;
mod fingerprint;
pub mod fresnel;
mod geometry;
mod image;
mod integrator;
mod kernel;
mod lights;
mod media;
pub mod microfacet;
mod origin;
mod passes;
mod profile;
mod random;
mod reach;
mod response;
mod samples;
mod settings;
mod tiling;
mod tracer;
mod tree;

pub use cache::{Cache, CacheError, CacheTotals, RecordCost, Shared};
pub use cost::{
    Cost, RAY_NAMES, Rays, WORK_CLASSES, WorkByClass, WorkByRay, clocked, process_cpu_nanos, work,
};
pub use effects::Effects;
pub use fingerprint::tracer_version;
pub use image::{Image, ImageError, Totals, cost_color};
pub use origin::Origin;
pub use passes::{Grown, Passes, SoFar};
pub use profile::{Profile, ProfileError};
pub use reach::{Excluded, LeftOut, Reach, Reason, reachable};
pub use samples::{SampleCounts, SampleCountsError};
pub use settings::{CacheSettings, Integrator, MaterialOverride, Settings, SettingsError, UncoveredGathers};
pub use tiling::Tiling;
pub use tracer::{Pixel, PixelsFinished, Tracer};
pub use tree::Tree;

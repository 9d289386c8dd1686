//! Light transport: traces a frame, and counts the cost of doing so.
//!
//! A [`Tracer`] holds the tree, lights and materials of one frame. [`Tracer::pixel`] computes one finished
//! [`Pixel`]: its colour, rays by category, deterministic `work`, and CPU time. A pixel depends only on the
//! frame, the [`Settings`] and its own index. So an image has the same bits whatever the threads, tiles and
//! reused pixels of a [`Profile`].
//!
//! | file | subject |
//! | --- | --- |
//! | `settings` | quality and size of an image |
//! | `random` | counter-based random numbers, scrambled (0,2)-sequences |
//! | `bounds`, `geometry` | boxes, orthonormal frames, maps from the square to disc, hemisphere and cone |
//! | `fresnel`, `microfacet` | reflectance of interfaces, GGX |
//! | `response`, `bsdf` | reflection at a point, for light sampling; the full BSDF, for path tracing |
//! | `media` | solid dielectrics that overlap |
//! | `lights`, `environment` | light sources and how points and directions on them are sampled |
//! | `effects`, `kernel` | the effects that a frame needs, and the code composed for them |
//! | `integrator` | the integrators `ambient` and `path`, direct light, shadow rays |
//! | `cache` | indirect diffuse light by interpolation (irradiance cache): plan, fill, read |
//! | `reach` | lights and objects that cannot affect the image |
//! | `cost` | counters, work, clocks |
//! | `tree` | the BVH over the triangles that can affect the image |
//! | `tracer` | a frame, ready to be traced |
//! | `pixel`, `profile`, `image` | one finished pixel; finished pixels as a file; whole images |
//! | `tracer/beside` | what pixels show, for denoisers; other samples of them, to measure an error |
//! | `samples`, `passes` | camera samples that differ by pixel; images refined in passes |
//! | `fingerprint`, `origin` | what an image or a file was made for: as a hash, and in words |
//! | `tiling` | square tiles of an image |

mod bounds;
pub mod bsdf;
mod cache;
mod cost;
mod cryptomatte;
mod effects;
mod environment;
mod exr_file;
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
mod pixel;
mod pixel_file;
mod profile;
mod random;
mod reach;
mod response;
mod samples;
mod settings;
mod tiling;
mod tracer;
mod tree;
mod unfinished;

pub use cache::{Cache, CacheError, CacheTotals, RecordCost, Shared};
pub use cost::{
    Cost, RAY_NAMES, Rays, WORK_CLASSES, WorkByClass, WorkByRay, clocked, process_cpu_nanos, work,
};
pub use effects::Effects;
pub use fingerprint::tracer_version;
pub use image::{DenoisedColors, Image, ImageError, Totals};
pub use origin::Origin;
pub use passes::{Advanced, Grown, Passes, SoFar};
pub use pixel::{Coverage, Feature, Pixel, PixelsFinished};
pub use pixel_file::PixelFileError;
pub use profile::Profile;
pub use reach::{Excluded, LeftOut, Reach, Reason, reachable};
pub use samples::{SampleCounts, SampleCountsError};
pub use settings::{CacheSettings, Settings, UncoveredGathers};
pub use tiling::Tiling;
pub use tracer::{Tracer, Trees};
pub use tree::{Tree, TreeCost};
pub use unfinished::Unfinished;

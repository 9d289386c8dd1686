//! Radiance behind the renderer's door.
//!
//! A scene is a `.rif` file, whose octree is built here, or an octree with a view file beside it. Its views
//! are the frames of a shot; so are octrees whose names differ in a number. Radiance runs as processes of its
//! own: `vwrays` turns pixels into rays, and `rtrace` traces them.
//!
//! | file | subject |
//! | --- | --- |
//! | `installation` | finds Radiance, and starts its programs |
//! | `scene` | octrees and views of the frames, options and files |
//! | `rif` | what a `.rif` file says |
//! | `views` | views and view files |
//! | `shapes` | sizes of images that fit the views |
//! | `assets` | files that a scene refers to |
//! | `settings` | Radiance's own settings, and the options that they stand for |
//! | `rays` | rays of pixels |
//! | `tracer` | a running rtrace |
//! | `tree` | counts rays by kind, from the trees that rtrace prints |
//! | `ids` | surfaces and materials of pixels |
//! | `blocks` | the order of a frame's pixels |
//! | `image` | renders parts of a frame |
//! | `profile` | measures single pixels |
//! | `ambient` | values of indirect light that pixels share |
//! | `finished` | files of finished pixels and ambient values |
//! | `pictures` | image files |
//! | `opened` | what all questions about a scene share |
//! | `renderer` | the door: what Radiance can, and how it opens a scene |
//! | `shot` | the four questions of the door |
//!
//! # Costs
//! A cost is CPU time of these processes. What rtrace takes before its first ray is in `fixed` as `prepare`.
//! The time of a block of pixels is the CPU time of rtrace between two answers, as Linux accounts for it
//! (`/proc/PID/schedstat`).
//!
//! # Pixels that are taken over
//! A pixel does not depend on where its rays are traced, except through random numbers, whose sequence rtrace
//! begins once. Without random numbers (no indirect light, no jitter, no shadow threshold) an image with
//! pixels that were taken over has the bits of one that was rendered at once. With them, its pixels have
//! other noise, of the same distribution.

mod ambient;
mod assets;
mod blocks;
mod finished;
mod ids;
mod image;
mod installation;
mod opened;
mod pictures;
mod profile;
mod rays;
pub mod reading;
mod renderer;
mod rif;
mod scene;
mod settings;
mod shapes;
mod shot;
mod tracer;
mod tree;
mod views;

pub use installation::Radiance;

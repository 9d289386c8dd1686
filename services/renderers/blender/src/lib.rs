//! Blender Cycles behind the renderer's door.
//!
//! Blender runs as a process of its own: the program `blender` where it is installed, or else a Python that
//! has the module `bpy`. A driver script in it opens the file once and answers questions about it. Scripts of
//! the file are never run.
//!
//! | file | subject |
//! | --- | --- |
//! | `installation` | finds Blender, and starts it |
//! | `connection` | questions to the driver and its answers |
//! | `idle` | processes that wait for a question |
//! | `settings` | Cycles' own settings |
//! | `renderer` | the door: what Cycles can, and how it opens a scene |
//! | `shot` | the four questions of the door |
//! | `preview` | what frames show: drawn from triangles, or rendered by Cycles |
//! | `triangles` | the triangles that the driver hands out |
//! | `image` | multi-layer EXR files: ids, times, merging shares of the samples |
//! | `driver/` | the Python that runs inside Blender |
//!
//! # Costs
//! A cost is CPU time of the Blender process around a render. Cycles says when everything is prepared and
//! when all samples are done; what lies before and after is in `fixed` as `prepare` and `write`. From Blender 5.0
//! on, the time of each pixel tells where the cost goes: strata and blocks. It is wall time, so it tells how
//! the cost divides, not how large it is.
//!
//! # Previews
//! The driver hands out the triangles of a frame as they would be rendered: it is a render engine, since Blender tells
//! only those. Of the next frame it hands out what has changed. forelight draws them like its own previews.
//!
//! # Samples that are taken over
//! With the sampling pattern `TABULATED_SOBOL`, which is always set here, shares of the samples that are
//! weighted by their numbers add up to the image of one render, to the rounding of floats. That does not
//! hold with adaptive sampling, which decides on earlier samples, nor with denoising or compositing, which need the
//! whole image.

mod connection;
mod idle;
mod image;
mod installation;
mod preview;
mod renderer;
mod settings;
mod shot;
mod triangles;

pub use installation::Cycles;

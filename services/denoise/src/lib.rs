//! Denoising of finished images by Open Image Denoise, where it is installed.
//!
//! Its program `oidnDenoise` is started as other foreign programs are: without a shell, held to limits, ended
//! when the run is cancelled. Images go there and back as files.
//!
//! | file | subject |
//! | --- | --- |
//! | `denoiser` | finds the program, and runs it |
//! | `pfm` | its files |

mod denoiser;
mod pfm;

pub use denoiser::{Denoised, Denoiser, Layers, Trial};

//! Flags that several commands share.

use crate::quantities;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Image size and quality of light transport.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Image and quality")]
pub struct QualityOptions {
    /// Image width in pixels [default: the camera's, or what keeps its shape to --height]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub width: Option<u32>,
    /// Image height in pixels [default: the camera's, or what keeps its shape to --width]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub height: Option<u32>,
    /// Camera samples per pixel
    #[arg(long, value_name = "SAMPLES")]
    pub spp: Option<u32>,
    /// Diffuse bounces of indirect light; 0 is direct light only
    #[arg(long, value_name = "BOUNCES")]
    pub ambient_bounces: Option<u32>,
    /// Rays of one indirect gather
    #[arg(long, value_name = "RAYS")]
    pub ambient_divisions: Option<u32>,
    /// Longest chain of mirror and glass hits
    #[arg(long, value_name = "HITS")]
    pub max_depth: Option<u32>,
    /// Materials as they are, or every surface as Lambert of its base colour
    #[arg(long, value_name = "KIND")]
    pub materials: Option<Materials>,
    /// Seed of all random numbers: the same seed gives the same bits
    #[arg(long, value_name = "NUMBER")]
    pub seed: Option<u64>,
}

/// Which materials are rendered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Materials {
    /// The scene's own.
    Full,
    /// Every surface diffuse.
    Lambert,
}

/// How this machine does the work.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "This machine")]
pub struct MachineOptions {
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Who makes the ID preview
    #[arg(long, value_name = "WHO", default_value = "auto")]
    pub preview: PreviewBackend,
}

/// Who makes ID previews.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PreviewBackend {
    /// The GPU where there is one, otherwise the CPU.
    Auto,
    /// The GPU, or an error.
    Gpu,
    /// The CPU.
    Cpu,
}

/// Where the service is, and who asks.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Connection")]
pub struct ConnectionOptions {
    /// Address of the service
    #[arg(long, value_name = "URL", env = "FORELIGHT_SERVER", default_value = "http://127.0.0.1:7878")]
    pub server: String,
    /// File that holds the token
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,
    /// The token itself; better given by the variable than on the command line
    #[arg(long, value_name = "TOKEN", env = "FORELIGHT_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Data folder of a farm on this machine: its operator token is used
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
}

/// How sure the booking has to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ConfidenceLevel {
    /// As likely late as not.
    P50,
    /// Four times out of five in time.
    P80,
    /// Nineteen times out of twenty in time.
    P95,
}

/// A duration flag as the standard library's type.
pub fn duration(text: &str) -> Result<std::time::Duration, String> {
    quantities::parse_duration(text)?.try_into().map_err(|_| "the duration is too long".to_string())
}

/// Use of an irradiance cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum CacheMode {
    /// Every diffuse hit is gathered for itself.
    Off,
}

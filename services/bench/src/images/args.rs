use super::peer::Peer;
use super::quality::Quality;
use forelight_protocol::{MaterialMode, RenderSettings, RenderSettingsRequest};
use std::path::PathBuf;

/// Measure the cost of an image error: with an irradiance cache, without one, and in other programs
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench images kitchen/ --size 256 --references references/
  forelight bench images kitchen/ --rung '--spp 4 --ambient-divisions 64' --rung '--spp 4 --cache on' --pictures out/
  forelight bench images kitchen/ --rung '--spp 64 --cache on' --rung '--error 2 --cache on'
  forelight bench images kitchen/ --materials lambert --peer 'rpict 1:rpict-1.exr:93.4' --json

The rungs take turns, several times, and the CPU time is the median. Errors are root mean squares relative \
to the mean of the reference, over all pixels, and (`lit`) without pixels that see a light or are next to \
one. A rung with --error PERCENT instead of --spp allots camera samples as `forelight render --error` does; \
its cost includes finding the allotment. With --denoise, its noise is removed by Open Image Denoise, and its cost \
includes measuring the error that is left. The cost of an equal error is interpolated between the rungs worth \
taking, in logarithms.")]
pub struct Args {
    /// Scene bundles: folders or zip files
    #[arg(required = true, value_name = "BUNDLE")]
    pub bundles: Vec<PathBuf>,
    /// Frame number
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub frame: u32,
    /// Width and height of the images in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 512, value_parser = clap::value_parser!(u32).range(8..=8192))]
    pub size: u32,
    /// Diffuse bounces of indirect light
    #[arg(long, value_name = "BOUNCES", default_value_t = 1)]
    pub ambient_bounces: u32,
    /// Use materials as they are, or Lambert surfaces of their base colour
    #[arg(long, value_name = "KIND", default_value = "full")]
    pub materials: MaterialMode,
    /// Settings to measure, as flags of `forelight render`; may be repeated
    /// [default: a ladder from quick to good]
    #[arg(long, value_name = "FLAGS", allow_hyphen_values = true)]
    pub rung: Vec<Quality>,
    /// Settings of the converged image
    #[arg(
        long,
        value_name = "FLAGS",
        allow_hyphen_values = true,
        default_value = "--integrator path --spp 4096"
    )]
    pub reference: Quality,
    /// Gather rays of the reference for rungs of --gather-spp, on the same camera samples; 0 for none
    #[arg(long, value_name = "RAYS", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(0..=65_536))]
    pub gather_rays: u32,
    /// Camera samples per pixel of the rungs that use that reference
    #[arg(long, value_name = "SAMPLES", default_value_t = 4)]
    pub gather_spp: u32,
    /// Folder for converged images; existing ones are reused
    #[arg(long, value_name = "DIR")]
    pub references: Option<PathBuf>,
    /// Number of times to render every rung
    #[arg(long, value_name = "TIMES", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=99))]
    pub repeats: u32,
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Image of another program of the only bundle, its CPU time, and its own converged image as reference if
    /// given; may be repeated
    #[arg(long, value_name = "NAME:IMAGE:CPU_SECONDS[:REFERENCE]")]
    pub peer: Vec<Peer>,
    /// Folder for images, and for pictures of the difference that the cache makes: mid grey is none, black
    /// and white are -10 % and +10 % of the image's mean
    #[arg(long, value_name = "DIR")]
    pub pictures: Option<PathBuf>,
    /// Also write the measurements to this file as JSON
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print the measurements as JSON to standard output
    #[arg(long)]
    pub json: bool,
    /// Seed of all random numbers
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    pub seed: u64,
}

/// Settings common to all rungs.
pub fn base(args: &Args) -> RenderSettings {
    let size = (args.size, args.size);
    let materials = args.materials;
    RenderSettings {
        ambient_bounces: args.ambient_bounces,
        materials,
        seed: args.seed,
        ..RenderSettingsRequest::default().complete(size)
    }
}

//! The arguments of `forelight bench images`.

use super::peer::Peer;
use super::quality::Quality;
use forelight_protocol::{MaterialMode, RenderSettings, RenderSettingsRequest};
use std::path::PathBuf;

/// What an image error costs: with an irradiance cache, without one, and in other programs
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  forelight bench images kitchen/ --size 256 --references references/
  forelight bench images kitchen/ --rung '--spp 4 --ambient-divisions 64' --rung '--spp 4 --cache on' --pictures out/
  forelight bench images kitchen/ --rung '--spp 64 --cache on' --rung '--error 2 --cache on'
  forelight bench images kitchen/ --materials lambert --peer 'rpict 1:rpict-1.exr:93.4' --json

Every rung is rendered several times, one rung after the other and then again, and its CPU time is the median. Errors are root \
mean squares relative to the mean of the reference, over all pixels, and (`lit`) without those that see a light or lie beside one \
that does. A rung of --error PERCENT in place of --spp allots camera samples as `forelight render --error` does, what finding that out \
takes included. The cost of an equal error is interpolated along the rungs that are worth taking, in logarithms.")]
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
    /// Materials as they are, or every surface as Lambert of its base colour
    #[arg(long, value_name = "KIND", default_value = "full")]
    pub materials: MaterialMode,
    /// Settings to measure, as flags of `forelight render`; may be repeated [default: a ladder from quick to good]
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
    /// Rays of the gathers that rungs of --gather-spp are held against, on the same camera samples; 0 leaves that out
    #[arg(long, value_name = "RAYS", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(0..=65_536))]
    pub gather_rays: u32,
    /// Camera samples a pixel of the rungs that are compared so
    #[arg(long, value_name = "SAMPLES", default_value_t = 4)]
    pub gather_spp: u32,
    /// Folder where converged images are kept, and taken from if they are there
    #[arg(long, value_name = "DIR")]
    pub references: Option<PathBuf>,
    /// How often every rung is rendered
    #[arg(long, value_name = "TIMES", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=99))]
    pub repeats: u32,
    /// Threads that trace light [default: one per core]
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Another program's image of the (only) bundle, what it took, and the converged image that it is held against instead of ours;
    /// may be repeated
    #[arg(long, value_name = "NAME:IMAGE:CPU_SECONDS[:REFERENCE]")]
    pub peer: Vec<Peer>,
    /// Folder for the images, and for pictures of what the cache changes: mid grey where nothing, black and white at -10 % and
    /// +10 % of the image's mean
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

/// What all rungs have in common.
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

//! The time that a scattered pixel would take among its neighbours.
//!
//! A scattered pixel finds its tree, triangles and textures outside the processor's caches. In a render, its
//! neighbours have just used the same data. Its *work* is the same in both, its *time* is not: with some
//! hundred thousand triangles, scattered pixels of direct light take 1.6 to 1.9 times as long. (Sampled
//! simulation of processors has the same bias and remedy: functional warming, Wunderlich et al. 2003.)
//!
//! So some blocks of neighbours are traced too, each in one run. The first pixels of a block warm the caches,
//! the rest show the time per unit of work. Blocks are drawn in proportion to the work that their profiled
//! pixel represents, so the mean of their rates estimates that of the frame. All profiled times are scaled by
//! ```text
//! ρ = mean of the middle half of the blocks' (time / work)  /  ( Σ w_i time_i / Σ w_i work_i )
//! w_i = pixels that pixel i stands for
//! ```
//!
//! The neighbours are finished pixels, which the render takes over. The forecast of work ignores them.

use crate::frame::OwnFrame;
use forelight_forecast::Observation;
use forelight_forecast::accuracy::PixelNoise;
use forelight_renderer::{WARMING_SHARE, free_neighbours, middle_mean, proportional_sites, sites};
use forelight_tracer::Pixel;
use std::collections::BTreeSet;

/// Result of the neighbours.
pub struct Warmth {
    /// Factor on the time of scattered pixels, 1 if nothing could be measured.
    pub factor: f64,
    /// The neighbours, finished, with their noise.
    pub pixels: Vec<(u32, (Pixel, PixelNoise))>,
}

/// Traces neighbours of some profiled pixels, unless `stop` returns true. `counts` are the frame's pixels by
/// stratum. `profiled` are the pixels of `observations`, in the same order.
pub fn measure(
    ready: &OwnFrame<'_>,
    counts: &[u32],
    observations: &[Observation],
    profiled: &[(u32, Pixel)],
    stop: &(dyn Fn() -> bool + Sync),
) -> Option<Warmth> {
    let camera = &ready.frame().camera;
    let mut samples = vec![0u32; counts.len()];
    observations.iter().for_each(|o| samples[o.stratum as usize] += 1);
    let stands_for = |o: &Observation| {
        let stratum = o.stratum as usize;
        f64::from(counts[stratum]) / f64::from(samples[stratum])
    };
    let work: Vec<f64> = observations.iter().map(|o| stands_for(o) * o.cost.work as f64).collect();
    let time: f64 = observations.iter().map(|o| stands_for(o) * o.cost.cpu_nanos as f64).sum();
    let mut taken: BTreeSet<u32> = profiled.iter().map(|(pixel, _)| *pixel).collect();
    let mut runs = Vec::new();
    for site in proportional_sites(&work, sites(observations.len())) {
        let run = free_neighbours(profiled[site].0, camera.width, camera.height, &taken);
        taken.extend(&run);
        runs.push(run);
    }
    let traced = ready.trace_runs(&runs, stop)?;
    let warm = middle_mean(traced.iter().filter_map(|run| warm_rate(run)).collect());
    let scattered = time / work.iter().sum::<f64>();
    // There may be no blocks, or the clock may not have advanced.
    let factor = if warm > 0.0 && scattered > 0.0 { warm / scattered } else { 1.0 };
    let pixels = runs.into_iter().flatten().zip(traced.into_iter().flatten()).collect();
    Some(Warmth { factor, pixels })
}

/// Nanoseconds per unit of work of the later pixels of a run.
fn warm_rate(run: &[(Pixel, PixelNoise)]) -> Option<f64> {
    let measured = &run[(run.len() as f64 * WARMING_SHARE).round() as usize..];
    let work: u64 = measured.iter().map(|(pixel, _)| pixel.work).sum();
    let nanos: u64 = measured.iter().map(|(pixel, _)| pixel.cpu_nanos).sum();
    (work > 0).then(|| nanos as f64 / work as f64)
}

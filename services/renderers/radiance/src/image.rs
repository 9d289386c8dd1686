//! Renders groups of a frame's pixels, on as many processes as there are threads.

use crate::ambient::Ambient;
use crate::opened::Opened;
use crate::rays::{Rays, rays_of};
use crate::scene::SceneFrame;
use crate::settings::arguments;
use crate::tracer::{Colour, Tracer};
use forelight_renderer::door::{Cost, FixedCosts, Limits, RendererError, Run, Settings};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

/// Rays that vwrays makes at a time.
const AT_A_TIME: usize = 1 << 16;

/// Name of the cost before the first ray.
pub(crate) const PREPARE: &str = "prepare";

/// Groups of pixels that were rendered.
#[derive(Default)]
pub(crate) struct Traced {
    /// Index and value of each pixel, in the order of the groups.
    pub pixels: Vec<(u32, Colour)>,
    /// CPU time of each group, nanoseconds: that of rtrace.
    pub nanos: Vec<u64>,
    pub cost: Cost,
    /// CPU time before the first ray, nanoseconds.
    prepare: u64,
}

impl Traced {
    /// What does not depend on the pixels.
    pub fn fixed(&self) -> FixedCosts {
        FixedCosts::from([(PREPARE.to_owned(), self.prepare)])
    }

    fn add(&mut self, other: Self) {
        self.pixels.extend(other.pixels);
        self.nanos.extend(other.nanos);
        // Processes that run at the same time need their memory together.
        let memory = self.cost.peak_memory_bytes + other.cost.peak_memory_bytes;
        self.cost += &other.cost;
        self.cost.peak_memory_bytes = memory;
        self.prepare += other.prepare;
    }
}

/// Renders groups of pixels with some of their samples. Every process gets groups that follow each other.
pub(crate) fn trace(
    opened: &Opened,
    frame: &SceneFrame,
    settings: &Settings,
    groups: &[Vec<u32>],
    samples: Range<u32>,
    (ambient, run): (Option<&Ambient>, &Run<'_>),
) -> Result<Traced, RendererError> {
    let since = Instant::now();
    let processes = (run.limits.threads.max(1) as usize).min(groups.len().max(1));
    // Each process has its share of the memory.
    let memory_bytes = run.limits.memory_bytes.map(|bytes| bytes / processes as u64);
    let run = &Run { limits: Limits { memory_bytes, ..run.limits }, ..*run };
    let (done, failed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let all = groups.len();
    let one = Process { opened, frame, settings, samples, ambient, run, done: &done, all, failed: &failed };
    let mut traced = Traced::default();
    std::thread::scope(|scope| {
        let shares: Vec<_> = groups
            .chunks(groups.len().div_ceil(processes).max(1))
            .map(|share| {
                scope.spawn(|| one.trace(share).inspect_err(|_| failed.store(true, Ordering::Relaxed)))
            })
            .collect();
        // All are waited for: an error does not leave threads behind.
        let all: Vec<Result<Traced, RendererError>> = shares
            .into_iter()
            .map(|share| {
                share
                    .join()
                    .unwrap_or_else(|_| Err(RendererError::Failed("a thread of the render ended".to_owned())))
            })
            .collect();
        // Processes that stop because another failed count as cancelled.
        let (mut stopped, mut failed) = (None, None);
        for share in all {
            match share {
                Ok(share) => traced.add(share),
                Err(RendererError::Cancelled) => stopped = Some(RendererError::Cancelled),
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        failed.or(stopped).map_or(Ok(()), Err)
    })?;
    traced.cost.wall_nanos = u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX);
    Ok(traced)
}

/// What one process renders, but for its groups.
struct Process<'a> {
    opened: &'a Opened,
    frame: &'a SceneFrame,
    settings: &'a Settings,
    samples: Range<u32>,
    /// Values of indirect light that all processes share.
    ambient: Option<&'a Ambient>,
    run: &'a Run<'a>,
    /// Groups that are done, over all processes, of `all`.
    done: &'a AtomicUsize,
    all: usize,
    /// Whether one of the processes has failed.
    failed: &'a AtomicBool,
}

impl Process<'_> {
    fn trace(&self, groups: &[Vec<u32>]) -> Result<Traced, RendererError> {
        let (opened, run) = (self.opened, self.run);
        let mut arguments = opened.arguments(arguments(self.settings));
        arguments.extend(self.ambient.iter().flat_map(|ambient| ambient.arguments()));
        let mut tracer =
            Tracer::of_values(&opened.radiance, &opened.scene, &self.frame.octree, &arguments, run)?;
        let mut traced = Traced { prepare: tracer.warm(run)?.unwrap_or(0), ..Traced::default() };
        let mut before = traced.prepare;
        let mut rest = groups;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(self.at_a_time(rest));
            rest = later;
            let pixels: Vec<u32> = now.iter().flatten().copied().collect();
            let of = (&opened.radiance, &opened.scene, self.frame);
            let Rays { rays, cpu_nanos } =
                rays_of(of, &self.settings.common, &pixels, self.samples.clone(), run)?;
            traced.cost.cpu_nanos += cpu_nanos;
            let mut rays = rays.as_slice();
            for group in now {
                if self.failed.load(Ordering::Relaxed) {
                    return Err(RendererError::Cancelled);
                }
                let (own, others) = rays.split_at(group.len() * self.samples.len());
                rays = others;
                let values = tracer.values(own, run)?;
                let means = values.chunks(self.samples.len().max(1)).map(mean);
                traced.pixels.extend(group.iter().copied().zip(means));
                let after = tracer.cpu_nanos().unwrap_or(before);
                traced.nanos.push(after.saturating_sub(before));
                before = after;
                let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
                (run.progress)(done as f64 / self.all as f64);
            }
        }
        let finished = tracer.finish(run)?;
        traced.cost.cpu_nanos += finished.usage.cpu_nanos;
        traced.cost.peak_memory_bytes = finished.usage.peak_memory_bytes;
        Ok(traced)
    }

    /// Number of the first groups whose rays are made at a time.
    fn at_a_time(&self, groups: &[Vec<u32>]) -> usize {
        let mut rays = 0;
        let fits = |group: &&Vec<u32>| {
            rays += group.len() * self.samples.len();
            rays <= AT_A_TIME
        };
        groups.iter().take_while(fits).count().max(1)
    }
}

/// Mean of the values of a pixel's samples.
pub(crate) fn mean(values: &[Colour]) -> Colour {
    if let [only] = values {
        return *only;
    }
    let count = values.len().max(1) as f64;
    [0, 1, 2].map(|channel| {
        let sum: f64 = values.iter().map(|value| f64::from(value[channel])).sum();
        (sum / count) as f32
    })
}

#[cfg(test)]
mod tests {
    use super::mean;

    #[test]
    fn a_single_sample_is_the_pixel_and_several_are_averaged() {
        assert_eq!(mean(&[[0.1, 0.2, 0.3]]), [0.1, 0.2, 0.3]);
        assert_eq!(mean(&[[1.0, 0.0, 4.0], [3.0, 0.0, 5.0]]), [2.0, 0.0, 4.5]);
        assert_eq!(mean(&[]), [0.0; 3]);
    }
}

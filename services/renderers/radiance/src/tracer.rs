//! A running rtrace: rays in, values or names or trees of rays out.

use crate::installation::{MESSAGES, Radiance};
use crate::rays::{Ray, is_nothing};
use crate::scene::Scene;
use crate::tree::{Counter, Counts};
use forelight_renderer::door::{RendererError, Run};
use forelight_renderer::process::{Exchange, Finished, MOST_BYTES};
use std::path::Path;

/// Most rays of one question. One more, of direction zero, makes rtrace answer.
pub(crate) const MOST_RAYS: usize = MOST_BYTES / size_of::<Ray>() - 1;

/// A ray that begins outside of any scene, and leads away from it.
const AWAY: Ray = [1e8, 1e8, -1e8, 0.0, 0.0, -1.0];

/// Linear red, green and blue.
pub(crate) type Colour = [f32; 3];

/// Names of the surface that a ray meets first, of its modifier and its material. `None`: it meets nothing.
pub(crate) type Names = Option<[String; 3]>;

/// What rtrace writes for a ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Output {
    Values,
    Names,
    Trees,
}

impl Output {
    const fn arguments(self) -> [&'static str; 2] {
        match self {
            Output::Values => ["-fdf", "-ov"],
            Output::Names => ["-fda", "-osmM"],
            // A line `~` ends each tree; see `tree`.
            Output::Trees => ["-fda", "-o~TdnwM"],
        }
    }
}

/// A running rtrace.
pub(crate) struct Tracer {
    exchange: Exchange,
    output: Output,
}

impl Tracer {
    /// Traces rays for their values.
    pub fn of_values(
        radiance: &Radiance,
        scene: &Scene,
        octree: &Path,
        arguments: &[String],
        run: &Run<'_>,
    ) -> Result<Self, RendererError> {
        Self::start(radiance, scene, octree, arguments, Output::Values, run)
    }

    /// Finds what rays meet first.
    pub fn of_names(
        radiance: &Radiance,
        scene: &Scene,
        octree: &Path,
        run: &Run<'_>,
    ) -> Result<Self, RendererError> {
        Self::start(radiance, scene, octree, &[], Output::Names, run)
    }

    /// Traces rays for the rays that they cause.
    pub fn of_trees(
        radiance: &Radiance,
        scene: &Scene,
        octree: &Path,
        arguments: &[String],
        run: &Run<'_>,
    ) -> Result<Self, RendererError> {
        Self::start(radiance, scene, octree, arguments, Output::Trees, run)
    }

    fn start(
        radiance: &Radiance,
        scene: &Scene,
        octree: &Path,
        arguments: &[String],
        output: Output,
        run: &Run<'_>,
    ) -> Result<Self, RendererError> {
        let program = radiance
            .program("rtrace", &scene.folder, scene.home.path())
            .arg("-h-")
            .args(output.arguments())
            .args(arguments.iter().cloned())
            .arg(octree);
        Ok(Self { exchange: Exchange::start(&program, MESSAGES, run)?, output })
    }

    /// Traces a ray that meets no surface, and returns the CPU time since the start, nanoseconds. The first
    /// such ray waits until the scene is loaded.
    pub fn warm(&mut self, run: &Run<'_>) -> Result<Option<u64>, RendererError> {
        self.values(&[AWAY], run)?;
        Ok(self.cpu_nanos())
    }

    /// CPU time since its start, nanoseconds.
    pub fn cpu_nanos(&self) -> Option<u64> {
        self.exchange.cpu_nanos()
    }

    /// Values of rays, in their order.
    pub fn values(&mut self, rays: &[Ray], run: &Run<'_>) -> Result<Vec<Colour>, RendererError> {
        debug_assert_eq!(self.output, Output::Values);
        let mut all = vec![[0.0; 3]; rays.len()];
        for (question, answered) in questions(rays) {
            let expected = (answered.len() + 1) * size_of::<Colour>();
            let mut bytes = Vec::with_capacity(expected);
            self.exchange.ask(&question, run, &mut |more| {
                bytes.extend_from_slice(more);
                if bytes.len() > expected {
                    return Err(too_much());
                }
                Ok(bytes.len() == expected)
            })?;
            let (numbers, _) = bytes.as_chunks::<4>();
            let (colours, _) = numbers.as_chunks::<3>();
            for (&at, colour) in answered.iter().zip(colours) {
                all[at] = colour.map(f32::from_ne_bytes);
            }
        }
        Ok(all)
    }

    /// What rays meet first, in their order.
    pub fn names(&mut self, rays: &[Ray], run: &Run<'_>) -> Result<Vec<Names>, RendererError> {
        debug_assert_eq!(self.output, Output::Names);
        let mut all = vec![None; rays.len()];
        for (question, answered) in questions(rays) {
            let mut text = Vec::new();
            let mut lines = 0;
            self.exchange.ask(&question, run, &mut |more| {
                text.extend_from_slice(more);
                lines += more.iter().filter(|&&byte| byte == b'\n').count();
                if lines > answered.len() + 1 {
                    return Err(too_much());
                }
                Ok(lines == answered.len() + 1)
            })?;
            let text = String::from_utf8_lossy(&text);
            for (&at, line) in answered.iter().zip(text.lines()) {
                let mut words = line.split('\t');
                let mut word = || words.next().unwrap_or_default().to_owned();
                let names = [word(), word(), word()];
                all[at] = (names[0] != "*").then_some(names);
            }
        }
        Ok(all)
    }

    /// Numbers of rays that each of these rays causes, by kind, with itself.
    pub fn counts(
        &mut self,
        rays: &[Ray],
        counter: &Counter,
        run: &Run<'_>,
    ) -> Result<Vec<Counts>, RendererError> {
        debug_assert_eq!(self.output, Output::Trees);
        let mut all = vec![Counts::default(); rays.len()];
        for (question, answered) in questions(rays) {
            let mut reader = counter.reader();
            self.exchange.ask(&question, run, &mut |more| {
                reader.read(more).map_err(RendererError::Answer)?;
                if reader.trees().len() > answered.len() {
                    return Err(too_much());
                }
                // The ray that makes rtrace answer has a tree's end, and no tree.
                Ok(reader.ends() == answered.len() + 1)
            })?;
            for (&at, counts) in answered.iter().zip(reader.trees()) {
                all[at] = *counts;
            }
        }
        Ok(all)
    }

    /// Ends it, and says what it used.
    pub fn finish(self, run: &Run<'_>) -> Result<Finished, RendererError> {
        self.exchange.finish(run)
    }
}

fn too_much() -> RendererError {
    RendererError::Answer("rtrace wrote more than it was asked".to_owned())
}

/// Questions that ask for these rays, each with the places of the rays that are asked for. Those of nothing
/// are left out: a direction of zero means something else.
fn questions(rays: &[Ray]) -> impl Iterator<Item = (Vec<u8>, Vec<usize>)> {
    let asked: Vec<usize> = (0..rays.len()).filter(|&at| !is_nothing(&rays[at])).collect();
    let chunks: Vec<Vec<usize>> = asked.chunks(MOST_RAYS).map(<[usize]>::to_vec).collect();
    chunks.into_iter().map(|places| {
        let asked = places.iter().map(|&at| rays[at]).chain([[0.0; 6]]);
        (asked.flatten().flat_map(f64::to_ne_bytes).collect(), places)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn questions_fit_a_pipe_and_leave_nothing_out_but_rays_of_nothing() {
        let ray = |n: usize| [n as f64, 0.0, 0.0, 0.0, if n.is_multiple_of(3) { 0.0 } else { 1.0 }, 0.0];
        let rays: Vec<Ray> = (0..5000).map(ray).collect();
        let mut places = Vec::new();
        for (question, answered) in questions(&rays) {
            assert_eq!(question.len(), (answered.len() + 1) * 48);
            assert!(question.len() <= MOST_BYTES);
            assert!(question[question.len() - 48..].iter().all(|&byte| byte == 0));
            places.extend(answered);
        }
        assert!(places.into_iter().eq((0..5000).filter(|n| n % 3 != 0)));
        assert!(questions(&[[0.0; 6]]).next().is_none());
    }
}

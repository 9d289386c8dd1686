//! Work by class, to convert a frame's operations to seconds on other machines.

use crate::costs::by_class;
use crate::frame::OwnFrame;
use forelight_protocol::{ByClass, FixedCosts};

/// Work of a frame by class, including its plan and its own tree. `pixels` and `gathers` are the work of
/// pixels and records, which have the classes of what was traced so far. `None` if there is none, and if
/// other tasks traced all pixels or records.
pub fn of_frame(ready: &OwnFrame<'_>, pixels: f64, gathers: f64) -> Option<ByClass> {
    let (of_pixels, of_gathers) = ready.work_by_class();
    let unknown = |traced: ByClass, work: f64| work > 0.0 && traced.total() == 0;
    if unknown(of_pixels, pixels) || unknown(of_gathers, gathers) {
        return None;
    }
    let FixedCosts { build, plan, .. } = ready.fixed();
    // A plan is rays and traversal.
    let plan = by_class([0, plan.work, 0, 0, 0], ready.frame().geometry.triangles.len());
    let build = ByClass { build: build.work, ..ByClass::default() };
    let all = scaled(of_pixels, pixels).plus(scaled(of_gathers, gathers)).plus(plan).plus(build);
    (all.total() > 0).then_some(all)
}

/// The same classes, scaled to `total`. Running sums are rounded, so that the parts add up.
fn scaled(work: ByClass, total: f64) -> ByClass {
    let factor = total / (work.total() as f64).max(1.0);
    let (mut sum, mut given) = (0, 0);
    ByClass::from_array(work.to_array().map(|class| {
        sum += class;
        let before = std::mem::replace(&mut given, (sum as f64 * factor).round() as u64);
        given - before
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_the_scene_the_more_of_its_traversal_waits_for_memory() {
        let memory = |triangles| by_class([7, 1000, 5, 3, 2], triangles).memory;
        assert_eq!([0, 12, 8192, 65_536, 524_288, 10_000_000].map(memory), [0, 0, 0, 500, 1000, 1000]);
        assert_eq!(by_class([7, 1000, 5, 3, 2], 65_536).total(), 1017);
    }

    #[test]
    fn scaled_work_keeps_its_shares() {
        let work = ByClass { rays: 10, shading: 30, ..ByClass::default() };
        assert_eq!(scaled(work, 400.0), ByClass { rays: 100, shading: 300, ..ByClass::default() });
        assert_eq!(scaled(ByClass::default(), 400.0), ByClass::default());
        let thirds = ByClass { rays: 1, shading: 1, records: 1, ..ByClass::default() };
        assert_eq!([100.0, 101.0, 102.0].map(|total| scaled(thirds, total).total()), [100, 101, 102]);
    }
}

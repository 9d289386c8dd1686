//! Costs as the tracer counts them, in the terms of forecasts and of the wire.

use forelight_forecast::Cost;
use forelight_protocol::{ByClass, Spent};
use forelight_tracer::{Pixel, RecordCost, Shared, WorkByClass};

/// Cost of a pixel, for the forecast.
pub fn cost_of(pixel: &Pixel) -> Cost {
    Cost { work: pixel.work, cpu_nanos: pixel.cpu_nanos, rays: pixel.rays.map(u64::from) }
}

/// Cost of gathering a record, for the forecast.
pub fn cost_of_record(record: &RecordCost) -> Cost {
    cost_of_gather(record.cost, record.rays)
}

/// The same, from cost and rays by kind.
pub fn cost_of_gather(cost: forelight_tracer::Cost, rays: [u32; 7]) -> Cost {
    Cost { work: cost.work, cpu_nanos: cost.cpu_nanos, rays: rays.map(u64::from) }
}

/// A frame's own records by level, beyond the records of the shared cache that are valid in it.
pub fn own_records(all: &[u64], shared: &Shared) -> Vec<u64> {
    let kept = shared.kept.iter().copied().chain(std::iter::repeat(0));
    all.iter().zip(kept).map(|(&all, kept)| all.saturating_sub(kept)).collect()
}

/// Numbers of records as the wire has them.
pub fn counts(records: Vec<u64>) -> Vec<u32> {
    // A plan has fewer than 2³² rays, and fewer records than that.
    records.into_iter().map(|count| u32::try_from(count).unwrap_or(u32::MAX)).collect()
}

/// Cost of a pixel, as protocol data.
pub fn spent_on(pixel: &Pixel) -> Spent {
    Spent { work: pixel.work, cpu_nanos: pixel.cpu_nanos }
}

/// A cost of the tracer, as protocol data.
pub fn spent(cost: forelight_tracer::Cost) -> Spent {
    Spent { work: cost.work, cpu_nanos: cost.cpu_nanos }
}

/// Nanoseconds as seconds.
pub fn seconds(nanos: u64) -> f64 {
    nanos as f64 * 1e-9
}

/// Numbers of triangles that fit entirely, or hardly at all, into a core's caches. In between, the share of
/// traversal that waits for memory grows with the logarithm of the number.
const CACHED: f64 = 8192.0;
const UNCACHED: f64 = 524_288.0;

/// Classes of the tracer's work in a scene of this many triangles.
pub fn by_class([rays, traversal, shading, texture, records]: WorkByClass, triangles: usize) -> ByClass {
    let share = ((triangles as f64 / CACHED).ln() / (UNCACHED / CACHED).ln()).clamp(0.0, 1.0);
    let memory = (traversal as f64 * share).round() as u64;
    ByClass { rays, traversal: traversal - memory, memory, shading, texture, records, build: 0 }
}

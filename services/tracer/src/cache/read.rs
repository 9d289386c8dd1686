//! Read: interpolates between the records around a point.

use super::record::Value;
use super::{Cache, READ_RELAXED, Site};
use glam::Vec3;

impl Cache {
    /// Irradiance at a site from the records of a level, in W/m² per channel, and the number of records
    /// considered. `None` if no record covers the site. Records that are not filled count as black, so that
    /// the cost of reading can be measured before the fill.
    ///
    /// E = Σ wᵢ (Eᵢ + (nᵢ × n)·∇ᵣEᵢ + (p − pᵢ)·∇ₜEᵢ) / Σ wᵢ (Ward and Heckbert 1992). The weights fall to 0
    /// where a record's error reaches the allowed one.
    pub fn read(&self, level: usize, place: &Site) -> (Option<Vec3>, u64) {
        let here = &self.levels[level];
        let allowed = here.accuracy * READ_RELAXED;
        let smoothed = here.smoothed.get();
        let (mut sum, mut weights, mut looked_at) = (Vec3::ZERO, 0.0f32, 0);
        for index in here.index.around(place, |count| looked_at += count) {
            let planned = &here.planned[index as usize];
            let Some(error) = planned.error(place, allowed) else { continue };
            let gathered = || here.records[index as usize].get().map(Value::of);
            let value = smoothed.map_or_else(gathered, |smoothed| Some(smoothed.values[index as usize]));
            let Some(record) = value else {
                weights += 1.0;
                continue;
            };
            if record.rejected {
                continue;
            }
            let difference = place.position - planned.site.position;
            let turn = planned.site.normal.cross(place.normal);
            // Where the irradiance changes quickly, distant records get lower weights.
            let trusted = error + difference.length() * (1.0 / record.trusted - 1.0 / planned.radius);
            let weight = (1.0 - error / allowed) * (1.0 - trusted / allowed).max(1e-3);
            sum += weight * record.at(difference, turn);
            weights += weight;
        }
        ((weights > 0.0).then(|| sum / weights), looked_at)
    }
}

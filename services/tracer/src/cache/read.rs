//! Read: interpolates between the records around a point, or takes one of them.

use super::record::{Planned, Value};
use super::{Cache, Level, Site};
use glam::Vec3;

impl Level {
    /// The value of a record. `None` if it is not filled.
    fn value(&self, index: u32) -> Option<Value> {
        match self.smoothed.get() {
            Some(smoothed) => Some(smoothed.values[index as usize]),
            None => self.records[index as usize].get().map(Value::of),
        }
    }
}

impl Cache {
    /// Irradiance at a site from the records of a level, in W/m² per channel, and the number of records
    /// considered. `None` if no record covers the site. Records that are not filled count as black, so that
    /// the cost of reading can be measured before the fill.
    ///
    /// E = Σ wᵢ (Eᵢ + (nᵢ × n)·∇ᵣEᵢ + (p − pᵢ)·∇ₜEᵢ) / Σ wᵢ (Ward and Heckbert 1992). The weights fall to 0
    /// where a record's error reaches the allowed one.
    pub fn read(&self, level: usize, place: &Site) -> (Option<Vec3>, u64) {
        let here = &self.levels[level];
        let allowed = here.allowed();
        let (mut sum, mut weights, mut looked_at) = (Vec3::ZERO, 0.0f32, 0);
        for index in here.index.around(place, |count| looked_at += count) {
            let planned = &here.planned[index as usize];
            let Some(error) = planned.error(place, allowed) else { continue };
            let Some(record) = here.value(index) else {
                weights += 1.0;
                continue;
            };
            if record.rejected {
                continue;
            }
            let trusted = trusted_error(planned, &record, place, error);
            let weight = (1.0 - error / allowed) * (1.0 - trusted / allowed).max(1e-3);
            sum += weight * carried(planned, &record, place);
            weights += weight;
        }
        ((weights > 0.0).then(|| sum / weights), looked_at)
    }

    /// The same from the record with the least error. A ray of a gather needs no more, because many of them are
    /// averaged. Any record would not do: the first ones found are those of open places, which are brighter.
    pub fn read_one(&self, level: usize, place: &Site) -> (Option<Vec3>, u64) {
        let here = &self.levels[level];
        let allowed = here.allowed();
        let (mut best, mut least, mut looked_at) = (None, f32::INFINITY, 0);
        for index in here.index.around(place, |count| looked_at += count) {
            let planned = &here.planned[index as usize];
            let Some(error) = planned.error(place, allowed) else { continue };
            let value = here.value(index);
            if value.is_some_and(|value| value.rejected) {
                continue;
            }
            let trusted = value.map_or(error, |value| trusted_error(planned, &value, place, error));
            if trusted < least {
                (best, least) = (Some((planned, value)), trusted);
            }
        }
        let found =
            best.map(|(planned, value)| value.map_or(Vec3::ZERO, |value| carried(planned, &value, place)));
        (found, looked_at)
    }
}

/// The error of a record at a site, raised where its irradiance changes quickly.
fn trusted_error(planned: &Planned, record: &Value, place: &Site, error: f32) -> f32 {
    let distance = place.position.distance(planned.site.position);
    error + distance * (1.0 / record.trusted - 1.0 / planned.radius)
}

/// The irradiance at a site by a record with this value.
fn carried(planned: &Planned, record: &Value, place: &Site) -> Vec3 {
    record.at(place.position - planned.site.position, planned.site.normal.cross(place.normal))
}

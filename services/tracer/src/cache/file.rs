//! The cache's file format.
//!
//! Numbers are little-endian, and all arrays start at multiples of eight bytes:
//!
//! | part | bytes |
//! | --- | --- |
//! | header | see [`Header`] |
//! | fingerprints of the images that it was planned for | 32 each |
//! | per level: header, secondary lights, planned rows, record rows | see [`LevelHeader`], [`SecondaryRow`], [`PlannedRow`], [`RecordRow`] |
//! | BLAKE3 hash of everything before | 32 |

use super::hemisphere::{PLAN_RAYS, SECTORS, Strata};
use super::record::{Planned, Record, Value};
use super::secondary::{Cell, PARTS, SecondaryLight, SecondaryLights};
use super::{Cache, CacheError, Level, Site};
use crate::bounds::Bounds;
use crate::cost::{Cost, clocked};
use crate::origin::Origin;
use crate::tracer::Tracer;
use bytemuck::{AnyBitPattern, NoUninit, Pod, Zeroable};
use forelight_bvh::Hit;
use glam::Vec3;
use std::sync::OnceLock;

pub const MAGIC: [u8; 8] = *b"FLcach10";

/// A gather has at most this many strata; see [`crate::Settings::validate`].
const MOST_RAYS: u32 = 66_000;

const CHECKSUM: usize = 32;

/// Triangle index of a ray that hit nothing.
const NOTHING: u32 = u32::MAX;

const FILLED: u32 = 1;
const REJECTED: u32 = 2;
const SMOOTHED: u32 = 4;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Header {
    magic: [u8; 8],
    fingerprint: [u8; 32],
    origin: Origin,
    plan_work: u64,
    plan_nanos: u64,
    plan_rays: [u64; 7],
    images: u32,
    levels: u32,
    low: [f32; 3],
    high: [f32; 3],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct LevelHeader {
    records: u64,
    explored: u64,
    /// Records of a shared cache that are valid here, and that are not.
    shared: [u64; 2],
    accuracy: f32,
    smallest: f32,
    largest: f32,
    rays: u32,
    brightness: f32,
    /// Number of secondary lights.
    secondary: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct SecondaryRow {
    triangle: u32,
    cuts: u32,
    number: u32,
    back: u32,
    parts: [f32; PARTS],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct PlannedRow {
    key: u64,
    position: [f32; 3],
    size: f32,
    normal: [f32; 3],
    geometric: [f32; 3],
    coat: f32,
    radius: f32,
    corral: [f32; SECTORS],
    hits: [HitRow; PLAN_RAYS],
    lit: [f32; PLAN_RAYS],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct HitRow {
    triangle: u32,
    u: f32,
    v: f32,
    t: f32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct RecordRow {
    work: u64,
    nanos: u64,
    gathered: LightRow,
    smoothed: LightRow,
    trusted: f32,
    noise: f32,
    flags: u32,
    rays: [u32; 7],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct LightRow {
    irradiance: [f32; 3],
    rotation: [[f32; 3]; 3],
    translation: [[f32; 3]; 3],
}

impl Cache {
    /// Serialises the cache.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        put(
            &mut out,
            &Header {
                magic: MAGIC,
                fingerprint: self.fingerprint,
                origin: self.origin,
                plan_work: self.plan.work,
                plan_nanos: self.plan.cpu_nanos,
                plan_rays: self.plan_rays,
                images: self.images.len() as u32,
                levels: self.levels.len() as u32,
                low: self.world.low.to_array(),
                high: self.world.high.to_array(),
            },
        );
        self.images.iter().for_each(|image| out.extend_from_slice(image));
        for (number, level) in self.levels.iter().enumerate() {
            let shared = |counts: &[u64]| counts.get(number).copied().unwrap_or(0);
            put(
                &mut out,
                &LevelHeader {
                    records: level.planned.len() as u64,
                    explored: level.explored as u64,
                    shared: [shared(&self.shared.kept), shared(&self.shared.dropped)],
                    accuracy: level.accuracy,
                    smallest: level.smallest,
                    largest: level.largest,
                    rays: level.strata.len() as u32,
                    brightness: level.brightness,
                    secondary: level.secondary.all().len() as u32,
                },
            );
            level.secondary.all().iter().for_each(|light| put(&mut out, &secondary_row(light)));
            level.planned.iter().for_each(|planned| put(&mut out, &planned_row(planned)));
            for (record, known) in level.records.iter().zip(level.known_values()) {
                put(&mut out, &record_row(record.get(), known));
            }
        }
        let checksum = blake3::hash(&out);
        out.extend_from_slice(checksum.as_bytes());
        out
    }

    /// Parses the output of [`Self::to_bytes`]. Fails if the bytes are not a cache of this version, have the
    /// wrong length, or are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CacheError> {
        let (cache, reading) = clocked(|| Self::read_from(bytes));
        Ok(Self { reading, ..cache? })
    }

    fn read_from(bytes: &[u8]) -> Result<Self, CacheError> {
        if bytes.len() < MAGIC.len() || bytes[..MAGIC.len()] != MAGIC {
            return Err(CacheError::Foreign);
        }
        let Some((body, checksum)) = bytes.split_last_chunk::<CHECKSUM>() else {
            return Err(too_short(bytes.len(), (size_of::<Header>() + CHECKSUM) as u64));
        };
        let mut reader = Reader { rest: body, read: 0, all: bytes.len() };
        let header: Header = reader.take()?;
        let mut cache = Self {
            fingerprint: header.fingerprint,
            origin: header.origin,
            plan: Cost { work: header.plan_work, cpu_nanos: header.plan_nanos },
            plan_rays: header.plan_rays,
            images: reader.list(u64::from(header.images))?,
            world: Bounds { low: header.low.into(), high: header.high.into() },
            ..Self::default()
        };
        let sized = cache.world.low.is_finite() && cache.world.high.is_finite();
        if header.levels > 8 || !(sized || cache.world == Bounds::EMPTY) {
            return Err(CacheError::Damaged("a value in its header is out of range"));
        }
        for _ in 0..header.levels {
            let (level, [kept, dropped]) = read_level(&mut reader)?;
            cache.levels.push(level);
            cache.shared.kept.push(kept);
            cache.shared.dropped.push(dropped);
        }
        if !reader.rest.is_empty() {
            return Err(too_short(bytes.len(), (reader.read + CHECKSUM) as u64));
        }
        // Hashing takes longer than finding a wrong length, so it comes last.
        if blake3::hash(body).as_bytes() != checksum {
            return Err(CacheError::Damaged("the checksum does not match"));
        }
        for (depth, level) in cache.levels.iter_mut().enumerate() {
            level.is_first = depth == 0;
            if depth > 0 && !level.secondary.is_empty() {
                return Err(CacheError::Damaged("a secondary light belongs to the first level"));
            }
            level.prepare(cache.world);
        }
        Ok(cache)
    }

    /// Checks that the cache fits this frame: same scene, light and settings, and no missing triangle. The
    /// error says what differs.
    pub fn check(&self, tracer: &Tracer) -> Result<(), CacheError> {
        if !self.suits(tracer) {
            return Err(CacheError::OtherScene(self.origin.unlike_light(&tracer.origin())));
        }
        let planned = !(self.levels.is_empty() && self.images.is_empty());
        if planned && self.levels.len() != tracer.settings.ambient_bounces as usize {
            return Err(CacheError::Damaged("its number of levels differs from the number of bounces"));
        }
        let triangles = tracer.frame.geometry.triangles.len();
        let exists =
            |planned: &Planned| planned.hits.iter().flatten().all(|hit| (hit.primitive as usize) < triangles);
        let mut lights = self.levels.iter().flat_map(|level| level.secondary.all());
        if !self.levels.iter().flat_map(|level| &level.planned).all(exists)
            || lights.any(|light| light.cell.triangle as usize >= triangles)
        {
            return Err(CacheError::Damaged("a record refers to a triangle that the scene does not have"));
        }
        Ok(())
    }

    /// Takes over the filled records of another part of the same plan; fails if the plans differ. Levels that
    /// become full must then be smoothed; see [`Self::smooth_full`].
    pub fn merge(&mut self, other: &Self) -> Result<(), CacheError> {
        let same =
            |(a, b): (&Level, &Level)| a.planned == b.planned && a.secondary.all() == b.secondary.all();
        if self.fingerprint != other.fingerprint
            || self.levels.len() != other.levels.len()
            || !self.levels.iter().zip(&other.levels).all(same)
        {
            return Err(CacheError::OtherPlan);
        }
        for (level, other) in self.levels.iter_mut().zip(&other.levels) {
            let known = level.known_values().into_iter().zip(other.known_values());
            level.known = known.map(|(own, other)| own.or(other)).collect();
            level.smoothed = OnceLock::new();
            for (record, other) in level.records.iter_mut().zip(&other.records) {
                if let (None, Some(other)) = (record.get(), other.get()) {
                    *record = OnceLock::from(*other);
                }
            }
        }
        Ok(())
    }
}

/// A level, and its records of a shared cache: taken over, and not valid.
fn read_level(reader: &mut Reader<'_>) -> Result<(Level, [u64; 2]), CacheError> {
    let header: LevelHeader = reader.take()?;
    let secondary: Vec<SecondaryRow> = reader.list(u64::from(header.secondary))?;
    let planned: Vec<PlannedRow> = reader.list(header.records)?;
    let records: Vec<RecordRow> = reader.list(header.records)?;
    let lengths = [header.accuracy, header.smallest, header.largest];
    let ordered = lengths.iter().all(|n| n.is_finite() && *n >= 0.0) && header.smallest <= header.largest;
    let positive = lengths.iter().all(|n| *n > 0.0);
    let strata = Strata::for_rays(header.rays.min(MOST_RAYS));
    if header.explored > header.records
        || header.shared[0] > header.records
        || !(ordered && (positive || planned.is_empty()))
        || strata.len() != header.rays as usize
        || !(header.brightness.is_finite() && header.brightness >= 0.0)
    {
        return Err(CacheError::Damaged("a value in the header of a level is out of range"));
    }
    let secondary = secondary.iter().map(secondary_of).collect::<Option<Vec<_>>>();
    let secondary = secondary.and_then(SecondaryLights::of);
    let secondary = secondary.ok_or(CacheError::Damaged("a secondary light is out of range"))?;
    let planned: Option<Vec<Planned>> = planned.iter().map(planned_of).collect();
    let planned = planned.ok_or(CacheError::Damaged("a value in a record is out of range"))?;
    let gathered: Vec<Option<Record>> = records.iter().map(record_of).collect();
    let known = records.iter().zip(&gathered).map(|(row, record)| value_of(row, record.as_ref()?)).collect();
    let filled = |record: Option<Record>| record.map_or_else(OnceLock::new, OnceLock::from);
    let level = Level {
        strata,
        records: gathered.into_iter().map(filled).collect(),
        known,
        planned,
        explored: header.explored as usize,
        accuracy: header.accuracy,
        smallest: header.smallest,
        largest: header.largest,
        brightness: header.brightness,
        secondary,
        ..Level::default()
    };
    Ok((level, header.shared))
}

fn secondary_row(light: &SecondaryLight) -> SecondaryRow {
    let Cell { triangle, cuts, number, back } = light.cell;
    SecondaryRow { triangle, cuts, number, back: back.into(), parts: light.parts }
}

/// `None` if a value is out of range.
fn secondary_of(row: &SecondaryRow) -> Option<SecondaryLight> {
    let &SecondaryRow { triangle, cuts, number, back, parts } = row;
    let cell = Cell { triangle, cuts, number, back: back == 1 };
    let light = SecondaryLight { cell, parts };
    (back <= 1 && light.is_valid()).then_some(light)
}

fn planned_row(planned: &Planned) -> PlannedRow {
    let Site { position, size, normal, geometric, coat } = planned.site;
    let nothing = HitRow { triangle: NOTHING, u: 0.0, v: 0.0, t: 0.0 };
    PlannedRow {
        key: planned.key,
        position: position.to_array(),
        size,
        normal: normal.to_array(),
        geometric: geometric.to_array(),
        coat,
        radius: planned.radius,
        corral: planned.corral,
        lit: *planned.lit,
        hits: planned
            .hits
            .map(|hit| hit.map_or(nothing, |h| HitRow { triangle: h.primitive, u: h.u, v: h.v, t: h.t })),
    }
}

/// `None` if a value is out of range and could do harm.
fn planned_of(row: &PlannedRow) -> Option<Planned> {
    let site = Site {
        position: row.position.into(),
        size: row.size,
        normal: row.normal.into(),
        geometric: row.geometric.into(),
        coat: row.coat,
    };
    let finite = site.position.is_finite()
        && site.size.is_finite()
        && site.geometric.is_finite()
        && site.coat.is_finite();
    let radius = row.radius.is_finite() && row.radius > 0.0;
    let corral = row.corral.iter().all(|distance| *distance >= 0.0);
    let hits = row.hits.iter().all(|h| [h.u, h.v, h.t].iter().all(|n| n.is_finite()));
    let lit = row.lit.iter().all(|radiance| (0.0..=Planned::BRIGHTEST).contains(radiance));
    (finite && site.normal.is_normalized() && radius && corral && hits && lit).then(|| Planned {
        key: row.key,
        site,
        radius: row.radius,
        corral: row.corral,
        hits: Box::new(row.hits.map(|h| {
            (h.triangle != NOTHING).then_some(Hit { primitive: h.triangle, u: h.u, v: h.v, t: h.t })
        })),
        lit: Box::new(row.lit),
    })
}

fn record_row(record: Option<&Record>, known: Option<Value>) -> RecordRow {
    let Some(record) = record else { return RecordRow::zeroed() };
    let flag = |flag: u32, is_set: bool| if is_set { flag } else { 0 };
    RecordRow {
        work: record.cost.work,
        nanos: record.cost.cpu_nanos,
        gathered: light_row(&Value::of(record)),
        smoothed: known.as_ref().map_or_else(LightRow::zeroed, light_row),
        trusted: record.trusted,
        noise: record.noise,
        flags: FILLED | flag(REJECTED, record.rejected) | flag(SMOOTHED, known.is_some()),
        rays: record.rays,
    }
}

fn light_row(value: &Value) -> LightRow {
    LightRow {
        irradiance: value.irradiance.to_array(),
        rotation: value.rotation.map(|gradient| gradient.to_array()),
        translation: value.translation.map(|gradient| gradient.to_array()),
    }
}

fn record_of(row: &RecordRow) -> Option<Record> {
    let mut record = Record {
        irradiance: row.gathered.irradiance.into(),
        rotation: row.gathered.rotation.map(Vec3::from),
        translation: row.gathered.translation.map(Vec3::from),
        trusted: row.trusted,
        noise: row.noise,
        rejected: row.flags & REJECTED != 0,
        cost: Cost { work: row.work, cpu_nanos: row.nanos },
        rays: row.rays,
    };
    record.rejected |= !(record.is_finite() && record.trusted > 0.0);
    (row.flags & FILLED != 0).then_some(record)
}

/// `None` if the record is not smoothed or not finite. It is then smoothed again.
fn value_of(row: &RecordRow, record: &Record) -> Option<Value> {
    let LightRow { irradiance, rotation, translation } = row.smoothed;
    let value = Value {
        irradiance: irradiance.into(),
        rotation: rotation.map(Vec3::from),
        translation: translation.map(Vec3::from),
        ..Value::of(record)
    };
    (row.flags & SMOOTHED != 0 && value.is_finite()).then_some(value)
}

fn put(out: &mut Vec<u8>, row: &impl NoUninit) {
    out.extend_from_slice(bytemuck::bytes_of(row));
}

fn too_short(found: usize, expected: u64) -> CacheError {
    CacheError::Length { found: found as u64, expected }
}

/// Reads rows, with bounds checks.
struct Reader<'a> {
    rest: &'a [u8],
    read: usize,
    all: usize,
}

impl Reader<'_> {
    fn take<T: AnyBitPattern>(&mut self) -> Result<T, CacheError> {
        self.require(1, size_of::<T>())?;
        let (head, rest) = self.rest.split_at(size_of::<T>());
        (self.rest, self.read) = (rest, self.read + size_of::<T>());
        Ok(bytemuck::pod_read_unaligned(head))
    }

    fn list<T: AnyBitPattern>(&mut self, count: u64) -> Result<Vec<T>, CacheError> {
        self.require(count, size_of::<T>())?;
        (0..count).map(|_| self.take()).collect()
    }

    /// Checks the remaining length before anything is allocated.
    fn require(&self, count: u64, size: usize) -> Result<(), CacheError> {
        let wanted = count.saturating_mul(size as u64);
        if wanted <= self.rest.len() as u64 {
            return Ok(());
        }
        Err(too_short(self.all, wanted.saturating_add((self.read + CHECKSUM) as u64)))
    }
}

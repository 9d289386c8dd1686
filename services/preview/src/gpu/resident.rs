//! The scene on the device. It is kept from frame to frame, and only what changes is uploaded.

use super::device::Device;
use crate::error::PreviewError;
use crate::visible::{Cutouts, Drawn, near_distance};
use forelight_scene::{Frame, Geometry, Texels, Texture};
use std::sync::Arc;
use wgpu::BufferUsages;

/// A stratum's cut-out as the shader reads it (`Cutout` in `visibility.wgsl`).
#[repr(C)]
#[derive(Clone, Copy, Default, bytemuck::Pod, bytemuck::Zeroable)]
struct CutoutEntry {
    offset: u32,
    width: u32,
    height: u32,
    cutoff: f32,
}

/// A buffer that is overwritten if the new content has the same size, and replaced otherwise.
struct Slot {
    label: &'static str,
    usage: BufferUsages,
    buffer: wgpu::Buffer,
}

impl Slot {
    /// Size of a buffer without content, in bytes. An empty list still needs a buffer to bind.
    const SMALLEST: u64 = 16;

    fn new(device: &Device, label: &'static str, usage: BufferUsages) -> Self {
        let usage = usage | BufferUsages::COPY_DST;
        Self { label, usage, buffer: device.buffer(label, Self::SMALLEST, usage) }
    }

    /// Writes `bytes` to the buffer. Their number must be a multiple of four.
    fn fill(&mut self, device: &Device, bytes: &[u8]) -> Result<(), PreviewError> {
        let (size, limit) = ((bytes.len() as u64).max(Self::SMALLEST), device.most_bytes());
        if size > limit {
            return Err(PreviewError::DoesNotFit { what: self.label, bytes: size, limit });
        }
        if self.buffer.size() != size {
            self.buffer = device.buffer(self.label, size, self.usage);
        }
        device.queue.write_buffer(&self.buffer, 0, bytes);
        Ok(())
    }
}

/// Buffers with the scene of the last frame.
pub(crate) struct Resident {
    positions: Slot,
    uvs: Slot,
    indices: Slot,
    strata: Slot,
    cutouts: Slot,
    alphas: Slot,
    /// What the buffers hold. The reference counts keep the addresses from being reused by another geometry.
    state: Option<State>,
}

struct State {
    geometry: Arc<Geometry>,
    textures: Arc<[Texture]>,
    rules: Cutouts,
    near: f32,
}

/// The buffers of a scene that is ready to draw.
pub(crate) struct Drawable<'a> {
    pub positions: &'a wgpu::Buffer,
    pub uvs: &'a wgpu::Buffer,
    pub indices: &'a wgpu::Buffer,
    pub strata: &'a wgpu::Buffer,
    pub cutouts: &'a wgpu::Buffer,
    pub alphas: &'a wgpu::Buffer,
    /// Number of indices to draw.
    pub index_count: u32,
    /// Whether a texture cuts out any stratum.
    pub masked: bool,
    /// Near distance in metres.
    pub near: f32,
}

impl Resident {
    pub fn new(device: &Device) -> Self {
        Self {
            positions: Slot::new(device, "positions", BufferUsages::VERTEX),
            uvs: Slot::new(device, "texture coordinates", BufferUsages::VERTEX),
            indices: Slot::new(device, "triangles", BufferUsages::INDEX),
            strata: Slot::new(device, "strata of the triangles", BufferUsages::STORAGE),
            cutouts: Slot::new(device, "cut-outs", BufferUsages::STORAGE),
            alphas: Slot::new(device, "alpha channels", BufferUsages::STORAGE),
            state: None,
        }
    }

    /// Uploads what changed since the last frame. `None` if there is nothing to draw.
    pub fn update(&mut self, device: &Device, frame: &Frame) -> Result<Option<Drawable<'_>>, PreviewError> {
        let geometry = &frame.geometry;
        let Some(index_count) = u32::try_from(geometry.triangles.len() * 3).ok().filter(|n| *n < u32::MAX)
        else {
            let (bytes, limit) = (geometry.triangles.len() as u64 * 12, u64::from(u32::MAX) * 4);
            return Err(PreviewError::DoesNotFit { what: "triangles", bytes, limit });
        };
        if index_count == 0 {
            return Ok(None);
        }
        let rules = Cutouts::of(frame);
        // Taken out, so that after a failure nothing is assumed about the buffers.
        let before = self.state.take();
        let old = before.as_ref().filter(|state| Arc::ptr_eq(&state.geometry, geometry));
        let near = match old {
            Some(state) => state.near,
            None => near_distance(geometry),
        };
        if old.is_none() {
            self.upload_geometry(device, geometry, before.as_ref().map(|state| &*state.geometry))?;
        }
        let same_topology = old.is_some()
            || before.as_ref().is_some_and(|state| {
                state.geometry.triangles == geometry.triangles
                    && state.geometry.triangle_stratum == geometry.triangle_stratum
            });
        if !same_topology || before.as_ref().is_some_and(|state| state.rules != rules) {
            self.upload_indices(device, geometry, &rules)?;
        }
        let same_masks = before
            .as_ref()
            .is_some_and(|state| Arc::ptr_eq(&state.textures, &frame.textures) && state.rules == rules);
        if !same_masks {
            self.upload_masks(device, frame, &rules)?;
        }
        let masked = rules.by_stratum.iter().any(|drawn| matches!(drawn, Drawn::Where { .. }));
        self.state = Some(State {
            geometry: Arc::clone(geometry),
            textures: Arc::clone(&frame.textures),
            rules,
            near,
        });
        Ok(Some(Drawable {
            positions: &self.positions.buffer,
            uvs: &self.uvs.buffer,
            indices: &self.indices.buffer,
            strata: &self.strata.buffer,
            cutouts: &self.cutouts.buffer,
            alphas: &self.alphas.buffer,
            index_count,
            masked,
            near,
        }))
    }

    fn upload_geometry(
        &mut self,
        device: &Device,
        geometry: &Geometry,
        before: Option<&Geometry>,
    ) -> Result<(), PreviewError> {
        self.positions.fill(device, bytemuck::cast_slice(&geometry.positions))?;
        if before.is_none_or(|old| old.uvs != geometry.uvs) {
            self.uvs.fill(device, bytemuck::cast_slice(&geometry.uvs))?;
        }
        if before.is_none_or(|old| old.triangle_stratum != geometry.triangle_stratum) {
            self.strata.fill(device, bytemuck::cast_slice(&geometry.triangle_stratum))?;
        }
        Ok(())
    }

    /// Uploads the triangles' corners. One that is never drawn becomes a point, so that indices stay.
    fn upload_indices(
        &mut self,
        device: &Device,
        geometry: &Geometry,
        rules: &Cutouts,
    ) -> Result<(), PreviewError> {
        if !rules.by_stratum.contains(&Drawn::Never) {
            return self.indices.fill(device, bytemuck::cast_slice(&geometry.triangles));
        }
        let shown = geometry.triangles.iter().zip(&geometry.triangle_stratum).map(|(&corners, &stratum)| {
            if rules.by_stratum[stratum as usize] == Drawn::Never { [corners[0]; 3] } else { corners }
        });
        self.indices.fill(device, bytemuck::cast_slice(&shown.collect::<Vec<_>>()))
    }

    fn upload_masks(&mut self, device: &Device, frame: &Frame, rules: &Cutouts) -> Result<(), PreviewError> {
        let mut alphas: Vec<u8> = Vec::new();
        let mut offsets: Vec<Option<u32>> = vec![None; frame.textures.len()];
        let mut entries = Vec::with_capacity(rules.by_stratum.len());
        for drawn in &rules.by_stratum {
            let Drawn::Where { texture, cutoff } = *drawn else {
                entries.push(CutoutEntry::default());
                continue;
            };
            let index = texture.0 as usize;
            let image = &frame.textures[index];
            let offset = match offsets[index] {
                Some(offset) => offset,
                None => {
                    // The shader indexes texels with a u32.
                    let offset = u32::try_from(alphas.len()).map_err(|_| PreviewError::DoesNotFit {
                        what: self.alphas.label,
                        bytes: alphas.len() as u64,
                        limit: u64::from(u32::MAX),
                    })?;
                    if let Texels::Srgb8(texels) = &image.texels {
                        alphas.extend(texels.iter().map(|texel| texel[3]));
                    }
                    offsets[index] = Some(offset);
                    offset
                }
            };
            entries.push(CutoutEntry { offset, width: image.width, height: image.height, cutoff });
        }
        alphas.resize(alphas.len().next_multiple_of(4), 0);
        self.cutouts.fill(device, bytemuck::cast_slice(&entries))?;
        self.alphas.fill(device, &alphas)
    }
}

//! The GPU preview: triangle indices by rasterisation, and pixel counts by a compute shader.

mod device;
mod pipelines;
mod resident;

use crate::clock::ThreadClock;
use crate::cost::Cost;
use crate::error::PreviewError;
use crate::preview::{Counts, NOTHING, Preview};
use crate::visible::{check, resolve};
use device::Device;
use forelight_scene::{Camera, Frame};
use glam::Vec4;
use pipelines::{ExtentUniform, Pipelines, ViewUniform};
use resident::{Drawable, Resident};

/// Largest side of a tile in pixels, within every device's limits. Ids, depth and read-back take 64 MiB each.
const LARGEST_TILE: u32 = 4096;

/// Alignment of rows in texture copies, in bytes.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// A device, with everything that stays on it from frame to frame.
pub(crate) struct Gpu {
    device: Device,
    pipelines: Pipelines,
    resident: Resident,
    target: Option<Target>,
    counters: Option<Counters>,
}

/// Render targets, and the buffer to read back the ids.
struct Target {
    width: u32,
    height: u32,
    ids: wgpu::Texture,
    depth: wgpu::TextureView,
    read_back: wgpu::Buffer,
    bytes_per_row: u32,
}

/// Counters on the device, and the buffer to read them back.
struct Counters {
    on_device: wgpu::Buffer,
    read_back: wgpu::Buffer,
}

/// A part of the image. It may extend past the right and bottom edges.
#[derive(Clone, Copy)]
struct Tile {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

impl Gpu {
    pub fn open() -> Result<Self, PreviewError> {
        let device = Device::open()?;
        let pipelines = Pipelines::new(&device.device);
        let resident = Resident::new(&device);
        device.healthy()?;
        Ok(Self { device, pipelines, resident, target: None, counters: None })
    }

    /// Name, kind and driver of the adapter.
    pub fn name(&self) -> &str {
        &self.device.name
    }

    /// Whether it is hardware, not a software driver.
    pub fn is_hardware(&self) -> bool {
        self.device.is_hardware
    }

    /// Loses the device, as a failing driver does.
    #[cfg(test)]
    pub fn lose(&self) {
        self.device.device.destroy();
    }

    pub fn preview(&mut self, frame: &Frame) -> Result<(Preview, Cost), PreviewError> {
        check(&frame.camera)?;
        let clock = ThreadClock::start();
        let mut cost = Cost::default();
        let mut triangles = vec![NOTHING; frame.camera.pixels()];
        let Self { device, pipelines, resident, target, .. } = self;
        if let Some(scene) = resident.update(device, frame)? {
            let target = Target::of(target, device, &frame.camera);
            for tile in tiles(&frame.camera) {
                let mut encoder = device.device.create_command_encoder(&Default::default());
                draw(device, pipelines, target, &scene, &frame.camera, tile, &mut encoder);
                target.copy_to_read_back(&mut encoder);
                let width = frame.camera.width as usize;
                device.run_and_read(
                    encoder.finish(),
                    &target.read_back,
                    target.read_back.size(),
                    &mut cost.device_nanos,
                    |bytes| {
                        let ids: &[u32] = bytemuck::cast_slice(bytes);
                        let (left, columns) = (tile.left as usize, tile.columns(&frame.camera) as usize);
                        for y in 0..tile.rows(&frame.camera) as usize {
                            let from = &ids[y * target.bytes_per_row as usize / 4..][..columns];
                            let to = &mut triangles[(tile.top as usize + y) * width + left..][..columns];
                            for (to, from) in to.iter_mut().zip(from) {
                                *to = from.wrapping_sub(1); // 0, nothing, becomes NOTHING
                            }
                        }
                    },
                )?;
            }
        }
        cost.cpu_nanos = clock.nanos();
        Ok((resolve(frame, &triangles, &mut cost), cost))
    }

    pub fn counts(&mut self, frame: &Frame) -> Result<(Counts, Cost), PreviewError> {
        check(&frame.camera)?;
        let clock = ThreadClock::start();
        let mut cost = Cost::default();
        let strata = frame.geometry.strata.len();
        let mut counts = Counts::none(strata);
        let Self { device, pipelines, resident, target, counters } = self;
        let Some(scene) = resident.update(device, frame)? else {
            counts.background = frame.camera.pixels() as u32; // at most 2²⁸: checked above
            return Ok((counts, Cost { cpu_nanos: clock.nanos(), ..cost }));
        };
        let target = Target::of(target, device, &frame.camera);
        let bytes = (strata as u64 + 1) * 4;
        let counters = Counters::of(counters, device, bytes);
        let tiles: Vec<Tile> = tiles(&frame.camera).collect();
        for (i, &tile) in tiles.iter().enumerate() {
            let mut encoder = device.device.create_command_encoder(&Default::default());
            if i == 0 {
                encoder.clear_buffer(&counters.on_device, 0, None);
            }
            draw(device, pipelines, target, &scene, &frame.camera, tile, &mut encoder);
            let extent = ExtentUniform {
                width: tile.columns(&frame.camera),
                height: tile.rows(&frame.camera),
                counters: strata as u32 + 1,
                padding: 0,
            };
            device.queue.write_buffer(&pipelines.extent, 0, bytemuck::bytes_of(&extent));
            pipelines.count(device, &target.ids, scene.strata, &counters.on_device, extent, &mut encoder);
            if i + 1 < tiles.len() {
                device.queue.submit([encoder.finish()]);
                continue;
            }
            encoder.copy_buffer_to_buffer(&counters.on_device, 0, &counters.read_back, 0, bytes);
            device.run_and_read(
                encoder.finish(),
                &counters.read_back,
                bytes,
                &mut cost.device_nanos,
                |bytes| {
                    let numbers: &[u32] = bytemuck::cast_slice(bytes);
                    counts.background = numbers[0];
                    counts.per_stratum.copy_from_slice(&numbers[1..]);
                },
            )?;
        }
        cost.cpu_nanos = clock.nanos();
        Ok((counts, cost))
    }
}

/// Records commands that draw one tile.
fn draw(
    device: &Device,
    pipelines: &Pipelines,
    target: &Target,
    scene: &Drawable<'_>,
    camera: &Camera,
    tile: Tile,
    encoder: &mut wgpu::CommandEncoder,
) {
    device.queue.write_buffer(&pipelines.view, 0, bytemuck::bytes_of(&view_of(camera, tile, scene.near)));
    let group = pipelines.scene_group(&device.device, scene);
    let ids = target.ids.create_view(&Default::default());
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("visibility"),
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &ids,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                store: wgpu::StoreOp::Store,
            },
        })],
        depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
            view: &target.depth,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear(0.0),
                store: wgpu::StoreOp::Discard,
            }),
            stencil_ops: None,
        }),
        timestamp_writes: None,
        occlusion_query_set: None,
        multiview_mask: None,
    });
    pass.set_pipeline(if scene.masked { &pipelines.masked } else { &pipelines.opaque });
    pass.set_bind_group(0, &group, &[]);
    pass.set_vertex_buffer(0, scene.positions.slice(..));
    if scene.masked {
        pass.set_vertex_buffer(1, scene.uvs.slice(..));
    }
    pass.set_index_buffer(scene.indices.slice(..), wgpu::IndexFormat::Uint32);
    pass.draw_indexed(0..scene.index_count, 0, 0..1);
}

/// The camera of one tile for the shader: scale and offset map the tile to the image's [−1, 1].
fn view_of(camera: &Camera, tile: Tile, near: f32) -> ViewUniform {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let (tile_width, tile_height) = (f64::from(tile.width), f64::from(tile.height));
    ViewUniform {
        right: (camera.right / camera.tan_half_x).extend(0.0),
        up: (camera.up / camera.tan_half_y).extend(0.0),
        forward: camera.forward.extend(near),
        origin: camera.origin.extend(0.0),
        tile: Vec4::new(
            (width / tile_width) as f32,
            ((width - 2.0 * f64::from(tile.left)) / tile_width - 1.0) as f32,
            (height / tile_height) as f32,
            ((2.0 * f64::from(tile.top) - height) / tile_height + 1.0) as f32,
        ),
    }
}

impl Tile {
    /// Columns of the tile that belong to the image.
    fn columns(&self, camera: &Camera) -> u32 {
        self.width.min(camera.width - self.left)
    }

    /// Rows of the tile that belong to the image.
    fn rows(&self, camera: &Camera) -> u32 {
        self.height.min(camera.height - self.top)
    }
}

/// Size of the tiles of an image.
fn tile_size(camera: &Camera) -> (u32, u32) {
    (camera.width.min(LARGEST_TILE), camera.height.min(LARGEST_TILE))
}

/// The tiles that cover an image, all of the same size.
fn tiles(camera: &Camera) -> impl Iterator<Item = Tile> + use<> {
    let (width, height) = tile_size(camera);
    let (columns, rows) = (camera.width.div_ceil(width), camera.height.div_ceil(height));
    (0..rows).flat_map(move |y| {
        (0..columns).map(move |x| Tile { left: x * width, top: y * height, width, height })
    })
}

impl Target {
    /// The target for the tiles of an image. The last one is reused if it has the right size.
    fn of<'a>(slot: &'a mut Option<Self>, device: &Device, camera: &Camera) -> &'a Self {
        let size = tile_size(camera);
        let fit = slot.take().filter(|target| (target.width, target.height) == size);
        slot.insert(fit.unwrap_or_else(|| Self::new(device, size)))
    }

    fn new(device: &Device, (width, height): (u32, u32)) -> Self {
        let texture = |label, format, usage| {
            device.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let uses = wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::TEXTURE_BINDING;
        let ids = texture("visible triangles", pipelines::ID_FORMAT, uses);
        let depth = texture("depth", pipelines::DEPTH_FORMAT, wgpu::TextureUsages::RENDER_ATTACHMENT);
        let bytes_per_row = (width * 4).next_multiple_of(ROW_ALIGNMENT);
        let read_back = device.buffer(
            "read-back of the ids",
            u64::from(bytes_per_row) * u64::from(height),
            wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        );
        Self { width, height, ids, depth: depth.create_view(&Default::default()), read_back, bytes_per_row }
    }

    fn copy_to_read_back(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.copy_texture_to_buffer(
            self.ids.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &self.read_back,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(self.bytes_per_row),
                    rows_per_image: None,
                },
            },
            self.ids.size(),
        );
    }
}

impl Counters {
    fn of<'a>(slot: &'a mut Option<Self>, device: &Device, bytes: u64) -> &'a Self {
        let fit = slot.take().filter(|counters| counters.on_device.size() == bytes);
        slot.insert(fit.unwrap_or_else(|| {
            use wgpu::BufferUsages as Usage;
            Self {
                on_device: device.buffer(
                    "counters",
                    bytes,
                    Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST,
                ),
                read_back: device.buffer(
                    "read-back of the counters",
                    bytes,
                    Usage::COPY_DST | Usage::MAP_READ,
                ),
            }
        }))
    }
}

//! Shaders, their bindings, and the small buffers that are written for every frame.

use super::device::Device;
use super::resident::Drawable;
use glam::Vec4;
use wgpu::{BufferBindingType, ShaderStages};

/// Format of the visibility target.
pub(crate) const ID_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Format of the depth buffer. Reversed depth needs floats.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Number of counters that `histogram.wgsl` keeps in workgroup memory (`LOCAL_COUNTERS`).
const LOCAL_COUNTERS: u32 = 2048;

/// Side of the block of pixels that one workgroup of `histogram.wgsl` counts (`BLOCK`), in pixels.
const BLOCK: u32 = 64;

/// `View` of `visibility.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct ViewUniform {
    pub right: Vec4,
    pub up: Vec4,
    pub forward: Vec4,
    pub origin: Vec4,
    pub tile: Vec4,
}

/// `Extent` of `histogram.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct ExtentUniform {
    pub width: u32,
    pub height: u32,
    pub counters: u32,
    pub padding: u32,
}

/// Everything that is created once per device.
pub(crate) struct Pipelines {
    /// Draws scenes without texture cut-outs, so depth is tested before the shader runs.
    pub opaque: wgpu::RenderPipeline,
    /// Draws scenes with texture cut-outs.
    pub masked: wgpu::RenderPipeline,
    /// Uniform buffer of the tile's view.
    pub view: wgpu::Buffer,
    /// Uniform buffer of the tile's extent.
    pub extent: wgpu::Buffer,
    scene_layout: wgpu::BindGroupLayout,
    count_layout: wgpu::BindGroupLayout,
    count_in_workgroup: wgpu::ComputePipeline,
    count_in_memory: wgpu::ComputePipeline,
}

impl Pipelines {
    pub fn new(device: &wgpu::Device) -> Self {
        let visibility = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("visibility.wgsl"),
            source: wgpu::ShaderSource::Wgsl(include_str!("../../../../shaders/visibility.wgsl").into()),
        });
        let histogram = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("histogram.wgsl"),
            source: wgpu::ShaderSource::Wgsl(include_str!("../../../../shaders/histogram.wgsl").into()),
        });
        let read = BufferBindingType::Storage { read_only: true };
        let scene_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("scene"),
            entries: &[
                buffer_entry(0, ShaderStages::VERTEX, BufferBindingType::Uniform),
                buffer_entry(1, ShaderStages::FRAGMENT, read),
                buffer_entry(2, ShaderStages::FRAGMENT, read),
                buffer_entry(3, ShaderStages::FRAGMENT, read),
            ],
        });
        let count_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("counting"),
            entries: &[
                buffer_entry(0, ShaderStages::COMPUTE, BufferBindingType::Uniform),
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: ShaderStages::COMPUTE,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Uint,
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                },
                buffer_entry(2, ShaderStages::COMPUTE, read),
                buffer_entry(3, ShaderStages::COMPUTE, BufferBindingType::Storage { read_only: false }),
            ],
        });
        let compute = |entry_point| {
            let layout = pipeline_layout(device, &count_layout);
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: Some(&layout),
                module: &histogram,
                entry_point: Some(entry_point),
                compilation_options: Default::default(),
                cache: None,
            })
        };
        let uniform = |label, size| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        Self {
            opaque: render_pipeline(device, &visibility, &scene_layout, false),
            masked: render_pipeline(device, &visibility, &scene_layout, true),
            view: uniform("view", size_of::<ViewUniform>() as u64),
            extent: uniform("extent", size_of::<ExtentUniform>() as u64),
            count_in_workgroup: compute("count_in_workgroup"),
            count_in_memory: compute("count_in_memory"),
            scene_layout,
            count_layout,
        }
    }

    /// The bindings of `visibility.wgsl`.
    pub fn scene_group(&self, device: &wgpu::Device, scene: &Drawable<'_>) -> wgpu::BindGroup {
        let buffers = [&self.view, scene.strata, scene.cutouts, scene.alphas];
        let entries: [_; 4] = std::array::from_fn(|i| wgpu::BindGroupEntry {
            binding: i as u32,
            resource: buffers[i].as_entire_binding(),
        });
        device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("scene"),
            layout: &self.scene_layout,
            entries: &entries,
        })
    }

    /// Records commands that count a drawn tile into `counters`.
    pub fn count(
        &self,
        device: &Device,
        ids: &wgpu::Texture,
        strata: &wgpu::Buffer,
        counters: &wgpu::Buffer,
        extent: ExtentUniform,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let view = ids.create_view(&Default::default());
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let group = device.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("counting"),
            layout: &self.count_layout,
            entries: &[
                entry(0, self.extent.as_entire_binding()),
                entry(1, wgpu::BindingResource::TextureView(&view)),
                entry(2, strata.as_entire_binding()),
                entry(3, counters.as_entire_binding()),
            ],
        });
        let local = extent.counters <= LOCAL_COUNTERS;
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(if local { &self.count_in_workgroup } else { &self.count_in_memory });
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(extent.width.div_ceil(BLOCK), extent.height.div_ceil(BLOCK), 1);
    }
}

fn buffer_entry(binding: u32, visibility: ShaderStages, ty: BufferBindingType) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}

fn pipeline_layout(device: &wgpu::Device, group: &wgpu::BindGroupLayout) -> wgpu::PipelineLayout {
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(group)],
        immediate_size: 0,
    })
}

fn render_pipeline(
    device: &wgpu::Device,
    shader: &wgpu::ShaderModule,
    group: &wgpu::BindGroupLayout,
    masked: bool,
) -> wgpu::RenderPipeline {
    let positions = wgpu::VertexBufferLayout {
        array_stride: 12,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &wgpu::vertex_attr_array![0 => Float32x3],
    };
    let uvs = wgpu::VertexBufferLayout {
        array_stride: 8,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &wgpu::vertex_attr_array![1 => Float32x2],
    };
    let buffers = [Some(positions), Some(uvs)];
    let (vertex, fragment, buffers) = if masked {
        ("masked_vertex", "masked_fragment", &buffers[..])
    } else {
        ("opaque_vertex", "opaque_fragment", &buffers[..1])
    };
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(fragment),
        layout: Some(&pipeline_layout(device, group)),
        vertex: wgpu::VertexState {
            module: shader,
            entry_point: Some(vertex),
            compilation_options: Default::default(),
            buffers,
        },
        primitive: wgpu::PrimitiveState::default(), // triangles, nothing culled
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: shader,
            entry_point: Some(fragment),
            compilation_options: Default::default(),
            targets: &[Some(ID_FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

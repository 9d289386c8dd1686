// Finds the triangle that each pixel shows.
//
// One draw call renders all triangles into one R32Uint target: the triangle's index + 1, or 0 where no
// surface is. Stratum, position and normal are computed on the host from the index and the pixel. No value
// that the rasteriser interpolates is read back.
//
// Depth is reversed (near plane 1, infinity 0) and compared with Greater. With floats, the precision is then
// spread evenly over the orders of magnitude, and an infinite far plane is possible at no cost. Of two
// surfaces at the same depth the one drawn first stays: the lowest triangle index, as on the CPU.

enable primitive_index;

struct View {
    // Axes of the camera. `right` and `up` are divided by the tangents of half the field of view. `forward.w`
    // is the near distance.
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    origin: vec4f,
    // The tile to draw, as scale x, offset x, scale y and offset y of normalised device coordinates.
    tile: vec4f,
}

// Cut-out of one stratum. The alpha channel of its texture begins at byte `offset` of `alphas`. Without a
// cut-out, the width is 0.
struct Cutout {
    offset: u32,
    width: u32,
    height: u32,
    cutoff: f32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> triangle_stratum: array<u32>;
@group(0) @binding(2) var<storage, read> cutouts: array<Cutout>;
// Alpha of all cut-out textures: 8 bits per texel, four texels per word, the first in the lowest byte.
@group(0) @binding(3) var<storage, read> alphas: array<u32>;

// The inverse of the camera's rays: a point at `direction(pixel) * t` from the eye is projected to `pixel`,
// with w = t.
fn project(position: vec3f) -> vec4f {
    let p = position - view.origin.xyz;
    let w = dot(p, view.forward.xyz);
    let x = dot(p, view.right.xyz);
    let y = dot(p, view.up.xyz);
    return vec4f(
        x * view.tile.x + w * view.tile.y,
        y * view.tile.z + w * view.tile.w,
        view.forward.w,
        w,
    );
}

@vertex
fn opaque_vertex(@location(0) position: vec3f) -> @builtin(position) vec4f {
    return project(position);
}

@fragment
fn opaque_fragment(@builtin(primitive_index) triangle: u32) -> @location(0) u32 {
    return triangle + 1u;
}

struct Masked {
    @builtin(position) position: vec4f,
    @location(0) uv: vec2f,
}

@vertex
fn masked_vertex(@location(0) position: vec3f, @location(1) uv: vec2f) -> Masked {
    return Masked(project(position), uv);
}

@fragment
fn masked_fragment(@builtin(primitive_index) triangle: u32, @location(0) uv: vec2f) -> @location(0) u32 {
    let cutout = cutouts[triangle_stratum[triangle]];
    if cutout.width != 0u {
        if alpha(cutout, uv) < cutout.cutoff {
            discard;
        }
    }
    return triangle + 1u;
}

// The two texels on both sides of a coordinate, with repeat, and the fraction towards the second.
struct Straddle {
    first: u32,
    second: u32,
    fraction: f32,
}

fn wrap(s: f32, size: u32) -> Straddle {
    let x = (s - floor(s)) * f32(size) - 0.5;
    let below = floor(x);
    // x is in [-0.5, size - 0.5], so a single step of `size` wraps it.
    let first = select(u32(max(below, 0.0)), size - 1u, below < 0.0);
    let second = select(first + 1u, 0u, first + 1u == size);
    return Straddle(first, second, x - below);
}

fn texel(cutout: Cutout, x: u32, y: u32) -> f32 {
    let at = cutout.offset + y * cutout.width + x;
    return f32((alphas[at / 4u] >> ((at % 4u) * 8u)) & 255u) / 255.0;
}

// Bilinear lookup with v upwards, in the same order of operations as on the CPU.
fn alpha(cutout: Cutout, uv: vec2f) -> f32 {
    let x = wrap(uv.x, cutout.width);
    let y = wrap(1.0 - uv.y, cutout.height);
    let a = texel(cutout, x.first, y.first);
    let b = texel(cutout, x.second, y.first);
    let c = texel(cutout, x.first, y.second);
    let d = texel(cutout, x.second, y.second);
    let top = a + (b - a) * x.fraction;
    let bottom = c + (d - c) * x.fraction;
    return top + (bottom - top) * y.fraction;
}

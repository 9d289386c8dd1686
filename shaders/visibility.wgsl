// Which triangle does each pixel show?
//
// One draw of all triangles into one R32Uint target: 0 where nothing is seen, otherwise the triangle's index + 1. Stratum,
// position and normal follow from the index and the pixel, and are worked out where they are needed: nothing that
// the rasteriser interpolates ever leaves the device.
//
// Depth is reversed (near plane 1, infinity 0) and compared with Greater. With floats that spreads the precision evenly
// over the orders of magnitude, an infinite far plane costs nothing, and of two surfaces at the same depth the one
// drawn first stays: the lowest triangle index, as on the CPU.

enable primitive_index;

struct View {
    // The camera's axes; `right` and `up` divided by the tangents of half the field of view. `forward.w` is the near distance.
    right: vec4f,
    up: vec4f,
    forward: vec4f,
    origin: vec4f,
    // The tile of the image that is drawn, as scale x, offset x, scale y, offset y of normalised device coordinates.
    tile: vec4f,
}

// Cut-out of one stratum: its texture's alpha begins at byte `offset` of `alphas`. Width 0: no cut-out.
struct Cutout {
    offset: u32,
    width: u32,
    height: u32,
    cutoff: f32,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> triangle_stratum: array<u32>;
@group(0) @binding(2) var<storage, read> cutouts: array<Cutout>;
// Alpha of all cut-out textures, 8 bits a texel, four texels a word, the first in the lowest byte.
@group(0) @binding(3) var<storage, read> alphas: array<u32>;

// The inverse of the camera's ray: a point at `direction(pixel) * t` from the eye lands on `pixel` with w = t.
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

// The two texels that straddle a coordinate (repeat), and the fraction towards the second.
struct Straddle {
    first: u32,
    second: u32,
    fraction: f32,
}

fn wrap(s: f32, size: u32) -> Straddle {
    let x = (s - floor(s)) * f32(size) - 0.5;
    let below = floor(x);
    // x lies in [-0.5, size - 0.5], so that one step of `size` brings it home.
    let first = select(u32(max(below, 0.0)), size - 1u, below < 0.0);
    let second = select(first + 1u, 0u, first + 1u == size);
    return Straddle(first, second, x - below);
}

fn texel(cutout: Cutout, x: u32, y: u32) -> f32 {
    let at = cutout.offset + y * cutout.width + x;
    return f32((alphas[at / 4u] >> ((at % 4u) * 8u)) & 255u) / 255.0;
}

// Bilinear lookup, v up, in the order of operations of the CPU's.
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

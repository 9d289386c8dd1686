// Counts how many pixels show each stratum.
//
// Reads the visibility target and adds to one counter per stratum, so that only the counts are read back to
// the host. Counter 0 is the background, counter s + 1 is stratum s.
//
// Neighbouring pixels mostly show the same stratum. If every pixel incremented a counter in memory, most
// would compete for a few addresses. So each workgroup counts a block of 64 × 64 pixels in workgroup memory,
// and adds only the sums to the counters. Each invocation adds a run of equal pixels at once.

struct Extent {
    // Size of the part of the target that belongs to the image, in pixels.
    width: u32,
    height: u32,
    // Number of counters: strata + 1.
    counters: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> extent: Extent;
@group(0) @binding(1) var visible: texture_2d<u32>;
@group(0) @binding(2) var<storage, read> triangle_stratum: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;

// Scenes with more strata than this use `count_in_memory`.
const LOCAL_COUNTERS: u32 = 2048u;
const SIDE: u32 = 16u;
const BLOCK: u32 = 64u;

var<workgroup> local_counters: array<atomic<u32>, LOCAL_COUNTERS>;

// Index of the counter for a pixel.
fn counter(x: u32, y: u32) -> u32 {
    let triangle = textureLoad(visible, vec2u(x, y), 0).x;
    if triangle == 0u {
        return 0u;
    }
    return triangle_stratum[triangle - 1u] + 1u;
}

@compute @workgroup_size(SIDE, SIDE)
fn count_in_workgroup(
    @builtin(workgroup_id) block: vec3u,
    @builtin(local_invocation_id) local: vec3u,
    @builtin(local_invocation_index) index: u32,
) {
    for (var y = block.y * BLOCK + local.y; y < min((block.y + 1u) * BLOCK, extent.height); y += SIDE) {
        var run = 0u;
        var length = 0u;
        for (var x = block.x * BLOCK + local.x; x < min((block.x + 1u) * BLOCK, extent.width); x += SIDE) {
            let here = counter(x, y);
            if here != run && length != 0u {
                atomicAdd(&local_counters[run], length);
                length = 0u;
            }
            run = here;
            length += 1u;
        }
        if length != 0u {
            atomicAdd(&local_counters[run], length);
        }
    }
    workgroupBarrier();
    for (var i = index; i < extent.counters; i += SIDE * SIDE) {
        let sum = atomicLoad(&local_counters[i]);
        if sum != 0u {
            atomicAdd(&counters[i], sum);
        }
    }
}

@compute @workgroup_size(SIDE, SIDE)
fn count_in_memory(
    @builtin(workgroup_id) block: vec3u,
    @builtin(local_invocation_id) local: vec3u,
) {
    for (var y = block.y * BLOCK + local.y; y < min((block.y + 1u) * BLOCK, extent.height); y += SIDE) {
        for (var x = block.x * BLOCK + local.x; x < min((block.x + 1u) * BLOCK, extent.width); x += SIDE) {
            atomicAdd(&counters[counter(x, y)], 1u);
        }
    }
}

// Stage `score`, step 1: the row versions of a pool, one an invocation, become the splats of one cloud.
// Colour, rotation and 3D filter are those of the row.

@group(0) @binding(0) var<uniform> view: ViewPass;
// The rows of this binding, and their versions.
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sh: array<vec4<f32>>;
// Row of each version, and where its genes are: `OWN_GENES` for what the row has itself [K].
@group(0) @binding(4) var<storage, read> versions: array<vec2<u32>>;
// Position, opacity logit; log-scales, nothing [., 2].
@group(0) @binding(5) var<storage, read> genes: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> splats: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> depths: array<u32>;
@group(0) @binding(8) var<storage, read_write> tile_counts: array<u32>;

fn colour_seen(row: u32, position: vec3<f32>) -> vec3<f32> {
    return sh_colour(row, view.sh_degree, position) + 0.5;
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.source_count {
        return;
    }
    let slot = window.source_first + local;
    let row = versions[slot].x - window.first;
    var first = geometry[3u * row];
    var second = geometry[3u * row + 1u];
    let at = versions[slot].y;
    if at != OWN_GENES {
        first = genes[2u * at];
        second = vec4(genes[2u * at + 1u].xyz, second.w);
    }
    write_splat(params_from(first, second, geometry[3u * row + 2u]), row, slot);
}

// Overwrites the genes of single rows, one an invocation.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> rows: array<u32>;
// [K, 2] vectors: position, opacity logit; log-scales, nothing.
@group(0) @binding(2) var<storage, read> genes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> geometry: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    if item >= window.source_count {
        return;
    }
    let local = rows[item] - window.first;
    // Unsigned: rows before the window wrap to large numbers.
    if local >= window.count {
        return;
    }
    geometry[3u * local] = genes[2u * item];
    geometry[3u * local + 1u] = vec4(genes[2u * item + 1u].xyz, geometry[3u * local + 1u].w);
}

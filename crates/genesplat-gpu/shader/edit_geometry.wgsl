// Row edits of positions, scales and opacities: clones are exact copies, split children are drawn from their parent's own
// distribution and are 1.6 times smaller, relocated Gaussians take over opacity and scales from the plan.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<uniform> edit: Edit;
@group(0) @binding(2) var<storage, read> plan: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> old: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> new_rows: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count {
        return;
    }
    let made = plan[window.first + local];
    let source = made.x - window.source_first;
    if source >= window.source_count {
        return;
    }
    var position = old[3u * source];
    var scale = old[3u * source + 1u];
    let rotation = old[3u * source + 2u];
    if made.y == ORIGIN_SPLIT || made.y == ORIGIN_SPLIT + 1u {
        let seed = vec2(edit.seed_low, edit.seed_high);
        let xi = normals_at(STREAM_SPLIT_OFFSET, edit.iteration, made.x, made.y - ORIGIN_SPLIT, seed);
        position += vec4(unit_rotation(rotation) * (exp(scale.xyz) * xi), 0.0);
        scale = vec4(log(exp(scale.xyz) / SPLIT_SHRINK), scale.w);
    } else if made.y == ORIGIN_RELOCATED || made.y == ORIGIN_RELOCATED_KEPT {
        position.w = bitcast<f32>(made.z);
        scale += vec4(vec3(bitcast<f32>(made.w)), 0.0);
    }
    new_rows[3u * local] = position;
    new_rows[3u * local + 1u] = scale;
    new_rows[3u * local + 2u] = rotation;
}

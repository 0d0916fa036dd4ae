// Row edits of positions, scales and opacities: clones are exact copies, split children are drawn from their
// parent's own distribution and are 1.6 times smaller, long-axis children part along their parent's longest
// axis and share it, relocated Gaussians take over opacity and scales from the plan.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<uniform> edit: Edit;
@group(0) @binding(2) var<storage, read> plan: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> old: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> new_rows: array<vec4<f32>>;

// A unit vector along the longest axis, the first of equal ones.
fn longest_axis(log_scale: vec3<f32>) -> vec3<f32> {
    if log_scale.z > max(log_scale.x, log_scale.y) {
        return vec3(0.0, 0.0, 1.0);
    }
    return select(vec3(1.0, 0.0, 0.0), vec3(0.0, 1.0, 0.0), log_scale.y > log_scale.x);
}

// By how much a child moves, in standard deviations: the two go opposite ways.
fn to_its_side(offset: f32, child: u32) -> f32 {
    return select(-offset, offset, child == 0u);
}

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
        let key = vec2(edit.key_low, edit.key_high);
        let xi = normals_at(STREAM_SPLIT_OFFSET, edit.iteration, made.x, made.y - ORIGIN_SPLIT, key);
        position += vec4(unit_rotation(rotation) * (exp(scale.xyz) * xi), 0.0);
        scale = vec4(log(exp(scale.xyz) / SPLIT_SHRINK), scale.w);
    } else if made.y == ORIGIN_LONG_AXIS || made.y == ORIGIN_LONG_AXIS + 1u {
        let longest = longest_axis(scale.xyz);
        let offset = longest * to_its_side(LONG_AXIS_OFFSET, made.y - ORIGIN_LONG_AXIS);
        let each = LONG_AXIS_OPACITY * max(sigmoid(position.w), LONG_AXIS_OPACITY_MIN);
        position = vec4(
            position.xyz + unit_rotation(rotation) * (exp(scale.xyz) * offset), log(each) - log(1.0 - each));
        scale += vec4(log(mix(vec3(LONG_AXIS_WIDTH), vec3(LONG_AXIS_SHRINK), longest)), 0.0);
    } else if made.y == ORIGIN_RELOCATED || made.y == ORIGIN_RELOCATED_KEPT {
        position.w = bitcast<f32>(made.z);
        scale += vec4(vec3(bitcast<f32>(made.w)), 0.0);
    }
    new_rows[3u * local] = position;
    new_rows[3u * local + 1u] = scale;
    new_rows[3u * local + 2u] = rotation;
}

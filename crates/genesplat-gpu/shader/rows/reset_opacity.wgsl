// Opacity reset: min(opacity, ceiling) of the opacity that the 3D filter leaves; the moments of opacity are
// zeroed.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<uniform> edit: Edit;
@group(0) @binding(2) var<storage, read_write> geometry: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> second_moments: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    if local >= window.count {
        return;
    }
    let scale = geometry[3u * local + 1u];
    var dimming = 1.0;
    if scale.w > 0.0 {
        let raw = exp(2.0 * scale.xyz);
        let ratio = raw / (raw + scale.w * scale.w);
        dimming = sqrt(ratio.x * ratio.y * ratio.z);
    }
    // As genesplat_core::gaussians::limited_opacity: one that is low enough stays what it is.
    if dimming / (1.0 + exp(-geometry[3u * local].w)) > edit.amount {
        geometry[3u * local].w = log(edit.amount / (dimming - edit.amount));
    }
    first_moments[3u * local].w = 0.0;
    second_moments[3u * local].w = 0.0;
}

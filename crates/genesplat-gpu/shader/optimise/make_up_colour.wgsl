// Every colour makes the steps that it has not made yet, one vector an invocation; then the host clears the
// account.

@group(0) @binding(0) var<uniform> window: Window;
@group(0) @binding(1) var<storage, read> steps: ColourSteps;
@group(0) @binding(2) var<storage, read> made: array<u32>;
@group(0) @binding(3) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> second_moments: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let at = group_of(group) * GROUP + lane;
    if at < VECTORS * window.count && made[at / VECTORS] < steps.count {
        make_up(at, made[at / VECTORS]);
    }
}

// Stage `credit`, step 2: adds the gradient rows of one view to credits, one Gaussian an invocation.

// Three mutants, and the number of views, summed over the views [N].
@group(0) @binding(5) var<storage, read_write> credits: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    let count = entries_of(local);
    if count == 0u {
        return;
    }
    credits[local] += vec4(colour_sum(local, count), 1.0);
}

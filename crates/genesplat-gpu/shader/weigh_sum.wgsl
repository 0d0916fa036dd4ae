// Stage `weigh`, step 2: adds the gradient rows of one view to merits, one Gaussian an invocation.

// Weight, summed over the views; error, the largest of all views [N].
@group(0) @binding(5) var<storage, read_write> merits: array<vec2<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    let count = entries_of(local);
    if count == 0u {
        return;
    }
    let of_view = colour_sum(local, count).xy;
    let merit = merits[local];
    merits[local] = vec2(merit.x + of_view.x, max(merit.y, of_view.y));
}

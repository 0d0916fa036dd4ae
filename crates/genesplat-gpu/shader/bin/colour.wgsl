// Stage `project`, step 2: the colours of the splats, one Gaussian an invocation, after the steps of the
// optimiser that its colours have to make up for.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(3) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> second_moments: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> steps: ColourSteps;
// Steps that each row has made [N].
@group(0) @binding(8) var<storage, read_write> made: array<u32>;
// [N, 3] vectors
@group(0) @binding(9) var<storage, read_write> splats: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let local = group_of(group) * GROUP + lane;
    let row = window.first + local;
    if local >= window.count || (tile_counts[row] & SPLAT_BIT) == 0u {
        return;
    }
    let before = made[local];
    if before < steps.count {
        for (var at = VECTORS * local; at < VECTORS * (local + 1u); at++) {
            make_up(at, before);
        }
        made[local] = steps.count;
    }
    let position = geometry[3u * local].xyz;
    var colour = vec3(0.0);
    if view.centre.w > 0.0 {
        // Inverse depth, and what is covered.
        colour = vec3(view.centre.w / (dot(view.camera_z.xyz, position) + view.camera_z.w), 1.0, 0.0);
    } else {
        colour = sh_colour(local, view.sh_degree, position) + 0.5;
    }
    var splat = splat_from(splats[3u * row], splats[3u * row + 1u], splats[3u * row + 2u]);
    if has_nan(vec4(colour, 0.0)) {
        // Clamping could make any colour of a NaN; so it reaches no pixel.
        splat.log2_opacity = -1e3;
        splats[3u * row] = first_vector(splat);
    } else {
        set_colour(&splat, colour);
        splats[3u * row + 2u] = third_vector(splat);
    }
}

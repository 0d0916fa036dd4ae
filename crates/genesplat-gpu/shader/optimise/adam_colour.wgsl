// Stage `adam` of the colours, 64 rows a workgroup. Runs before the positions move, since a coefficient's
// gradient is its basis function seen from where the Gaussian was rendered.
//
// An invocation first has four coefficients of a row, which are three vectors of gradients, and leaves them
// in workgroup memory; then it steps single vectors, so that neighbours touch neighbouring memory, in whole
// sectors.
//
// Rows without a splat wait: they have no gradient, and make up for the step later.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<uniform> optimiser: Optimiser;
@group(0) @binding(3) var<storage, read> counters: Counters;
@group(0) @binding(4) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> geometry: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> sh: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> second_moments: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> tile_counts: array<u32>;
// Steps that each row has made [N].
@group(0) @binding(10) var<storage, read_write> made: array<u32>;

// Rows of a workgroup.
const ROWS: u32 = GROUP / SH_GROUPS;
// A vector of each row, then the next: one more than there are rows, so that neither side asks one memory
// bank.
const PITCH: u32 = ROWS + 1u;
var<workgroup> sh_gradients: array<vec4<f32>, VECTORS * PITCH>;

// Vectors of a row that can move: others have no gradient and no moments yet.
fn moving_vectors() -> u32 {
    return select(3u * sh_groups(view.sh_degree), 1u, view.sh_degree == 0u);
}

fn has_splat(local: u32) -> bool {
    return (tile_counts[window.first + local] & SPLAT_BIT) != 0u;
}

// The gradients of one group of one row.
fn leave_gradients(row: u32, group: u32, local: u32) {
    let rgb = gradients[4u * local + 3u].xyz;
    let basis = sh_basis(view.sh_degree, group, view_direction(geometry[3u * local].xyz).xyz);
    let at = 3u * group * PITCH + row;
    sh_gradients[at] = vec4(basis.x * rgb, basis.y * rgb.x);
    sh_gradients[at + PITCH] = vec4(basis.y * rgb.yz, basis.z * rgb.xy);
    sh_gradients[at + 2u * PITCH] = vec4(basis.z * rgb.z, basis.w * rgb);
}

fn step(at: u32, gradient: vec4<f32>, rate: vec4<f32>) {
    var m = first_moments[at];
    var v = second_moments[at];
    sh[at] = adam(sh[at], gradient, &m, &v, rate, vec4(optimiser.root));
    first_moments[at] = m;
    second_moments[at] = v;
}

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let first = group_of(workgroup) * ROWS;
    let rows = min(ROWS, window.count - min(window.count, first));
    let row = lane % ROWS;
    let group = lane / ROWS;
    if row < rows && group < sh_groups(view.sh_degree) && has_splat(first + row) {
        leave_gradients(row, group, first + row);
    }
    workgroupBarrier();
    if counters.halted != 0u {
        return;
    }
    for (var begin = 0u; begin < VECTORS * ROWS; begin += GROUP) {
        let stepped = (begin + lane) / VECTORS;
        let vector = (begin + lane) % VECTORS;
        if stepped < rows && vector < moving_vectors() && has_splat(first + stepped) {
            let rate = colour_rate(vector, optimiser.sh_dc, optimiser.sh_rest);
            if vector == 0u {
                made[first + stepped] += 1u;
            }
            step(VECTORS * first + begin + lane, sh_gradients[vector * PITCH + stepped], rate);
        }
    }
}

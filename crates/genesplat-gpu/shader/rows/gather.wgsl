// Row edits: new rows of a column are copies of old ones, as the plan says. Where a column is cut in windows,
// this runs for each pair of an old and a new window, and copies the rows whose source is in the old one.

// Vectors of a row.
override VECTORS: u32;
// Rows with a new identity begin at zero: moments.
override FRESH: bool;
@group(0) @binding(0) var<uniform> window: Window;
// Source row, origin, two parameters of the origin.
@group(0) @binding(1) var<storage, read> plan: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> old: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> new_rows: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let item = group_of(group) * GROUP + lane;
    let local = item / VECTORS;
    if local >= window.count {
        return;
    }
    let made = plan[window.first + local];
    let source = made.x - window.source_first;
    // Unsigned: rows before the window wrap to large numbers.
    if source >= window.source_count {
        return;
    }
    let kept = made.y == ORIGIN_KEPT || made.y == ORIGIN_RELOCATED_KEPT;
    if FRESH && !kept {
        new_rows[item] = vec4(0.0);
    } else {
        new_rows[item] = old[source * VECTORS + item % VECTORS];
    }
}

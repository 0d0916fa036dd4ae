// Stage `bin`: how much work the tile lists are. Where they do not fit, nothing is listed and the run halts:
// the host finds out, allocates more, and repeats what was not done.

@group(0) @binding(0) var<uniform> view: ViewPass;
@group(0) @binding(1) var<storage, read_write> lengths: array<u32>;
@group(0) @binding(2) var<storage, read> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> grids: array<u32>;
@group(0) @binding(4) var<storage, read_write> counters: Counters;

@compute @workgroup_size(1)
fn main() {
    // Where the lists would have more intersections than 32 bits can count, as many as these can.
    let wanted = sums[(lengths[LENGTH_VISIBLE] + SCAN_BLOCK - 1u) / SCAN_BLOCK];
    var intersections = wanted;
    counters.wanted = max(counters.wanted, wanted);
    if wanted > view.intersection_capacity {
        counters.halted |= HALT_OVERFLOW;
    }
    if counters.halted != 0u {
        intersections = 0u;
    }
    lengths[LENGTH_INTERSECTIONS] = intersections;
    counters.intersections = intersections;
    write_grid(GRID_INTERSECTIONS, intersections, GROUP);
    write_grid(GRID_TILE_SORT, min(intersections, SORT_PIECE), SORT_BLOCK);
}

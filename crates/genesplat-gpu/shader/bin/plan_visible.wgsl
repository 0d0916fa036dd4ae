// Stage `bin`: how much work the splats of the view are, once they are counted.

@group(0) @binding(0) var<storage, read_write> lengths: array<u32>;
@group(0) @binding(1) var<storage, read> sums: array<u32>;
@group(0) @binding(2) var<storage, read_write> grids: array<u32>;
@group(0) @binding(3) var<storage, read_write> counters: Counters;

@compute @workgroup_size(1)
fn main() {
    let visible = sums[(lengths[LENGTH_ROWS] + SCAN_BLOCK - 1u) / SCAN_BLOCK];
    lengths[LENGTH_VISIBLE] = visible;
    counters.visible = visible;
    write_grid(GRID_VISIBLE, visible, GROUP);
    write_grid(GRID_VISIBLE_SCAN, visible, SCAN_BLOCK);
    // Of the first piece; what is more, the host has seen to.
    write_grid(GRID_DEPTH_SORT, min(visible, SORT_PIECE), SORT_BLOCK);
}

// Stage `bin`: how much work the tile lists are. Where they do not fit, nothing is listed and the run halts: the host
// finds out, makes room, and repeats what was not done.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read_write> lengths: array<u32>;
@group(0) @binding(2) var<storage, read> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> grids: array<u32>;
@group(0) @binding(4) var<storage, read_write> counters: Counters;

@compute @workgroup_size(1)
fn main() {
    // Where the lists would have more entries than 32 bits can count, as many as these can.
    let wanted = sums[(lengths[LENGTH_VISIBLE] + SCAN_BLOCK - 1u) / SCAN_BLOCK];
    var entries = wanted;
    counters.wanted = max(counters.wanted, wanted);
    if wanted > frame.entry_capacity {
        counters.halted |= HALT_OVERFLOW;
    }
    if counters.halted != 0u {
        entries = 0u;
    }
    lengths[LENGTH_ENTRIES] = entries;
    counters.entries = entries;
    write_grid(GRID_ENTRIES, entries, GROUP);
    write_grid(GRID_TILE_SORT, entries, SORT_BLOCK);
}

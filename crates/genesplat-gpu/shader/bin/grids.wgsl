// Writes the grids of dispatches whose size only the device knows.

fn write_grid(slot: u32, items: u32, each: u32) {
    let groups = (items + each - 1u) / each;
    grids[3u * slot] = min(groups, GRID_WIDTH);
    grids[3u * slot + 1u] = (groups + GRID_WIDTH - 1u) / GRID_WIDTH;
    grids[3u * slot + 2u] = 1u;
}

// Stage `score`, step 3: the picture of each individual. Tiles that it does not change are the base's; in the others, the
// base's list (without the splats that the individual lacks) and its own list are merged by depth, ties by row, which is
// the order that a plain render has.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<uniform> window: Window;
@group(0) @binding(2) var<storage, read> items: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> base_ranges: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> base_entries: array<u32>;
@group(0) @binding(5) var<storage, read> base_entry_splats: array<u32>;
@group(0) @binding(6) var<storage, read> splats: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> base_depths: array<u32>;
@group(0) @binding(8) var<storage, read> added_ranges: array<vec2<u32>>;
@group(0) @binding(9) var<storage, read> added_entries: array<u32>;
@group(0) @binding(10) var<storage, read> added_entry_splats: array<u32>;
@group(0) @binding(11) var<storage, read> added_splats: array<vec4<f32>>;
@group(0) @binding(12) var<storage, read> added_depths: array<u32>;
@group(0) @binding(13) var<storage, read> removed: array<u32>;
@group(0) @binding(14) var<storage, read> dirty: array<u32>;
@group(0) @binding(15) var<storage, read> base_image: array<f32>;
// [layers, 3, H, W]
@group(0) @binding(16) var<storage, read_write> images: array<f32>;

// Splats of each list that are loaded at once.
const BATCH: u32 = TILE_PIXELS / 2u;

var<workgroup> is_dirty: u32;
// Next entry and end of the base's list, then of the individual's.
var<workgroup> ranges: vec4<u32>;
// The base's splats, then the individual's.
var<workgroup> batch: array<TileSplat, TILE_PIXELS>;
// Depth and row of each.
var<workgroup> keys: array<vec2<u32>, TILE_PIXELS>;
var<workgroup> finished_pixels: atomic<u32>;

fn load_base(entry: u32, layer: u32, lane: u32, origin: vec2<f32>) {
    let row = base_entry_splats[entry];
    if row == NO_SPLAT {
        batch[lane] = absent_splat();
        keys[lane] = vec2(0u);
        return;
    }
    keys[lane] = vec2(base_depths[row], row);
    let word = removed[layer * ((window.count + 31u) / 32u) + row / 32u];
    if (word >> (row % 32u) & 1u) == 1u {
        batch[lane] = absent_splat();
    } else {
        batch[lane] = load_tile_splat(row, origin);
    }
}

fn load_added(entry: u32, lane: u32, origin: vec2<f32>) {
    let item = added_entry_splats[entry];
    if item == NO_SPLAT {
        batch[lane] = absent_splat();
        keys[lane] = vec2(0u);
        return;
    }
    keys[lane] = vec2(added_depths[item], items[window.source_first + item].x);
    let a = added_splats[3u * item];
    batch[lane] = TileSplat(a.xy - origin, a.z, added_splats[3u * item + 1u].xyz, added_splats[3u * item + 2u].xyz);
}

fn is_before(a: vec2<u32>, b: vec2<u32>) -> bool {
    return a.x < b.x || (a.x == b.x && a.y < b.y);
}

@compute @workgroup_size(TILE, TILE)
fn main(
    @builtin(workgroup_id) tile: vec3<u32>,
    @builtin(local_invocation_id) local: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let layer = tile.z;
    let origin = vec2(f32(tile.x * TILE), f32(tile.y * TILE));
    let pixel = tile.xy * TILE + local.xy;
    let inside = pixel.x < frame.width && pixel.y < frame.height;
    let pixels = frame.width * frame.height;
    let place = pixel.y * frame.width + pixel.x;
    let index = tile.y * frame.tiles_x + tile.x;
    let layer_index = layer * frame.tiles_x * frame.tiles_y + index;
    if lane == 0u {
        is_dirty = dirty[layer_index];
        ranges = vec4(base_ranges[index], added_ranges[layer_index]);
        atomicStore(&finished_pixels, 0u);
    }
    // 1. A tile that does not change is the base's.
    if workgroupUniformLoad(&is_dirty) == 0u {
        if inside {
            for (var channel = 0u; channel < 3u; channel++) {
                images[(3u * layer + channel) * pixels + place] = base_image[channel * pixels + place];
            }
        }
        return;
    }
    var sight = Sight(vec2<f32>(local.xy), vec3(0.0), 1.0, !inside);
    if sight.finished {
        atomicAdd(&finished_pixels, 1u);
    }
    loop {
        // 2. The next splats of both lists.
        let next = workgroupUniformLoad(&ranges);
        if next.x >= next.y && next.z >= next.w {
            break;
        }
        if lane < BATCH {
            if next.x + lane < next.y {
                load_base(base_entries[next.x + lane], layer, lane, origin);
            }
        } else if next.z + lane - BATCH < next.w {
            load_added(added_entries[next.z + lane - BATCH], lane, origin);
        }
        workgroupBarrier();
        // 3. Merge and blend, until one list needs to be loaded again. Every invocation takes the same path through the
        // lists.
        let base_count = min(BATCH, next.y - next.x);
        let added_count = min(BATCH, next.w - next.z);
        let base_goes_on = next.x + base_count < next.y;
        let added_goes_on = next.z + added_count < next.w;
        var i = 0u;
        var j = 0u;
        while i < base_count || j < added_count {
            if (i == base_count && base_goes_on) || (j == added_count && added_goes_on) {
                break;
            }
            var from_list = BATCH + j;
            if j == added_count || (i < base_count && is_before(keys[i], keys[BATCH + j])) {
                from_list = i;
                i++;
            } else {
                j++;
            }
            if !sight.finished {
                blend(&sight, from_list);
            }
        }
        // 4. Where to go on; nowhere when no pixel needs more.
        workgroupBarrier();
        if lane == 0u {
            ranges = vec4(next.x + i, next.y, next.z + j, next.w);
            if atomicLoad(&finished_pixels) == TILE_PIXELS {
                ranges = vec4(0u);
            }
        }
    }
    if inside {
        let value = sight.colour + sight.transmittance * frame.background.xyz;
        for (var channel = 0u; channel < 3u; channel++) {
            images[(3u * layer + channel) * pixels + place] = value[channel];
        }
    }
}

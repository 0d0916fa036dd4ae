// The last step of the projection: one Gaussian becomes a splat, or none, in a slot of `splats`, `depths` and
// `tile_counts`, which the shader binds. `colour_seen` is a function of the shader, too: the colour of a row
// as the camera sees it, before it is clamped.
fn write_splat(params: Params, row: u32, slot: u32) {
    let g = geometry_of(params);
    var splat: Splat;
    var count = 0u;
    var has_splat = splat_of(g, &splat);
    var colour = vec3(0.0);
    if has_splat {
        colour = colour_seen(row, params.position);
        // Clamping could make any colour of a NaN.
        has_splat = !has_nan(vec4(colour, 0.0));
    }
    if has_splat {
        count = count_tiles(splat) | SPLAT_BIT;
        set_colour(&splat, colour);
        splats[3u * slot] = first_vector(splat);
        splats[3u * slot + 1u] = second_vector(splat);
        splats[3u * slot + 2u] = third_vector(splat);
        depths[slot] = bitcast<u32>(g.t.z);
    }
    tile_counts[slot] = count | select(0u, SEEN_BIT, is_seen(g));
}

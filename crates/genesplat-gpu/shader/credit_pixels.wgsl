// Stage `credit`, step 1: in the place of dL/dimage, the errors of up to three mutants, a channel each; at last, with the
// base in the image, what they are above the base's. The backward blending then sums credits where it sums gradients of
// colours.

// The mutant in the image; beyond the channels, the base.
override MUTANT: u32;

@compute @workgroup_size(TILE, TILE)
fn main(@builtin(workgroup_id) tile: vec3<u32>, @builtin(local_invocation_id) local: vec3<u32>) {
    let pixel = tile.xy * TILE + local.xy;
    if pixel.x >= frame.width || pixel.y >= frame.height {
        return;
    }
    let pixels = frame.width * frame.height;
    let index = pixel.y * frame.width + pixel.x;
    let error = error_at(index);
    if MUTANT < MUTANTS_AT_ONCE {
        gradient[MUTANT * pixels + index] = error;
        return;
    }
    for (var mutant = 0u; mutant < MUTANTS_AT_ONCE; mutant++) {
        gradient[mutant * pixels + index] -= error;
    }
}

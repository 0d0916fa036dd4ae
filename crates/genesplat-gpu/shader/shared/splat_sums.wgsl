// What stages `project_backward` and `blending_weights` have in common: the sums over a splat's tiles. Needs
// `intersection_gradients`: array<vec4<f32>>, three an intersection.

// The gradients of a splat's intersections, summed.
struct Sums {
    a: vec4<f32>,
    b: vec4<f32>,
    c: vec4<f32>,
}

fn plus(x: Sums, y: Sums) -> Sums {
    return Sums(x.a + y.a, x.b + y.b, x.c + y.c);
}

// Of every `pitch`-th intersection in [first, end).
fn sum_of(first: u32, end: u32, pitch: u32) -> Sums {
    var sums = Sums(vec4(0.0), vec4(0.0), vec4(0.0));
    for (var intersection = first; intersection < end; intersection += pitch) {
        let at = 3u * intersection;
        let a = intersection_gradients[at];
        sums = plus(sums, Sums(a, intersection_gradients[at + 1u], intersection_gradients[at + 2u]));
    }
    return sums;
}

// Splats of so many tiles that one invocation would keep all others waiting: first intersection, the one
// after the last, invocation. No vectors: these would be of four numbers in memory, and exceed the 16 KiB
// that every device has.
var<workgroup> wide: array<array<u32, 3>, GROUP>;
var<workgroup> wide_found: atomic<u32>;
var<workgroup> wide_count: u32;
var<workgroup> partial_sums: array<Sums, GROUP>;

// The sums of an invocation's splat. All invocations of the workgroup must ask: together they sum those of
// wide splats, always in the same order.
fn sums_of_splat(first: u32, count: u32, lane: u32) -> Sums {
    if lane == 0u {
        atomicStore(&wide_found, 0u);
    }
    workgroupBarrier();
    var sums = Sums(vec4(0.0), vec4(0.0), vec4(0.0));
    if count <= SERIAL_TILES {
        sums = sum_of(first, first + count, 1u);
    } else {
        wide[atomicAdd(&wide_found, 1u)] = array(first, first + count, lane);
    }
    workgroupBarrier();
    if lane == 0u {
        wide_count = atomicLoad(&wide_found);
    }
    let splats = workgroupUniformLoad(&wide_count);
    for (var k = 0u; k < splats; k++) {
        partial_sums[lane] = sum_of(wide[k][0] + lane, wide[k][1], GROUP);
        for (var half = GROUP / 2u; half > 0u; half /= 2u) {
            workgroupBarrier();
            if lane < half {
                partial_sums[lane] = plus(partial_sums[lane], partial_sums[lane + half]);
            }
        }
        workgroupBarrier();
        if lane == wide[k][2] {
            sums = partial_sums[0];
        }
        workgroupBarrier();
    }
    return sums;
}

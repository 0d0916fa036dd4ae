// Counter-based random words, the CPU's to the bit: Philox4x32-10 (Salmon et al., SC 2011).

// High 32 bits of a product.
fn multiply_high(a: u32, b: u32) -> u32 {
    let al = a & 0xffffu; let ah = a >> 16u;
    let bl = b & 0xffffu; let bh = b >> 16u;
    let low = al * bl;
    let mid = ah * bl + (low >> 16u);
    let mid2 = al * bh + (mid & 0xffffu);
    return ah * bh + (mid >> 16u) + (mid2 >> 16u);
}

fn philox(start: vec4<u32>, first_key: vec2<u32>) -> vec4<u32> {
    var c = start;
    var key = first_key;
    for (var round = 0u; round < 10u; round++) {
        c = vec4(
            multiply_high(c.z, 0xcd9e8d57u) ^ c.y ^ key.x,
            c.z * 0xcd9e8d57u,
            multiply_high(c.x, 0xd2511f53u) ^ c.w ^ key.y,
            c.x * 0xd2511f53u,
        );
        key += vec2(0x9e3779b9u, 0xbb67ae85u);
    }
    return c;
}

// Two standard normal numbers (Box-Muller), which the CPU computes in f64. The words are the CPU's to the
// bit, but how near these come is the driver's choice: WGSL promises sines and cosines within 2^-11 (most
// drivers are far better), and only from -pi to pi.
fn normals(a: u32, b: u32) -> vec2<f32> {
    // (0, 1]: the logarithm never sees zero.
    let u = (f32(a) + 1.0) * (1.0 / 4294967296.0);
    // Half a turn before the CPU's angle, which negates both.
    let v = f32(bitcast<i32>(b ^ 0x80000000u)) * (TAU / 4294967296.0);
    // A driver's log may be a little above 0 just below 1.
    let radius = sqrt(max(-2.0 * log(u), 0.0));
    return -radius * vec2(cos(v), sin(v));
}

// Three standard normal numbers for one address.
fn normals_at(stream: u32, a: u32, b: u32, c: u32, key: vec2<u32>) -> vec3<f32> {
    let words = philox(vec4(a, b, c, stream), key);
    return vec3(normals(words.x, words.y), normals(words.z, words.w).x);
}

// The steps of a vector of colours from step `made` on, without gradients. Needs `sh`, `first_moments`,
// `second_moments` and `steps`.
fn make_up(at: u32, made: u32) {
    var value = sh[at];
    var m = first_moments[at];
    var v = second_moments[at];
    for (var step = made; step < steps.count; step++) {
        let rates = steps.rates[step];
        value = adam(value, vec4(0.0), &m, &v, colour_rate(at, rates.x, rates.y), vec4(rates.z));
    }
    sh[at] = value;
    first_moments[at] = m;
    second_moments[at] = v;
}

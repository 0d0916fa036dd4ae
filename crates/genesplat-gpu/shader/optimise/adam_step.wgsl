// One Adam step of four values at once; `m` and `v` are the moments.

fn adam(value: vec4<f32>, gradient: vec4<f32>, m: ptr<function, vec4<f32>>, v: ptr<function, vec4<f32>>,
        rate: vec4<f32>, root: vec4<f32>) -> vec4<f32> {
    *m = ADAM_BETA1 * *m + (1.0 - ADAM_BETA1) * gradient;
    *v = ADAM_BETA2 * *v + (1.0 - ADAM_BETA2) * gradient * gradient;
    return value - rate * *m / (sqrt(*v) * root + ADAM_EPSILON);
}

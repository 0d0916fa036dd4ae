// Steps that the optimiser has made since all colours had made all of them: the rates of the first
// coefficient and of the others, and the second factor. A row that has no splat has no gradient, so that its
// step depends on nothing else; it makes up for it when it is seen next, or when colours are wanted as a
// whole. The same operations in the same order.

struct ColourSteps {
    count: u32,
    rates: array<vec4<f32>>,
}

// Vectors of colour of a row.
const VECTORS: u32 = 12u;

// The rate of a vector's step.
fn colour_rate(at: u32, first: f32, rest: f32) -> vec4<f32> {
    return select(vec4(rest), vec4(vec3(first), rest), at % VECTORS == 0u);
}

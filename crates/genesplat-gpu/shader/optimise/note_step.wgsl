// Ends the optimiser's step of the colours: rows without a splat have it to make up for.

@group(0) @binding(0) var<uniform> optimiser: Optimiser;
@group(0) @binding(1) var<storage, read> counters: Counters;
@group(0) @binding(2) var<storage, read_write> steps: ColourSteps;

@compute @workgroup_size(1)
fn main() {
    if counters.halted != 0u {
        return;
    }
    steps.rates[steps.count] = vec4(optimiser.sh_dc, optimiser.sh_rest, optimiser.root, 0.0);
    steps.count += 1u;
}

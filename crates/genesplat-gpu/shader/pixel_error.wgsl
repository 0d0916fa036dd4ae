// What stages `weigh` and `credit` have in common: the error of a pixel, and a place for what is to be summed.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> photo: array<u32>;
// In the place of dL/dimage [3, H, W].
@group(0) @binding(3) var<storage, read_write> gradient: array<f32>;

// |I - P| of all channels together.
fn error_at(index: u32) -> f32 {
    let pixels = frame.width * frame.height;
    var error = 0.0;
    for (var channel = 0u; channel < 3u; channel++) {
        error += abs(image[channel * pixels + index] - photo_value(photo[index], channel));
    }
    return error;
}

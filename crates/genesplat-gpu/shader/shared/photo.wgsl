// Photos, red in the lowest byte of a word, then green and blue [H, W]. The highest byte is 0 where the pixel
// counts.

// A channel of an 8-bit photo in [0, 1].
fn photo_value(rgb: u32, channel: u32) -> f32 {
    return f32((rgb >> (8u * channel)) & 0xffu) * (1.0 / 255.0);
}

fn counts(rgb: u32) -> bool {
    return (rgb >> 24u) == 0u;
}

// Photos, red in the lowest byte of a word, then green and blue [H, W].

// A channel of an 8-bit photo in [0, 1].
fn photo_value(rgb: u32, channel: u32) -> f32 {
    return f32((rgb >> (8u * channel)) & 0xffu) * (1.0 / 255.0);
}

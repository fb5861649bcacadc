// Exposes, clips and encodes by the sRGB curve: colour (height, width, 3), exposure (1,) -> output (height, width, 3).
extern "C" __global__ void encode_srgb(View colour, View exposure, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const float scale = exposure.at[0];
    const int here = 3 * (y * width + x);
    for (int c = 0; c < 3; c++) {
        const float light = colour.at[here + c] * scale;
        const float value = light > 0.0f ? fminf(light, 1.0f) : 0.0f;  // NaN becomes 0
        output.at[here + c] = value <= 0.0031308f ? 12.92f * value : 1.055f * powf(value, 1.0f / 2.4f) - 0.055f;
    }
}

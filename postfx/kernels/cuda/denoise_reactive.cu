// The mask of what is in front of opaque things: colour, opaque_colour (h, w, 3), difference (3,), which is exposure,
// scale and threshold -> reactive (h, w, 1).

// Exposed light as a display shows it, 0 to 1.
__device__ inline float seen(float value, float exposure) {
    const float light = fminf(clamped(value, 0.0f, MAX_FLOAT) * exposure, MAX_COLOUR);
    return sqrtf(light / (1.0f + light));
}

extern "C" __global__ void denoise_reactive(View colour, View opaque_colour, View difference, View reactive) {
    const int width = reactive.size[1];
    PIXEL(width, reactive.size[0]);
    const int here = y * width + x;
    const float exposure = difference.at[0], scale = difference.at[1], threshold = difference.at[2];
    float most = 0.0f;
    for (int c = 0; c < 3; c++)
        most = fmaxf(most, fabsf(seen(colour.at[3 * here + c], exposure)
                                 - seen(opaque_colour.at[3 * here + c], exposure)));
    reactive.at[here] = most >= threshold ? fminf(most * scale, 1.0f) : 0.0f;
}

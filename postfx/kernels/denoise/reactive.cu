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

// The largest value in 3x3, within 0 and 1: reactive (h, w, 1) -> next_reactive (h, w, 1).
extern "C" __global__ void denoise_spread(View reactive, View next_reactive) {
    const int height = reactive.size[0], width = reactive.size[1];
    PIXEL(width, height);
    float most = 0.0f;
#pragma unroll
    for (int j = -1; j <= 1; j++) {
#pragma unroll
        for (int i = -1; i <= 1; i++)
            most = fmaxf(most, clamped(reactive.at[within(y + j, height) * width + within(x + i, width)], 0.0f, 1.0f));
    }
    next_reactive.at[y * width + x] = most;
}

// How much of the history each pixel of a part uses: reactive and last_reactive (h, w, 1), moved (th, tw, 2),
// part_rows (th,), part_columns (tw,) -> keep (th, tw, 1).
extern "C" __global__ void denoise_keep(View reactive, View last_reactive, View moved, View part_rows,
                                        View part_columns, View keep) {
    const int width = keep.size[1], h = reactive.size[0], w = reactive.size[1];
    PIXEL(width, keep.size[0]);
    const float v = part_rows.at[y], u = part_columns.at[x];
    const Pair motion = pair(moved, size_t(y) * width + x);
    const int from = within(int(rintf(v + motion.y)), h) * w + within(int(rintf(u + motion.x)), w);
    const float now = clamped(reactive.at[int(v) * w + int(u)], 0.0f, 1.0f);
    keep.at[y * width + x] = 1.0f - fmaxf(now, last_reactive.at[from]);
}

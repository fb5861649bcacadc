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

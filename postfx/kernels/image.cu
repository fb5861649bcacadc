// Cubic resampling: image (h, w, channels), rows (height,), columns (width,) -> output (height, width, channels).
extern "C" __global__ void resample(View image, View rows, View columns, View output) {
    const int width = output.size[1], channels = image.size[2];
    PIXEL(width, output.size[0]);
    resampled(image, channels, cubic(rows.at[y], image.size[0]), cubic(columns.at[x], image.size[1]),
              output.at + (size_t(y) * width + x) * channels);
}

// Enlarges a premultiplied overlay: image (h, w, 4), rows (height,), columns (width,) -> output (height, width, 4).
// Colours stay within what the four nearest pixels' own colours make of the coverage that comes out.
extern "C" __global__ void overlay_enlarge(View image, View rows, View columns, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const Cubic down = cubic(rows.at[y], image.size[0]), across = cubic(columns.at[x], image.size[1]);
    float* const result = output.at + 4 * (size_t(y) * width + x);
    resampled(image, 4, down, across, result);
    const float alpha = clamped(result[3], 0.0f, 1.0f);
    result[3] = alpha;
    for (int c = 0; c < 3; c++) {
        const float ENDLESS = __int_as_float(0x7f800000);  // the GPU's compiler has no <cmath>
        float low = ENDLESS, high = -ENDLESS;
#pragma unroll
        for (int i = 0; i < 4; i++) {
            const int row = i < 2 ? down.index[1] : down.index[2], column = i % 2 ? across.index[2] : across.index[1];
            const float* const pixel = image.at + 4 * (size_t(row) * image.size[1] + column);
            const float light = known(pixel[c]), covered = known(pixel[3]);
            if (covered <= 0.0f && light == 0.0f) continue;  // nothing there
            const float own = covered > 0.0f ? light / covered : light > 0.0f ? ENDLESS : -ENDLESS;
            low = fminf(low, own);
            high = fmaxf(high, own);
        }
        if (fabsf(high) <= LARGEST_FLOAT) result[c] = fminf(result[c], high * alpha);
        if (fabsf(low) <= LARGEST_FLOAT) result[c] = fmaxf(result[c], low * alpha);
    }
}

// Premultiplied overlay (h, w, 4) over colour (h, w, 3) -> output (h, w, 3).
extern "C" __global__ void overlay_over(View overlay, View colour, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = size_t(y) * width + x;
    const float* const front = overlay.at + 4 * here;
    const float alpha = clamped(front[3], 0.0f, 1.0f);
    for (int c = 0; c < 3; c++) output.at[3 * here + c] = over(front[c], alpha, colour.at[3 * here + c]);
}

// Coverage of a premultiplied overlay (h, w, 4) over alpha (h, w, 1) -> output (h, w, 1).
extern "C" __global__ void overlay_over_alpha(View overlay, View alpha, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = size_t(y) * width + x;
    const float covered = clamped(overlay.at[4 * here + 3], 0.0f, 1.0f);
    output.at[here] = over(covered, covered, alpha.at[here]);
}

// A checkerboard of two greys: rows (height,), columns (width,), greys (2,) -> output (height, width, 3).
extern "C" __global__ void checkerboard(View rows, View columns, View greys, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const float grey = rows.at[y] == columns.at[x] ? greys.at[0] : greys.at[1];
    for (int c = 0; c < 3; c++) output.at[3 * (y * width + x) + c] = grey;
}

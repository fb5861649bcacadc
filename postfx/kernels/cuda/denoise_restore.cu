// Gives detail back: colour, denoised (h, w, 3), detail (tiles_high, tiles_wide, 1) -> output (h, w, 3).

struct Between {
    int first, second;
    float share;
};

// The tile before a pixel, the one after it, and how far the pixel lies between their centres.
__device__ inline Between tiles_at(int position, int count) {
    const float at = fminf(fmaxf((position + 0.5f) * (1.0f / 16) - 0.5f, 0.0f), float(count - 1));
    const int first = int(at);
    return {first, min(first + 1, count - 1), at - first};
}

extern "C" __global__ void denoise_restore(View colour, View denoised, View detail, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const Between row = tiles_at(y, detail.size[0]), column = tiles_at(x, detail.size[1]);
    const float* const top = detail.at + row.first * detail.size[1];
    const float* const bottom = detail.at + row.second * detail.size[1];
    const float upper = top[column.first] + (top[column.second] - top[column.first]) * column.share;
    const float lower = bottom[column.first] + (bottom[column.second] - bottom[column.first]) * column.share;
    const float share = upper + (lower - upper) * row.share;
    const int here = 3 * (y * width + x);
    for (int c = 0; c < 3; c++) {
        const float clean = denoised.at[here + c], noisy = clamped(colour.at[here + c], 0.0f, MAX_FLOAT);
        output.at[here + c] = share == 1.0f ? noisy : clean + (noisy - clean) * share;  // exact where all is detail
    }
}

// A picture from what was computed in parts of it: tiles (n, th, tw, c), places (n, 10): origin, what may be used, what
// is used before others; frame_rows (rows,), frame_columns (columns,) -> picture (rows, columns, c), 0 where no tile is.
__device__ inline bool is_within(const float* box, int y, int x) {
    return y >= box[0] && x >= box[1] && y < box[2] && x < box[3];
}

extern "C" __global__ void denoise_assemble(View tiles, View places, View frame_rows, View frame_columns,
                                            View picture) {
    PIXEL(picture.size[1], picture.size[0]);
    const int v = int(frame_rows.at[y]), u = int(frame_columns.at[x]), channels = picture.size[2];
    int owner = -1;
    for (int i = tiles.size[0] - 1; i >= 0; i--)
        if (is_within(places.at + 10 * i + 2, v, u)) owner = i;
    for (int i = tiles.size[0] - 1; i >= 0; i--)
        if (is_within(places.at + 10 * i + 6, v, u)) owner = i;
    const float* const place = places.at + 10 * max(owner, 0);
    const size_t row = size_t(max(owner, 0)) * tiles.size[1] + (v - int(place[0]));
    const float* const from = tiles.at + (row * tiles.size[2] + (u - int(place[1]))) * channels;
    float* const to = picture.at + (size_t(y) * picture.size[1] + x) * channels;
    for (int c = 0; c < channels; c++) to[c] = owner < 0 ? 0.0f : from[c];
}

// Leaves the noise in by strength: denoised, plain (h, w, 3), strength (h, w, 1), amount (1,) -> output (h, w, 3).
extern "C" __global__ void denoise_strength(View denoised, View plain, View strength, View amount, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const int here = y * width + x;
    const float share = clamped(strength.at[here], 0.0f, 1.0f) * clamped(amount.at[0], 0.0f, 1.0f);
    for (int c = 0; c < 3; c++) {
        const float noisy = plain.at[3 * here + c], clean = denoised.at[3 * here + c];
        output.at[3 * here + c] = share == 1.0f ? clean : noisy + (clean - noisy) * share;  // both ends are exact
    }
}

// Importance-weighted mean over 2x2 pixels: finer (4, about 2 hp, about 2 wp), rows (hp,) and columns (wp,) of it that
// cells begin at, -1 before the first -> level (4, hp, wp); channel 3 is the importance, 0 beyond the finer level.
extern "C" __global__ void denoise_pool(View finer, View rows, View columns, View level) {
    const int height = level.size[1], width = level.size[2];
    PIXEL(width, height);
    const int finer_height = finer.size[1], finer_width = finer.size[2];
    const size_t plane = size_t(height) * width, fine = size_t(finer_height) * finer_width;
    const int top = int(rows.at[y]), left = int(columns.at[x]);
    float sum[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int j = 0; j < 2; j++) {
        for (int i = 0; i < 2; i++) {
            const int v = top + j, u = left + i;
            if (v < 0 || v >= finer_height || u < 0 || u >= finer_width) continue;
            const float* from = finer.at + size_t(v) * finer_width + u;
            const float weight = from[3 * fine];
            sum[3] += weight;
            for (int c = 0; c < 3; c++) sum[c] += weight * from[c * fine];
        }
    }
    const float total = 0.25f * sum[3], share = 0.25f / (total + TINY);
    float* to = level.at + size_t(y) * width + x;
    for (int c = 0; c < 3; c++) to[c * plane] = share * sum[c];
    to[3 * plane] = total;
}

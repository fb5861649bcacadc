// Levels hold the picture, or n of its parts behind one another.

// Mean over 2x2 pixels, weighted by their importance: finer (3 n, about 2 hp, about 2 wp), finer_importance (1, the same),
// rows (hp,) and columns (wp,) of them that cells begin at, -1 before the first -> level (3 n, hp, wp), importance
// (1, hp, wp). What lies beyond the finer level has none.
extern "C" __global__ void denoise_pool(View finer, View finer_importance, View rows, View columns, View level,
                                        View importance) {
    const int height = level.size[1], width = level.size[2];
    PIXEL(width, height);
    const int finer_height = finer.size[1], finer_width = finer.size[2];
    const size_t plane = size_t(height) * width, fine = size_t(finer_height) * finer_width;
    const int top = int(rows.at[y]), left = int(columns.at[x]);
    for (int k = 0; k < level.size[0]; k += 3) {
        float sum[3] = {0.0f, 0.0f, 0.0f}, weights = 0.0f;
        for (int j = 0; j < 2; j++) {
            for (int i = 0; i < 2; i++) {
                const int v = top + j, u = left + i;
                if (v < 0 || v >= finer_height || u < 0 || u >= finer_width) continue;
                const size_t there = size_t(v) * finer_width + u;
                const float weight = finer_importance.at[there];
                weights += weight;
                for (int c = 0; c < 3; c++) sum[c] += weight * finer.at[(k + c) * fine + there];
            }
        }
        const float total = 0.25f * weights, share = 0.25f / (total + TINY);
        const size_t here = size_t(y) * width + x;
        for (int c = 0; c < 3; c++) level.at[(k + c) * plane + here] = share * sum[c];
        importance.at[here] = total;
    }
}

// The coarser result where the network trusts it more than the level's own colour: coarse (3 n, about hp / 2, about wp / 2),
// level (3 n, hp, wp), heads (1, 26 or more, hp, wp), rows (hp,) and columns (wp,) of coarse that pixels lie in
// -> mixed (3 n, hp, wp).
template <class Number>
__device__ inline void mix(View coarse, View level, View heads, View rows, View columns, View mixed) {
    const int height = mixed.size[1], width = mixed.size[2];
    PIXEL(width, height);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    const size_t below_plane = size_t(coarse.size[1]) * coarse.size[2];
    const size_t below = size_t(int(rows.at[y])) * coarse.size[2] + int(columns.at[x]);
    // The full head has the channel elsewhere than the short ones of the coarser levels.
    const size_t channel = heads.size[1] > KERNEL + 1 ? MIX : KERNEL;
    const float own = as_float(numbers<Number>(heads)[channel * plane + here]);
    for (int k = 0; k < mixed.size[0]; k++) {
        const float from = coarse.at[k * below_plane + below];
        mixed.at[k * plane + here] = from + (level.at[k * plane + here] - from) * own;
    }
}

extern "C" __global__ void denoise_mix(View coarse, View level, View heads, View rows, View columns, View mixed) {
    mix<float>(coarse, level, heads, rows, columns, mixed);
}

extern "C" __global__ void denoise_mix_half(View coarse, View level, View heads, View rows, View columns, View mixed) {
    mix<Half>(coarse, level, heads, rows, columns, mixed);
}

// The 5x5 kernel of a level: mixed (3 n, hp, wp), heads (1, 25 or more, hp, wp), area (2,) -> filtered (3 n, hp, wp).
template <class Number>
__device__ inline void filter(View mixed, View heads, View area, View filtered) {
    const int height = filtered.size[1], width = filtered.size[2], plane = height * width;
    PIXEL(width, height);
    const int rows = int(area.at[0]), columns = int(area.at[1]), here = y * width + x;
    for (int k = 0; k < filtered.size[0]; k += 3) {
        const float* const from = mixed.at + size_t(k) * plane;
        float* const to = filtered.at + size_t(k) * plane + here;
        Colour sum = {0.0f, 0.0f, 0.0f};
        float total = TINY;
        if (y < rows && x < columns) {
            for (int j = 0; j < 5; j++) {
                const int v = y + j - 2;
                if (v < 0 || v >= rows) continue;
                for (int i = 0; i < 5; i++) {
                    const int u = x + i - 2;
                    if (u < 0 || u >= columns) continue;
                    const float weight = as_float(numbers<Number>(heads)[(5 * j + i) * plane + here]);
                    const int there = v * width + u;
                    total += weight;
                    sum.r += weight * from[there];
                    sum.g += weight * from[plane + there];
                    sum.b += weight * from[2 * plane + there];
                }
            }
        }
        to[0] = sum.r / total;
        to[plane] = sum.g / total;
        to[2 * plane] = sum.b / total;
    }
}

extern "C" __global__ void denoise_filter(View mixed, View heads, View area, View filtered) {
    filter<float>(mixed, heads, area, filtered);
}

extern "C" __global__ void denoise_filter_half(View mixed, View heads, View area, View filtered) {
    filter<Half>(mixed, heads, area, filtered);
}

// Filtered colour times reflectance, a border of repeated pixels around it; before that, in `BOTH`, the colour itself.
template <bool BOTH>
__device__ inline void remodulate(const View& filtered, const View& factor, const View& part_rows,
                                  const View& part_columns, const View& radiance) {
    const int height = radiance.size[1], width = radiance.size[2];
    PIXEL(width, height);
    const int v = int(part_rows.at[within(y - 1, height - 2)]) - int(part_rows.at[0]);
    const int u = int(part_columns.at[within(x - 1, width - 2)]) - int(part_columns.at[0]);
    const size_t from = size_t(filtered.size[1]) * filtered.size[2], there = size_t(v) * filtered.size[2] + u;
    const float* const by = factor.at + 3 * (size_t(v) * factor.size[1] + u);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
#pragma unroll
    for (int c = 0; c < 3; c++) {
        const float light = filtered.at[c * from + there];
        if (BOTH) radiance.at[c * plane + here] = light;
        radiance.at[((BOTH ? 3 : 0) + c) * plane + here] = light * by[c];
    }
}

// filtered (3, hp, wp), factor (th, tw, 3), part_rows (th,), part_columns (tw,) -> radiance (3, th + 2, tw + 2),
// exposed linear.
extern "C" __global__ void denoise_remodulate(View filtered, View factor, View part_rows, View part_columns,
                                              View radiance) {
    remodulate<false>(filtered, factor, part_rows, part_columns, radiance);
}

// The same -> radiance (6, th + 2, tw + 2).
extern "C" __global__ void denoise_remodulate_both(View filtered, View factor, View part_rows, View part_columns,
                                                   View radiance) {
    remodulate<true>(filtered, factor, part_rows, part_columns, radiance);
}

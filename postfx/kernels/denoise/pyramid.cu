// Levels hold the picture, n of its parts behind one another, or one plane.

// Mean over 2x2 pixels, weighted by their importance: finer (planes, about 2 hp, about 2 wp), finer_importance (1, the same),
// rows (hp,) and columns (wp,) of them that cells begin at, -1 before the first -> level (planes, hp, wp), importance
// (1, hp, wp). What lies beyond the finer level has none.
extern "C" __global__ void denoise_pool(View finer, View finer_importance, View rows, View columns, View level,
                                        View importance) {
    const int height = level.size[1], width = level.size[2];
    PIXEL(width, height);
    const int finer_height = finer.size[1], finer_width = finer.size[2];
    const size_t plane = size_t(height) * width, fine = size_t(finer_height) * finer_width;
    const int top = int(rows.at[y]), left = int(columns.at[x]);
    for (int k = 0; k < level.size[0]; k += 3) {
        const int some = min(3, level.size[0] - k);
        float sum[3] = {0.0f, 0.0f, 0.0f}, weights = 0.0f;
        for (int j = 0; j < 2; j++) {
            for (int i = 0; i < 2; i++) {
                const int v = top + j, u = left + i;
                if (v < 0 || v >= finer_height || u < 0 || u >= finer_width) continue;
                const size_t there = size_t(v) * finer_width + u;
                const float weight = finer_importance.at[there];
                weights += weight;
                for (int c = 0; c < some; c++) sum[c] += weight * finer.at[(k + c) * fine + there];
            }
        }
        const float total = 0.25f * weights, share = 0.25f / (total + TINY);
        const size_t here = size_t(y) * width + x;
        for (int c = 0; c < some; c++) level.at[(k + c) * plane + here] = share * sum[c];
        importance.at[here] = total;
    }
}

// The coarser result where the network trusts it more than the level's own colour: coarse (planes, about hp / 2, about wp / 2),
// level (planes, hp, wp), heads (1, 26 or more, hp, wp), rows (hp,) and columns (wp,) of coarse that pixels lie in
// -> mixed (planes, hp, wp).
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

// The 5x5 kernel of a level: mixed (planes, hp, wp), heads (1, 25 or more, hp, wp), area (2,) -> filtered (planes, hp, wp).
template <class Number>
__device__ inline void filter(View mixed, View heads, View area, View filtered) {
    const int height = filtered.size[1], width = filtered.size[2], plane = height * width;
    PIXEL(width, height);
    const int rows = int(area.at[0]), columns = int(area.at[1]), here = y * width + x;
    for (int k = 0; k < filtered.size[0]; k += 3) {
        const float* const from = mixed.at + size_t(k) * plane;
        float* const to = filtered.at + size_t(k) * plane + here;
        const int second = k + 1 < filtered.size[0] ? plane : 0, third = 2 * second;  // one plane is read three times
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
                    sum.g += weight * from[second + there];
                    sum.b += weight * from[third + there];
                }
            }
        }
        to[0] = sum.r / total;
        to[second] = sum.g / total;
        to[third] = sum.b / total;
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

// The means of samples as the finest level of what is filtered: next_samples (2 h, 2 w, 1), part_rows (th,), part_columns
// (tw,), seen_rows (hp,), seen_columns (wp,) -> level (1, hp, wp), 0 beyond the part.
extern "C" __global__ void denoise_alpha_level(View next_samples, View part_rows, View part_columns, View seen_rows,
                                               View seen_columns, View level) {
    const int width = level.size[2];
    PIXEL(width, level.size[1]);
    const bool held = y < part_rows.size[0] && x < part_columns.size[0];
    level.at[size_t(y) * width + x] = held ? pixel_mean(next_samples, int(part_rows.at[y]), int(part_columns.at[x]),
                                                        next_samples.size[1] / 2) : 0.0f;
}

// Filtered alpha at output size, by the picture's weights of 3x3 pixels: filtered (1, hp, wp), fine (1, 80, hp, wp),
// part_rows (th,), part_columns (tw,), params (4,), window (8,), near (cells, cells), out_rows (out_th,), out_columns
// (out_tw,) -> enlarged (out_th, out_tw, 1). Where nothing is near, that of the pixel itself.
template <class Number>
__device__ inline void enlarge_alpha(View filtered, View fine, View part_rows, View part_columns, View params, View window,
                                     View near, View out_rows, View out_columns, View enlarged) {
    const int width = enlarged.size[1];
    PIXEL(width, enlarged.size[0]);
    const Window part = window_of(window);
    const int h = part_rows.size[0], w = part_columns.size[0], line = filtered.size[2];
    float u, v;
    const int column = within(centre(int(out_columns.at[x]), part.w, part.width, u) - part.left, w);
    const int row = within(centre(int(out_rows.at[y]), part.h, part.height, v) - part.top, h);
    float* const to = enlarged.at + size_t(y) * width + x;
    if (nearness(near, part.top + row, part.left + column) <= 0.0f) {
        *to = clamped(filtered.at[size_t(row) * line + column], 0.0f, 1.0f);
        return;
    }
    const float right = fminf(fmaxf(2.0f * u + 0.5f, 0.0f), 1.0f), lower = fminf(fmaxf(2.0f * v + 0.5f, 0.0f), 1.0f);
    const size_t plane = size_t(fine.size[2]) * fine.size[3];
    const Number* const head = numbers<Number>(fine) + size_t(row) * fine.size[3] + column;
    float sum = 0.0f, total = TINY;
    for (int j = 0; j < 3; j++) {
        const float* const from = filtered.at + size_t(within(row + j - 1, h)) * line;
        const float across = gauss(j - 1 + params.at[JITTER_Y] - v);
        for (int i = 0; i < 3; i++) {
            const float prior = across * gauss(i - 1 + params.at[JITTER_X] - u);
            const Number* const tap = head + (TAP_WEIGHTS + 4 * (3 * j + i)) * plane;
            const float weight = at_corner<false>(tap, plane, 0, right, lower) * prior;
            total += weight;
            sum += weight * from[within(column + i - 1, w)];
        }
    }
    *to = clamped(sum / total, 0.0f, 1.0f);
}

extern "C" __global__ void denoise_enlarge_alpha(View filtered, View fine, View part_rows, View part_columns,
                                                 View params, View window, View near, View out_rows,
                                                 View out_columns, View enlarged) {
    enlarge_alpha<float>(filtered, fine, part_rows, part_columns, params, window, near, out_rows, out_columns, enlarged);
}

extern "C" __global__ void denoise_enlarge_alpha_half(View filtered, View fine, View part_rows, View part_columns,
                                                      View params, View window, View near, View out_rows,
                                                      View out_columns, View enlarged) {
    enlarge_alpha<Half>(filtered, fine, part_rows, part_columns, params, window, near, out_rows, out_columns, enlarged);
}

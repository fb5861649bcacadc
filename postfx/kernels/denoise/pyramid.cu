#include "pyramid.h"

// Levels hold the picture, n of its parts behind one another, or one plane.
const int BLOCK = 256;

// A cell whose first pixel is at (top, left) of a level, and where in a plane its pixels are. Those
// beyond have no weight.
FN Cell<float> pool_of(const View& importance, int top, int left, size_t (&there)[4]) {
    const int height = importance.size[1], width = importance.size[2];
    float weights[4];
    UNROLL for (int i = 0; i < 4; i++) {
        const int v = top + i / 2, u = left + i % 2;
        there[i] = size_t(clip(v, height)) * width + clip(u, width);
        const bool held = v >= 0 && v < height && u >= 0 && u < width;
        const float weight = held ? importance.at[there[i]] : 0.0f;
        // NaN stays
        weights[i] = held && weight < LEAST_IMPORTANCE ? LEAST_IMPORTANCE : weight;
    }
    return cell_of<float>(weights[0], weights[1], weights[2], weights[3]);
}

// finer (planes, about 2 hp, about 2 wp), finer_importance (1, the same), rows (hp,) and columns
// (wp,) of them that cells begin at, -1 before the first -> level (planes, hp, wp), importance (1,
// hp, wp).
extern "C" __global__ void denoise_pool(View finer, View finer_importance, View rows, View columns,
                                        View level, View importance) {
    const int height = level.size[1], width = level.size[2];
    PIXEL(width, height);
    const size_t plane = size_t(height) * width, fine = size_t(finer.size[1]) * finer.size[2];
    const size_t here = size_t(y) * width + x;
    size_t there[4];
    const Cell<float> cell = pool_of(finer_importance, int(rows.at[y]), int(columns.at[x]), there);
    for (int k = 0; k < level.size[0]; k++) {
        const float* const from = finer.at + k * fine;
        level.at[k * plane + here] = pooled<float>(cell, from[there[0]], from[there[1]],
                                                   from[there[2]], from[there[3]]);
    }
    importance.at[here] = cell.importance;
}

// All levels: finer (planes, hp, wp), finer_importance (1, hp, wp), firsts (8,), in which row of a
// finer level the first cell begins, 0 or -1, then in which column -> four levels (planes, ...) and
// their importance (1, ...). A block makes 16x16 cells of the first level and what lies above them.
const int TREE = 16, LAST = 4;

extern "C" __global__ void __launch_bounds__(BLOCK, 4)
    denoise_pools(View finer, View finer_importance, View firsts, View level1, View level2,
                  View level3, View level4, View importance1, View importance2, View importance3,
                  View importance4) {
    __shared__ float cells[LAST - 1][4][TREE][TREE];
    const View levels[LAST] = {level1, level2, level3, level4};
    const View totals[LAST] = {importance1, importance2, importance3, importance4};
    int first_row = 0, first_column = 0;  // of the first tree in a level
    int high = 0, wide = 0;
    UNROLL for (int i = LAST - 1; i >= 0; i--) {
        const int side = TREE >> i;
        high = max(high, (levels[i].size[1] - first_row + side - 1) / side);
        wide = max(wide, (levels[i].size[2] - first_column + side - 1) / side);
        if (i > 0) {
            first_row = 2 * first_row + int(firsts.at[i]);
            first_column = 2 * first_column + int(firsts.at[LAST + i]);
        }
    }
    const int count = high * wide, thread = threadIdx.x;
    for (int tree = blockIdx.y; tree < count; tree += gridDim.y) {
        for (int k = 0; k < level1.size[0]; k += 3) {
            const int planes = min(3, level1.size[0] - k);
            int top = first_row + TREE * (tree / wide), left = first_column + TREE * (tree % wide);
            UNROLL for (int level = 0; level < LAST; level++) {
                const int side = TREE >> level, j = thread / side, i = thread % side, y = top + j,
                          x = left + i;
                const int height = levels[level].size[1], width = levels[level].size[2];
                if (j < side) {
                    float found[4];
                    if (level == 0) {
                        size_t there[4];
                        const Cell<float> cell =
                            pool_of(finer_importance, 2 * y + int(firsts.at[0]),
                                    2 * x + int(firsts.at[LAST]), there);
                        const size_t plane = size_t(finer.size[1]) * finer.size[2];
                        UNROLL for (int c = 0; c < 3; c++) {
                            const float* const from = finer.at + (k + min(c, planes - 1)) * plane;
                            found[c] = pooled<float>(cell, from[there[0]], from[there[1]],
                                                     from[there[2]], from[there[3]]);
                        }
                        found[3] = cell.importance;
                    } else {
                        const auto& from = cells[level - 1];
                        const int v = 2 * j, u = 2 * i;
                        const Cell<float> cell = cell_of<float>(
                            from[3][v][u], from[3][v][u + 1], from[3][v + 1][u],
                            from[3][v + 1][u + 1]);
                        UNROLL for (int c = 0; c < 3; c++)
                            found[c] = pooled<float>(cell, from[c][v][u], from[c][v][u + 1],
                                                     from[c][v + 1][u], from[c][v + 1][u + 1]);
                        found[3] = cell.importance;
                    }
                    if (y >= 0 && y < height && x >= 0 && x < width) {
                        const size_t here = size_t(y) * width + x, plane = size_t(height) * width;
                        UNROLL for (int c = 0; c < 3; c++)
                            if (c < planes) levels[level].at[(k + c) * plane + here] = found[c];
                        totals[level].at[here] = found[3];
                    } else {
                        found[3] = 0.0f;
                    }
                    UNROLL for (int c = 0; c < 4 && level < LAST - 1; c++)
                        cells[level][c][j][i] = found[c];
                }
                if (level < LAST - 1) {
                    __syncthreads();
                    top = (top - int(firsts.at[level + 1])) / 2;  // exact: cells begin there
                    left = (left - int(firsts.at[LAST + level + 1])) / 2;
                }
            }
            __syncthreads();
        }
    }
}

// The coarser result where the network trusts it more than the level's own colour, from 0 to 1.
struct Trusted {
    float own;
    size_t here, below;
};

// coarse (planes, about hp / 2, about wp / 2), level (planes, hp, wp), heads (1, 26 or more, hp,
// wp), rows (hp,) and columns (wp,) of coarse that pixels lie in.
template <class Number>
FN Trusted trusted_at(const View& coarse, const View& level, const View& heads, const View& rows,
                      const View& columns, int y, int x) {
    // The full head has the channel elsewhere than the short ones of the coarser levels.
    const size_t channel = heads.size[1] > KERNEL + 1 ? MIX : KERNEL,
                 here = size_t(y) * level.size[2] + x;
    return {as_float(numbers<Number>(heads)[channel * level.size[1] * level.size[2] + here]), here,
            size_t(int(rows.at[y])) * coarse.size[2] + int(columns.at[x])};
}

FN float mixed_at(const View& coarse, const View& level, const Trusted& by, int plane) {
    const float from = coarse.at[size_t(plane) * coarse.size[1] * coarse.size[2] + by.below];
    const float own = level.at[size_t(plane) * level.size[1] * level.size[2] + by.here];
    return mixed_pixel<float>(from, own, by.own);
}

// The above -> mixed (planes, hp, wp).
template <class Number>
__global__ void denoise_mix(View coarse, View level, View heads, View rows, View columns,
                            View mixed) {
    PIXEL(mixed.size[2], mixed.size[1]);
    const Trusted by = trusted_at<Number>(coarse, level, heads, rows, columns, y, x);
    for (int k = 0; k < mixed.size[0]; k++)
        mixed.at[size_t(k) * mixed.size[1] * mixed.size[2] + by.here] = mixed_at(coarse, level, by,
                                                                                 k);
}

// The 5x5 kernel of a level, which is mixed with the coarser one before, if it MIXES: as above,
// heads (1, 25 or more, hp, wp), area (2,) -> filtered (planes, hp, wp), which `put` takes by
// threes. A block's pixels and two around them lie in shared memory.
const int WIDE = ACROSS + 2 * REACH, HIGH = DOWN + 2 * REACH;

template <class Number, bool MIXES, class Put>
FN void filter(const View& coarse, const View& level, const View& heads, const View& rows,
               const View& columns, const View& area, Put put) {
    __shared__ float tile[3][HIGH][WIDE];
    const int height = level.size[1], width = level.size[2], bottom = int(area.at[0]),
              right = int(area.at[1]);
    const int top = blockIdx.y * DOWN, left = blockIdx.x * ACROSS;
    const int y = top + threadIdx.y, x = left + threadIdx.x;
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    const size_t coarse_plane = size_t(coarse.size[1]) * coarse.size[2];
    const bool inside = y < height && x < width;
    Number read[SIDE * SIDE];  // read first and looked at last, so that all reads wait together
    const Number* from = numbers<Number>(heads) + here;
    UNROLL for (int i = 0; i < SIDE * SIDE; i++) {
        read[i] = inside ? __ldg(from) : Number(0);
        from = behind(from, plane);
    }
    for (int k = 0; k < level.size[0]; k += 3) {
        const int second = k + 1 < level.size[0] ? 1 : 0;  // one plane is read three times
        if (k) __syncthreads();
        UNROLL for (int first = 0; first < HIGH * WIDE; first += DOWN * ACROSS) {
            const int n = first + threadIdx.y * ACROSS + threadIdx.x;
            if (n >= HIGH * WIDE) break;
            const int j = n / WIDE, i = n % WIDE, v = top + j - REACH, u = left + i - REACH;
            const bool is_there = v >= 0 && v < height && u >= 0 && u < width,
                       held = is_there && v < bottom && u < right;
            Trusted by = {0.0f, size_t(v) * width + u, 0};
            if (MIXES && is_there)
                by = trusted_at<Number>(coarse, level, heads, rows, columns, v, u);
            const float *own = level.at + k * plane + by.here,
                        *below = coarse.at + k * coarse_plane + by.below;
            UNROLL for (int c = 0; c < 3; c++) {
                float value = 0.0f;
                if (is_there) {
                    const float before = MIXES ? __ldg(below) : 0.0f, now = __ldg(own);
                    value = MIXES ? mixed_pixel<float>(before, now, by.own) : now;
                }
                tile[c][j][i] = held ? value : 0.0f;
                own = behind(own, second * plane);
                below = behind(below, second * coarse_plane);
            }
        }
        __syncthreads();
        if (!inside) continue;
        Colour sum = {0.0f, 0.0f, 0.0f};
        float total = TINY;
        const auto add_taps = [&](bool all) {
            UNROLL for (int i = 0; i < SIDE * SIDE; i++) {  // taps beyond the picture do not count
                const int j = threadIdx.y + i / SIDE, n = threadIdx.x + i % SIDE,
                          v = top + j - REACH, u = left + n - REACH;
                const bool counts =
                    all || (y < bottom && x < right && v >= 0 && v < bottom && u >= 0 && u < right);
                const float weight = counts ? as_float(read[i]) : 0.0f;
                total += weight;
                add(sum, {tile[0][j][n], tile[1][j][n], tile[2][j][n]}, weight);
            }
        };
        if (top >= REACH && top + DOWN + REACH <= bottom && left >= REACH
            && left + ACROSS + REACH <= right)
            add_taps(true);
        else add_taps(false);
        put(k, second, y, x, sum * over_one(total));
    }
}

template <class Number, bool MIXES>
FN void filter_level(const View& coarse, const View& level, const View& heads, const View& rows,
                     const View& columns, const View& area, const View& filtered) {
    const size_t plane = size_t(filtered.size[1]) * filtered.size[2];
    filter<Number, MIXES>(coarse, level, heads, rows, columns, area,
                          [&](int k, int second, int y, int x, const Colour& light) {
        float* const to = filtered.at + k * plane + size_t(y) * filtered.size[2] + x;
        put(to, light, second * plane);
    });
}

template <class Number>
__global__ void __launch_bounds__(BLOCK, 3)
    denoise_filter(View mixed, View heads, View area, View filtered) {
    filter_level<Number, false>({}, mixed, heads, {}, {}, area, filtered);
}

template <class Number>
__global__ void __launch_bounds__(BLOCK, 3)
    denoise_filter_mixed(View coarse, View level, View heads, View rows, View columns, View area,
                         View filtered) {
    filter_level<Number, true>(coarse, level, heads, rows, columns, area, filtered);
}

// The finest level, then times reflectance, a border of repeated pixels around it: the same, factor
// (th, tw, 3) -> radiance (3, th + 2, tw + 2). Pixels at an edge of the picture also write those
// beyond it.
template <class Number>
__global__ void __launch_bounds__(BLOCK, 3)
    denoise_filter_shaded(View coarse, View level, View heads, View rows, View columns, View area,
                          View factor, View radiance) {
    const int bottom = int(area.at[0]) - 1, right = int(area.at[1]) - 1;
    const int width = radiance.size[2], last_row = radiance.size[1] - 1, last_column = width - 1;
    const size_t plane = size_t(radiance.size[1]) * width;
    filter<Number, true>(
        coarse, level, heads, rows, columns, area,
        [&](int, int, int y, int x, const Colour& light) {
            if (y > bottom || x > right) return;
            const size_t own = 3 * (size_t(y) * factor.size[1] + x);
            const Colour shaded = light * three(factor.at + own);
            for (int v = y ? y + 1 : 0; v <= (y < bottom ? y + 1 : last_row); v++)
                for (int u = x ? x + 1 : 0; u <= (x < right ? x + 1 : last_column); u++) {
                    float* const to = radiance.at + size_t(v) * width + u;
                    put(to, shaded, plane);
                }
        });
}

// Filtered colour times reflectance, a border of repeated pixels around it; before that, in `BOTH`,
// the colour itself.
template <bool BOTH>
FN void remodulate(const View& filtered, const View& factor, const View& part_rows,
                   const View& part_columns, const View& radiance) {
    const int height = radiance.size[1], width = radiance.size[2];
    PIXEL(width, height);
    const int v = int(part_rows.at[clip(y - 1, height - 2)]) - int(part_rows.at[0]);
    const int u = int(part_columns.at[clip(x - 1, width - 2)]) - int(part_columns.at[0]);
    const size_t from = size_t(filtered.size[1]) * filtered.size[2],
                 there = size_t(v) * filtered.size[2] + u;
    const float* const by = factor.at + 3 * (size_t(v) * factor.size[1] + u);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    UNROLL for (int c = 0; c < 3; c++) {
        const float light = filtered.at[c * from + there];
        if (BOTH) radiance.at[c * plane + here] = light;
        radiance.at[((BOTH ? 3 : 0) + c) * plane + here] = light * by[c];
    }
}

// filtered (3, hp, wp), factor (th, tw, 3), part_rows (th,), part_columns (tw,) -> radiance (3,
// th + 2, tw + 2), exposed linear.
extern "C" __global__ void denoise_remodulate(View filtered, View factor, View part_rows,
                                              View part_columns, View radiance) {
    remodulate<false>(filtered, factor, part_rows, part_columns, radiance);
}

// The same -> radiance (6, th + 2, tw + 2).
extern "C" __global__ void denoise_remodulate_both(View filtered, View factor, View part_rows,
                                                   View part_columns, View radiance) {
    remodulate<true>(filtered, factor, part_rows, part_columns, radiance);
}

// The means of samples as the finest level of what is filtered: next_samples (2 h, 2 w, 1),
// part_rows (th,), part_columns (tw,), seen_rows (hp,), seen_columns (wp,) -> level (1, hp, wp), 0
// beyond the part.
extern "C" __global__ void denoise_alpha_level(View next_samples, View part_rows, View part_columns,
                                               View seen_rows, View seen_columns, View level) {
    const int width = level.size[2];
    PIXEL(width, level.size[1]);
    const bool held = y < part_rows.size[0] && x < part_columns.size[0];
    level.at[size_t(y) * width + x] = held ? pixel_mean(next_samples, int(part_rows.at[y]),
                                                        int(part_columns.at[x]),
                                                        next_samples.size[1] / 2)
                                           : 0.0f;
}

// Filtered alpha at output size, by the picture's weights of 3x3 pixels: filtered (1, hp, wp), fine
// (1, 80, hp, wp), part_rows (th,), part_columns (tw,), params (4,), window (8,), near (cells,
// cells), out_rows (out_th,), out_columns (out_tw,) -> enlarged (out_th, out_tw, 1). Where nothing
// is near, that of the pixel itself.
template <class Number>
__global__ void denoise_enlarge_alpha(View filtered, View fine, View part_rows, View part_columns,
                                      View params, View window, View near, View out_rows,
                                      View out_columns, View enlarged) {
    const int width = enlarged.size[1];
    PIXEL(width, enlarged.size[0]);
    const Window part = window_of(window);
    const int h = part_rows.size[0], w = part_columns.size[0], line = filtered.size[2];
    float u, v;
    const int column = clip(centre(int(out_columns.at[x]), part.w, part.width, u) - part.left, w);
    const int row = clip(centre(int(out_rows.at[y]), part.h, part.height, v) - part.top, h);
    float* const to = enlarged.at + size_t(y) * width + x;
    if (nearness(near, part.top + row, part.left + column) <= 0.0f) {
        *to = clamped(filtered.at[size_t(row) * line + column], 0.0f, 1.0f);
        return;
    }
    const float right = fminf(fmaxf(2.0f * u + 0.5f, 0.0f), 1.0f),
                lower = fminf(fmaxf(2.0f * v + 0.5f, 0.0f), 1.0f);
    const bool at_corner = (right == 0.0f || right == 1.0f) && (lower == 0.0f || lower == 1.0f);
    const size_t plane = size_t(fine.size[2]) * fine.size[3],
                 corner = (2 * int(lower) + int(right)) * plane;
    const Number* const head = numbers<Number>(fine) + size_t(row) * fine.size[3] + column;
    float sum = 0.0f, total = TINY;
    for (int j = 0; j < 3; j++) {
        const float* const from = filtered.at + size_t(clip(row + j - 1, h)) * line;
        const float across = gauss(j - 1 + params.at[JITTER_Y] - v);
        for (int i = 0; i < 3; i++) {
            const float prior = across * gauss(i - 1 + params.at[JITTER_X] - u);
            const Number* const tap = head + (TAP_WEIGHTS + 4 * (3 * j + i)) * plane;
            const float own = at_corner ? as_float(tap[corner])
                                        : between_corners(tap, plane, right, lower);
            const float weight = own * prior;
            total += weight;
            sum += weight * from[clip(column + i - 1, w)];
        }
    }
    *to = clamped(sum / total, 0.0f, 1.0f);
}

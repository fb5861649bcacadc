#include "alpha.h"

// Means of alpha by quarter-pixels over all frames, and their variance: alpha (h, w, 1), moved (h,
// w, 2), samples (2 h, 2 w, 1), doubt (h, w, 1), near (cells, cells), 0 where nothing before
// counts, rates (4,): whether there is a past, variance of a frame's alpha, what a move adds, least
// share of a frame -> next_samples (2 h, 2 w, 1), next_doubt (h, w, 1).
struct Predicted {
    float quarters[4], own, off, variance;
};

FN bool moves_at(const View& moved, size_t pixel) {
    const Pair by = pair(moved, pixel);
    return fabsf(by.x) >= LEAST_MOTION || fabsf(by.y) >= LEAST_MOTION;
}

FN Predicted predicted_at(const View& alpha, const View& moved, const View& samples,
                          const View& doubt, const View& near, const Rates& rates, int y, int x) {
    const int h = alpha.size[0], w = alpha.size[1], height = samples.size[0],
              width = samples.size[1];
    const size_t pixel = size_t(y) * w + x;
    const Pair by = pair(moved, pixel);
    const float at_x = float(x) + by.x, at_y = float(y) + by.y;
    Predicted found;
    found.own = clamped(alpha.at[pixel], 0.0f, 1.0f);
    for (int i = 0; i < 4; i++) found.quarters[i] = found.own;
    found.off = 0.0f;
    found.variance = -1.0f;
    const bool held = -0.5f <= at_x && at_x <= w - 0.5f && -0.5f <= at_y && at_y <= h - 0.5f;
    if (!(nearness(near, y, x) > 0.0f && rates.keep > 0.0f && held)) return found;
    const int near_x = clip(int(floorf(at_x + 0.5f)), w),
              near_y = clip(int(floorf(at_y + 0.5f)), h);
    const float doubted = doubt.at[size_t(near_y) * w + near_x];
    if (!(doubted >= 0.0f)) return found;
    found.variance = doubted + (moves_at(moved, pixel) ? rates.drift : 0.0f);
    const float right = by.x + by.x, down = by.y + by.y, whole_right = floorf(right),
                whole_down = floorf(down);
    const Four wx = cubic_weights(right - whole_right), wy = cubic_weights(down - whole_down);
    const int left = 2 * x + int(whole_right) - 1, top = 2 * y + int(whole_down) - 1;
    const float upper[5] = {wy.x, wy.y, wy.z, wy.w, 0.0f},
                lower[5] = {0.0f, wy.x, wy.y, wy.z, wy.w};
    for (int i = 0; i < 4; i++) found.quarters[i] = 0.0f;
    for (int j = 0; j < 5; j++) {
        const float* const line = samples.at + size_t(clip(top + j, height)) * width;
        float value[5];
        for (int i = 0; i < 5; i++) value[i] = line[clip(left + i, width)];
        const float first = value[0] * wx.x + value[1] * wx.y + value[2] * wx.z + value[3] * wx.w;
        const float second = value[1] * wx.x + value[2] * wx.y + value[3] * wx.z + value[4] * wx.w;
        found.quarters[0] += first * upper[j];
        found.quarters[1] += second * upper[j];
        found.quarters[2] += first * lower[j];
        found.quarters[3] += second * lower[j];
    }
    found.off = found.own
                - (found.quarters[0] + found.quarters[1] + found.quarters[2] + found.quarters[3])
                      * 0.25f;
    return found;
}

extern "C" __global__ void denoise_gather(View alpha, View moved, View samples, View doubt,
                                          View near, View rates, View next_samples,
                                          View next_doubt) {
    const int h = alpha.size[0], w = alpha.size[1];
    PIXEL(w, h);
    const Rates& by = *reinterpret_cast<const Rates*>(rates.at);
    Predicted here;
    float apart = 0.0f, level = 0.0f;
    for (int j = -1; j <= 1; j++) {
        for (int i = -1; i <= 1; i++) {
            const Predicted found = predicted_at(alpha, moved, samples, doubt, near, by,
                                                 clip(y + j, h), clip(x + i, w));
            apart += found.off;
            level += found.own;
            if (i == 0 && j == 0) here = found;
        }
    }
    const Update<float> to = updated<float>(here.off, here.variance, apart, level, by);
    for (int i = 0; i < 4; i++) {
        const float value = clamped(here.quarters[i] + to.step, 0.0f, 1.0f);
        next_samples.at[size_t(2 * y + i / 2) * next_samples.size[1] + 2 * x + i % 2] =
            to.anew > 0.0f ? here.own : value;
    }
    next_doubt.at[size_t(y) * w + x] = to.anew > 0.0f ? by.variance : to.doubt;
}

// Alpha, sharper and nearer to the mean of its samples: enlarged (H, W, 1), next_samples (2 h, 2 w,
// 1), next_doubt (h, w, 1), moved (h, w, 2), gain (4,): variance of filtered alpha, noise of its
// structure, sharpening, share of alpha by colours; picture (H, W, 3), fit (4, h, w), near (cells,
// cells) -> corrected (H, W, 1): the samples' mean where near is below 2.
FN int first_within(int at, int size, int out) {
    return int((2 * size_t(out) * at + size - 1) / (2 * size_t(size)));
}

FN float mean_within(const View& filtered, int at_y, int at_x, int h, int w, int channel = 0) {
    const int top = first_within(at_y, h, filtered.size[0]),
              bottom = first_within(at_y + 1, h, filtered.size[0]);
    const int left = first_within(at_x, w, filtered.size[1]),
              right = first_within(at_x + 1, w, filtered.size[1]);
    float total = 0.0f;
    const int channels = filtered.size[2];
    for (int y = top; y < bottom; y++)
        for (int x = left; x < right; x++)
            total += filtered.at[channels * (size_t(y) * filtered.size[1] + x) + channel];
    return total / float((bottom - top) * (right - left));
}

FN Lacking<float> lacking_at(const View& filtered, const View& samples, const View& doubt,
                             const Gain& gain, int at_y, int at_x) {
    const int h = doubt.size[0], w = doubt.size[1];
    Sums<float> around = {};
    float here = 0.0f;
    for (int i = -1; i <= 1; i++) {
        for (int j = -1; j <= 1; j++) {
            const float found = mean_within(filtered, clip(at_y + j, h), clip(at_x + i, w), h, w);
            around.values += found;
            around.squares += found * found;
            around.across += i * found;
            around.down += j * found;
            if (i == 0 && j == 0) here = found;
        }
    }
    return lacking<float>(around, here, pixel_mean(samples, at_y, at_x, w),
                          doubt.at[size_t(at_y) * w + at_x], gain);
}

// The two of `size` pixels between whose centres one of `out` pixels has its own, and the second
// one's share.
FN Between beside(int position, int size, int out) {
    float offset;
    const int at = centre(position, size, out, offset), first = offset < 0.0f ? at - 1 : at;
    return {max(first, 0), min(first + 1, size - 1), offset < 0.0f ? offset + 1.0f : offset};
}

FN float mixed(float upper_left, float upper_right, float lower_left, float lower_right,
               float across, float down) {
    return between<float>(between<float>(upper_left, upper_right, across),
                          between<float>(lower_left, lower_right, across), down);
}

FN float softened_at(const View& filtered, int y, int x) {
    const int height = filtered.size[0], width = filtered.size[1];
    float around[3][3];
    for (int i = 0; i < 9; i++)
        around[i / 3][i % 3] = filtered.at[size_t(clip(y + i / 3 - 1, height)) * width
                                           + clip(x + i % 3 - 1, width)];
    return softened<float>(around);
}

// Red, green, blue and alpha in 3x3 pixels.
struct Around {
    float at[4][9];

    template <class F> __device__ F get(int channel, int tap) const { return at[channel][tap]; }
};

// Alpha by colours: picture (H, W, 3), next_samples (2 h, 2 w, 1), near (cells, cells) -> fit (4,
// h, w): the factors of red, green and blue and the rest that give alpha in 3x3 pixels by least
// squares; 0 where nothing is near.
extern "C" __global__ void denoise_fit(View picture, View next_samples, View near, View fit) {
    const int h = fit.size[1], w = fit.size[2];
    PIXEL(w, h);
    const size_t plane = size_t(h) * w, here = size_t(y) * w + x;
    if (nearness(near, y, x) <= 0.0f) {
        for (int c = 0; c < 4; c++) fit.at[c * plane + here] = 0.0f;
        return;
    }
    Around around;
    for (int i = 0; i < 9; i++) {
        const int at_y = clip(y + i / 3 - 1, h), at_x = clip(x + i % 3 - 1, w);
        for (int c = 0; c < 3; c++) around.at[c][i] = mean_within(picture, at_y, at_x, h, w, c);
        around.at[3][i] = pixel_mean(next_samples, at_y, at_x, w);
    }
    const Fit<float> found = fitted<float>(around);
    for (int c = 0; c < 3; c++) fit.at[c * plane + here] = found.by[c];
    fit.at[3 * plane + here] = found.rest;
}

// Alpha by the colour of an output pixel: the fits of 3x3 pixels, averaged, and interpolated.
FN float by_colour(const View& picture, const View& fit, const Between& rows, const Between& columns,
                   int y, int x) {
    const int h = fit.size[1], w = fit.size[2];
    float sums[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int j = 0; j < 6; j++) {
        const float down = j < 3 ? 1.0f - rows.share : rows.share;
        const size_t line = size_t(clip((j < 3 ? rows.first : rows.second) + j % 3 - 1, h)) * w;
        for (int i = 0; i < 6; i++) {
            const float weight = down * (i < 3 ? 1.0f - columns.share : columns.share);
            const size_t at = line + clip((i < 3 ? columns.first : columns.second) + i % 3 - 1, w);
            for (int c = 0; c < 4; c++) sums[c] += weight * fit.at[c * size_t(h) * w + at];
        }
    }
    const float* const colour = picture.at + 3 * (size_t(y) * picture.size[1] + x);
    return (sums[0] * colour[0] + sums[1] * colour[1] + sums[2] * colour[2] + sums[3]) / 9.0f;
}

extern "C" __global__ void denoise_correct(View enlarged, View picture, View fit, View next_samples,
                                           View next_doubt, View moved, View near, View gain,
                                           View corrected) {
    const int height = corrected.size[0], width = corrected.size[1], h = next_doubt.size[0],
              w = next_doubt.size[1];
    PIXEL(width, height);
    const Gain& by = *reinterpret_cast<const Gain*>(gain.at);
    const Between rows = beside(y, h, height), columns = beside(x, w, width);
    float offset, lacks[2][2];
    const int at_y = centre(y, h, height, offset), at_x = centre(x, w, width, offset);
    float* const to = corrected.at + size_t(y) * width + x;
    if (nearness(near, at_y, at_x) < 2.0f) {
        *to = pixel_mean(next_samples, at_y, at_x, w);
        return;
    }
    for (int j = 0; j < 2; j++) {
        for (int i = 0; i < 2; i++) {
            const Lacking<float> some = lacking_at(enlarged, next_samples, next_doubt, by,
                                            j ? rows.second : rows.first,
                                            i ? columns.second : columns.first);
            lacks[j][i] = some.weight * some.lack;
        }
    }
    const float value = enlarged.at[size_t(y) * width + x];
    const Lacking<float> own = lacking_at(enlarged, next_samples, next_doubt, by, at_y, at_x);
    float found = value
                  + mixed(lacks[0][0], lacks[0][1], lacks[1][0], lacks[1][1], columns.share,
                          rows.share);
    if (moves_at(moved, size_t(at_y) * w + at_x)) {
        const Between down = beside(y, 2 * h, height), across = beside(x, 2 * w, width);
        const float* const upper = next_samples.at + size_t(down.first) * 2 * w;
        const float* const lower = next_samples.at + size_t(down.second) * 2 * w;
        found += own.weight
                 * (mixed(upper[across.first], upper[across.second], lower[across.first],
                          lower[across.second], across.share, down.share)
                    - value - own.lack);
    }
    if (by.sharper > 0.0f)
        found += by.sharper * own.structure * (value - softened_at(enlarged, y, x));
    found = clamped(found, 0.0f, 1.0f);
    found += by.fitted * own.structure
             * (clamped(by_colour(picture, fit, rows, columns, y, x), 0.0f, 1.0f) - found);
    *to = found;
}

// Where alpha is worked on: alpha (h, w, 1) -> near (cells, cells), 2 where 3x3 cells are not all
// alike, 1 beside those, else 0. A block's cells and two around them lie in shared memory; those
// beyond the picture differ from nothing.
struct Bounds {
    float low, high;
};

FN Bounds join(const Bounds& one, const Bounds& other) {
    return {fminf(one.low, other.low), fmaxf(one.high, other.high)};
}

FN Bounds bounds_of_cell(const View& alpha, int y, int x) {
    const int bottom = min(NEAR_CELL * (y + 1), alpha.size[0]),
              right = min(NEAR_CELL * (x + 1), alpha.size[1]);
    Bounds found = {1.0f, 0.0f};
    for (int v = NEAR_CELL * y; v < bottom; v++)
        for (int u = NEAR_CELL * x; u < right; u++) {
            const float value = alpha.at[size_t(v) * alpha.size[1] + u];
            found = join(found, {value, value});
        }
    return found;
}

extern "C" __global__ void denoise_near(View alpha, View near) {
    __shared__ Bounds cells[DOWN + 4][ACROSS + 4];
    __shared__ bool differ[DOWN + 2][ACROSS + 2];
    const int rows = near.size[0], columns = near.size[1],
              thread = threadIdx.y * ACROSS + threadIdx.x;
    const int top = blockIdx.y * DOWN, left = blockIdx.x * ACROSS;
    for (int n = thread; n < (DOWN + 4) * (ACROSS + 4); n += DOWN * ACROSS) {
        const int j = n / (ACROSS + 4), i = n % (ACROSS + 4), y = top + j - 2, x = left + i - 2;
        const bool inside = y >= 0 && y < rows && x >= 0 && x < columns;
        cells[j][i] = inside ? bounds_of_cell(alpha, y, x) : Bounds{LARGEST_FLOAT, -LARGEST_FLOAT};
    }
    __syncthreads();
    for (int n = thread; n < (DOWN + 2) * (ACROSS + 2); n += DOWN * ACROSS) {
        const int j = n / (ACROSS + 2), i = n % (ACROSS + 2), y = top + j - 1, x = left + i - 1;
        Bounds all = cells[j][i];
        for (int k = 1; k < 9; k++) all = join(all, cells[j + k / 3][i + k % 3]);
        differ[j][i] = y >= 0 && y < rows && x >= 0 && x < columns && all.low != all.high;
    }
    __syncthreads();
    PIXEL(columns, rows);
    bool beside = false;
    for (int k = 0; k < 9; k++) beside = beside || differ[threadIdx.y + k / 3][threadIdx.x + k % 3];
    near.at[y * columns + x] = float(differ[threadIdx.y + 1][threadIdx.x + 1]) + float(beside);
}

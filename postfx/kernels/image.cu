// Two neighbouring places along a side, whose taps are five in a row: the taps, and their weights
// for each place. How far the second place's taps lie behind the first one's; other than 0 or 1
// where they are not five in a row.
struct Cubics {
    float weights[2][5];
    int index[5], behind;
};

FN Cubics cubics(const View& places, int at, int size) {
    const float first = places.at[at], second = places.at[min(at + 1, places.size[0] - 1)];
    const Cubic one = cubic(first, size), two = cubic(second, size);
    const int before = int(floorf(first)) - 1;
    Cubics found = {{{}, {}}, {}, int(floorf(second)) - 1 - before};
    UNROLL for (int i = 0; i < 5; i++) {
        found.index[i] = clip(before + i, size);
        found.weights[0][i] = i < 4 ? one.weight[i] : 0.0f;
        found.weights[1][i] = found.behind ? (i ? two.weight[i - 1] : 0.0f)
                                           : (i < 4 ? two.weight[i] : 0.0f);
    }
    return found;
}

// Four pixels, two beside and below each other, each like `resampled`.
template <int CHANNELS>
FN void resampled_four(const View& image, const Cubics& down, const Cubics& across,
                       float (&result)[2][2 * CHANNELS]) {
    UNROLL for (int k = 0; k < CHANNELS; k++) {
        float sum[2][2] = {}, least[2][3], most[2][3];
        UNROLL for (int i = 0; i < 5; i++) {
            float value[5];
            UNROLL for (int j = 0; j < 5; j++)
                value[j] = finite(
                    image.at[(size_t(down.index[j]) * image.size[1] + across.index[i]) * CHANNELS
                             + k]);
            UNROLL for (int y = 0; y < 2; y++) {
                float column = 0.0f;
                UNROLL for (int j = 0; j < 5; j++) column += down.weights[y][j] * value[j];
                UNROLL for (int x = 0; x < 2; x++) sum[y][x] += across.weights[x][i] * column;
                if (i == 0 || i == 4) continue;
                const bool behind = y && down.behind;
                const float upper = behind ? value[2] : value[1],
                            lower = behind ? value[3] : value[2];
                least[y][i - 1] = fminf(upper, lower);
                most[y][i - 1] = fmaxf(upper, lower);
            }
        }
        UNROLL for (int y = 0; y < 2; y++)
            UNROLL for (int x = 0; x < 2; x++) {
                const bool behind = x && across.behind;
                const float low = fminf(behind ? least[y][2] : least[y][0], least[y][1]);
                const float high = fmaxf(behind ? most[y][2] : most[y][0], most[y][1]);
                result[y][CHANNELS * x + k] = fminf(fmaxf(sum[y][x], low), high);
            }
    }
}

// Cubic resampling: image (h, w, channels), rows (height,), columns (width,) -> output (height,
// width, channels). A thread makes 2x2 pixels, of colour at once where places lie no more than a
// pixel apart.
extern "C" __global__ void __launch_bounds__(256, 2)
    resample(View image, View rows, View columns, View output) {
    const int height = output.size[0], width = output.size[1], channels = image.size[2];
    const int y = 2 * (blockIdx.y * blockDim.y + threadIdx.y),
              x = 2 * (blockIdx.x * blockDim.x + threadIdx.x);
    if (y >= height || x >= width) return;
    const Cubics down = cubics(rows, y, image.size[0]), across = cubics(columns, x, image.size[1]);
    const bool together = down.behind >= 0 && down.behind <= 1 && across.behind >= 0
                          && across.behind <= 1;
    if (channels == 3 && together) {
        float light[2][6];
        resampled_four<3>(image, down, across, light);
        UNROLL for (int k = 0; k < 2; k++)
            if (y + k < height) put_beside(light[k], output, y + k, x);
        return;
    }
    AS_IT_IS for (int k = 0; k < 4; k++) {
        const int v = y + k / 2, u = x + k % 2;
        if (v < height && u < width)
            resampled(image, channels, cubic(rows.at[v], image.size[0]),
                      cubic(columns.at[u], image.size[1]),
                      output.at + (size_t(v) * width + u) * channels);
    }
}

// Enlarges a premultiplied overlay: image (h, w, 4), rows (height,), columns (width,) -> output
// (height, width, 4). Colours stay within what the four nearest pixels' own colours make of the
// coverage that comes out.
extern "C" __global__ void overlay_enlarge(View image, View rows, View columns, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const Cubic down = cubic(rows.at[y], image.size[0]),
                across = cubic(columns.at[x], image.size[1]);
    float* const result = output.at + 4 * (size_t(y) * width + x);
    resampled(image, 4, down, across, result);
    const float alpha = clamped(result[3], 0.0f, 1.0f);
    result[3] = alpha;
    for (int c = 0; c < 3; c++) {
        const float ENDLESS = __int_as_float(0x7f800000);  // the GPU's compiler has no <cmath>
        float low = ENDLESS, high = -ENDLESS;
        UNROLL for (int i = 0; i < 4; i++) {
            const int row = i < 2 ? down.index[1] : down.index[2],
                      column = i % 2 ? across.index[2] : across.index[1];
            const float* const pixel = image.at + 4 * (size_t(row) * image.size[1] + column);
            const float light = finite(pixel[c]), covered = finite(pixel[3]);
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
    for (int c = 0; c < 3; c++)
        output.at[3 * here + c] = over(front[c], alpha, colour.at[3 * here + c]);
}

// Coverage of a premultiplied overlay (h, w, 4) over alpha (h, w, 1) -> output (h, w, 1).
extern "C" __global__ void overlay_over_alpha(View overlay, View alpha, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = size_t(y) * width + x;
    const float covered = clamped(overlay.at[4 * here + 3], 0.0f, 1.0f);
    output.at[here] = over(covered, covered, alpha.at[here]);
}

// A checkerboard of two greys: rows (height,), columns (width,), greys (2,) -> output (height,
// width, 3).
extern "C" __global__ void checkerboard(View rows, View columns, View greys, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const float grey = rows.at[y] == columns.at[x] ? greys.at[0] : greys.at[1];
    for (int c = 0; c < 3; c++) output.at[3 * (y * width + x) + c] = grey;
}

// The last output where its pixels are now, bicubic, edge repeated, rescaled where the exposure changed:
// history (height, width, 3), moved (th, tw, 2), params (4,), window (8,), out_rows (out_th,), out_columns (out_tw,)
// -> warped (out_th, out_tw, 3), log(1 + exposed).

// The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default.
__device__ inline Four cubic_weights(float t) {
    const float a = -0.75f, u = t + 1.0f, v = 1.0f - t, s = 2.0f - t;
    return {((a * u - 5.0f * a) * u + 8.0f * a) * u - 4.0f * a, ((a + 2.0f) * t - (a + 3.0f)) * t * t + 1.0f,
            ((a + 2.0f) * v - (a + 3.0f)) * v * v + 1.0f, ((a * s - 5.0f * a) * s + 8.0f * a) * s - 4.0f * a};
}

// Four pixels of a row, weighted, added to a sum; `columns` are those of their first channels.
__device__ inline void add_taps(const float* row, const int (&columns)[4], const Four& weights, float weight,
                                Colour& sum) {
    const float* p = row + columns[0];
    const float* q = row + columns[1];
    const float* r = row + columns[2];
    const float* s = row + columns[3];
    sum.r += weight * (weights.x * p[0] + weights.y * q[0] + weights.z * r[0] + weights.w * s[0]);
    sum.g += weight * (weights.x * p[1] + weights.y * q[1] + weights.z * r[1] + weights.w * s[1]);
    sum.b += weight * (weights.x * p[2] + weights.y * q[2] + weights.z * r[2] + weights.w * s[2]);
}

// Log-encoded colour, not below 0, after an exposure change.
__device__ inline float rescaled(float encoded, float gain) {
    const float held = fmaxf(encoded, 0.0f);
    return gain == 1.0f ? held : log1pf(expm1f(held) * gain);
}

extern "C" __global__ void denoise_history(View history, View moved, View params, View window, View out_rows,
                                           View out_columns, View warped) {
    PIXEL(warped.size[1], warped.size[0]);
    const Window part = window_of(window);
    const int height = part.height, width = part.width;
    const unsigned h = part.h, w = part.w, v = unsigned(out_rows.at[y]), u = unsigned(out_columns.at[x]);
    // The render pixel that holds this pixel's centre.
    const int from_y = int((2u * v + 1u) * h / (2u * height)), from_x = int((2u * u + 1u) * w / (2u * width));
    const int row = within(from_y - part.top, moved.size[0]), column = within(from_x - part.left, moved.size[1]);
    const Pair motion = pair(moved, size_t(row) * moved.size[1] + column);
    const float right = motion.x * (float(width) / float(w)), down = motion.y * (float(height) / float(h));
    const float whole_right = floorf(right), whole_down = floorf(down);
    const Four wx = cubic_weights(right - whole_right), wy = cubic_weights(down - whole_down);
    const int left = int(u) + int(whole_right) - 1, top = int(v) + int(whole_down) - 1;
    const int columns[4] = {3 * within(left, width), 3 * within(left + 1, width), 3 * within(left + 2, width),
                            3 * within(left + 3, width)};
    const size_t line = 3 * size_t(width);
    Colour sum = {0.0f, 0.0f, 0.0f};
    add_taps(history.at + within(top, height) * line, columns, wx, wy.x, sum);
    add_taps(history.at + within(top + 1, height) * line, columns, wx, wy.y, sum);
    add_taps(history.at + within(top + 2, height) * line, columns, wx, wy.z, sum);
    add_taps(history.at + within(top + 3, height) * line, columns, wx, wy.w, sum);
    const float gain = params.at[GAIN];
    float* to = warped.at + 3 * (size_t(y) * warped.size[1] + x);
    to[0] = rescaled(sum.r, gain);
    to[1] = rescaled(sum.g, gain);
    to[2] = rescaled(sum.b, gain);
}

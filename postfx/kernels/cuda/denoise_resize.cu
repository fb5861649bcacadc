// What a frame leaves, at another render size: state (h, w, 12), last_depth (h, w, 1), at_rows (height,),
// at_columns (width,) -> resized (height, width, 12), resized_depth (height, width, 1). Bilinear between pixels that hold
// something, depth of the nearest.

// Four channels, weighted.
__device__ inline Four weighted_four(const View& state, const size_t (&from)[4], const float (&share)[4], int group,
                                     float scale) {
    Four sum = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int i = 0; i < 4; i++) {
        const Four value = four(state, 3 * from[i] + group);
        sum.x += share[i] * value.x;
        sum.y += share[i] * value.y;
        sum.z += share[i] * value.z;
        sum.w += share[i] * value.w;
    }
    return {sum.x * scale, sum.y * scale, sum.z * scale, sum.w * scale};
}

extern "C" __global__ void denoise_resize(View state, View last_depth, View at_rows, View at_columns, View resized,
                                          View resized_depth) {
    PIXEL(resized.size[1], resized.size[0]);
    const int h = state.size[0], w = state.size[1];
    const float row = at_rows.at[y], column = at_columns.at[x], ty = row - floorf(row), tx = column - floorf(column);
    const int top = int(floorf(row)), first = int(floorf(column));
    const size_t upper = size_t(within(top, h)) * w, lower = size_t(within(top + 1, h)) * w;
    const int left = within(first, w), right = within(first + 1, w);
    const size_t from[4] = {upper + left, upper + right, lower + left, lower + right};
    float share[4] = {(1.0f - ty) * (1.0f - tx), (1.0f - ty) * tx, ty * (1.0f - tx), ty * tx}, total = 0.0f;
    for (int i = 0; i < 4; i++) {
        if (!(four(state, 3 * from[i]).w > 0.0f)) share[i] = 0.0f;
        total += share[i];
    }
    const float scale = total > 0.5f ? 1.0f / total : 0.0f;
    const size_t pixel = size_t(y) * resized.size[1] + x;
    const float depth = last_depth.at[size_t(within(int(rintf(row)), h)) * w + within(int(rintf(column)), w)];
    const Four mean = weighted_four(state, from, share, 0, scale);
    const Four one = weighted_four(state, from, share, 1, scale);
    const Four other = weighted_four(state, from, share, 2, scale);
    resized_depth.at[pixel] = depth;
    four(resized, 3 * pixel) = mean;
    four(resized, 3 * pixel + 1) = one;
    four(resized, 3 * pixel + 2) = other;
}

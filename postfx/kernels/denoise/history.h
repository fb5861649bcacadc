// The last output where its pixels are now: bicubic, edge repeated, never negative. NaN stays NaN:
// a pixel that is blended with it keeps its own colour.
#pragma once
#include "../number.h"
#include "denoise.h"

constexpr int CUBIC = 4;

// The weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default.
template <class F> FN void cubic(F t, F (&weights)[CUBIC]) {
    const float a = -0.75f;
    const F u = t + 1.0f, v = 1.0f - t, s = 2.0f - t;
    weights[0] = ((a * u - 5.0f * a) * u + 8.0f * a) * u - 4.0f * a;
    weights[1] = ((a + 2.0f) * t - (a + 3.0f)) * t * t + 1.0f;
    weights[2] = ((a + 2.0f) * v - (a + 3.0f)) * v * v + 1.0f;
    weights[3] = ((a * s - 5.0f * a) * s + 8.0f * a) * s - 4.0f * a;
}

// Where a pixel was: the whole output pixels that it moved by, and weights for the rest.
template <class F> struct Moved {
    F left, top, across[CUBIC], down[CUBIC];
};
template <class F> FN Moved<F> moved_pixel(F x, F y) {
    Moved<F> moved;
    moved.left = floor_of(x);
    moved.top = floor_of(y);
    cubic<F>(x - moved.left, moved.across);
    cubic<F>(y - moved.top, moved.down);
    return moved;
}

// A picture of three numbers a pixel.
struct Pixels {
    const float* at;
    Long height, width;
};

// The sum of 4x4 pixels from (y, x) on, which may lie beyond the picture.
FN void warp_edge(const Pixels& picture, const Moved<float>& moved, Long y, Long x, float* found) {
    float sums[3] = {};
    for (int j = 0; j < CUBIC; j++) {
        for (int i = 0; i < CUBIC; i++) {
            const float weight = moved.down[j] * moved.across[i];
            const Long row = clip(y + j, picture.height), column = clip(x + i, picture.width);
            const float* pixel = picture.at + (row * picture.width + column) * 3;
            for (int c = 0; c < 3; c++) sums[c] += weight * pixel[c];
        }
    }
    for (int c = 0; c < 3; c++) found[c] = larger<float>(0.0f, sums[c]);
}

// Two pixels beside one another with the same motion, as six numbers; two more mean nothing.
// Sixteen numbers of a row are five pixels; the sums of columns are put together from them.
template <int FROM> FN Eight eight_from(Sixteen x) {
    return __builtin_shufflevector(x, x, FROM, FROM + 1, FROM + 2, FROM + 3, FROM + 4, FROM + 5,
                                   FROM + 6 < 16 ? FROM + 6 : 15, FROM + 7 < 16 ? FROM + 7 : 15);
}
FN bool is_inside(const Pixels& picture, Long y, Long x) {
    return y >= 0 && y + CUBIC <= picture.height && x >= 0 && x + 6 <= picture.width;
}
// The first number of the samples of two pixels; -1 where they reach beyond the picture.
template <class F> FN typename Of<F>::Int start_of(const Pixels& picture, F top, F left) {
    const F right = F(float(picture.width - 6)), bottom = F(float(picture.height - CUBIC));
    const F y = within<F>(top, -1.0f, float(picture.height));
    const F x = within<F>(left, -1.0f, float(picture.width));
    const typename Of<F>::Int start = (whole(y) * int(picture.width) + whole(x)) * 3;
    F outside = F(0.0f);
    outside = top >= 0.0f ? outside : F(1.0f);
    outside = top <= bottom ? outside : F(1.0f);
    outside = left >= 0.0f ? outside : F(1.0f);
    outside = left <= right ? outside : F(1.0f);
    return whole(outside) == 1 ? typename Of<F>::Int(-1) : start;
}
FN Eight warp_two(const Pixels& picture, const Moved<float>& moved, Long start) {
    const float* from = picture.at + start;
    const Long line = 3 * picture.width;
    const Sixteen sums = load<Sixteen>(from) * moved.down[0]
                       + load<Sixteen>(from + line) * moved.down[1]
                       + load<Sixteen>(from + 2 * line) * moved.down[2]
                       + load<Sixteen>(from + 3 * line) * moved.down[3];
    const Eight found =
        eight_from<0>(sums) * moved.across[0] + eight_from<3>(sums) * moved.across[1]
        + eight_from<6>(sums) * moved.across[2] + eight_from<9>(sums) * moved.across[3];
    const Eight zero = 0.0f;
    return zero > found ? zero : found;
}

// A log-encoded number after an exposure change; what no frame can hold stays as it is, and is
// recognised by that.
template <class F> FN F rescaled(F encoded, float gain) {
    return encoded <= MOST_LOG ? log1p_of<F>(expm1_of<F>(encoded) * gain) : encoded;
}

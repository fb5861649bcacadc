// Pixels of alpha: means of its samples over the frames, alpha by colours, and what filtered alpha
// lacks of both.
#pragma once
#include "../number.h"
#include "denoise.h"

// Variance that colours have in any direction, as a share of their mean square, and beside it.
constexpr float ALIKE = 3e-5f;
constexpr float DARK = 1e-20f;
constexpr float LARGE = 1e30f;
constexpr float LEAST_MOTION = 0.015625f;  // render pixels that count as motion
constexpr float FAINTEST = 1e-6f;  // the smallest variance that is structure
// Variance in 3x3 pixels of a plane that rises by 1 a pixel, and how much of it is structure.
constexpr float PLANE = 0.6666667f;
constexpr float SLOPED = 0.125f;
// Squares: standard deviations, and alpha, by which 3x3 pixels may differ from before.
constexpr float LIMIT_OFF = 9.0f;
constexpr float LEAST_OFF = 4e-4f;
// Weights of three pixels by a Gaussian of one pixel.
constexpr float SIDE = 0.27406862f;
constexpr float MIDDLE = 0.45186276f;

// Variances in units of alpha (1 - alpha): of a frame's alpha, and what a move adds to that of the
// mean; whether there is a past; the smallest share that a frame's alpha has in the mean.
struct Rates {
    float keep, variance, drift, least;
};
// Variance of filtered alpha in those units, 0 where samples count for nothing; of its structure
// that is as likely noise; how much of what differs from the pixels around is added; how much alpha
// by colours counts.
struct Gain {
    float exact, noise, sharper, fitted;
};

// What a Kalman filter of the frames' means over pixels makes of a pixel: how far its samples move,
// and their next variance. It begins anew, as one says, where 3x3 pixels (sums of what they lack,
// and of alpha) differ by more than chance would have it, or where nothing is known before; that is
// so of NaN, too.
template <class F> struct Update {
    F step, doubt, anew;
};
template <class F> FN Update<F> updated(F off, F variance, F apart, F level, const Rates& rates) {
    const F one = F(1.0f), zero = F(0.0f), differs = apart / 9.0f;
    const F mean = within<F>((level - 0.5f * apart) / 9.0f, 0.0f, 1.0f);
    const F chance = mean * (1.0f - mean) * (rates.variance + smaller<F>(variance, one)) / 9.0f;
    const F usual = differs * differs <= LIMIT_OFF * chance + LEAST_OFF ? zero : one;
    const F share = larger<F>(variance / (variance + rates.variance), F(rates.least));
    const F left = smaller<F>((1.0f - share) * variance, F(rates.variance));
    return {off * share, left, variance >= 0.0f ? usual : one};
}

// Alpha by colours in 3x3 pixels: the factors of red, green and blue and the rest, by least squares
// in Cholesky's way, with no variance below the least. around.get<F>(channel, tap) are their red,
// green, blue and alpha.
template <class F> struct Fit {
    F by[3], rest;
};
template <class F, class Around> FN Fit<F> fitted(const Around& around) {
    constexpr int ALPHA = 3;
    const F zero = F(0.0f);
    F mean[4], joint[3][4] = {};
    UNROLL for (int c = 0; c < 4; c++) {
        F total = zero;
        UNROLL for (int tap = 0; tap < 9; tap++) total += around.template get<F>(c, tap);
        mean[c] = total / 9.0f;
    }
    UNROLL for (int tap = 0; tap < 9; tap++) {
        F off[4];
        UNROLL for (int c = 0; c < 4; c++) off[c] = around.template get<F>(c, tap) - mean[c];
        UNROLL for (int c = 0; c < 3; c++) {
            UNROLL for (int d = c; d < 4; d++) joint[c][d] += off[c] * off[d];
        }
    }
    const F squares = mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2];
    const F least = ALIKE * (joint[0][0] + joint[1][1] + joint[2][2] + 9.0f * squares) + DARK;
    const F first = joint[0][0] + least, by_green = joint[0][1] / first,
            by_blue = joint[0][2] / first;
    const F second = larger<F>(joint[1][1] + least - by_green * joint[0][1], least);
    const F left = joint[1][2] - by_green * joint[0][2], ratio = left / second;
    const F third = larger<F>(joint[2][2] + least - by_blue * joint[0][2] - ratio * left, least);
    const F rest_green = joint[1][ALPHA] - by_green * joint[0][ALPHA];
    Fit<F> found;
    found.by[2] = (joint[2][ALPHA] - by_blue * joint[0][ALPHA] - ratio * rest_green) / third;
    found.by[1] = (rest_green - left * found.by[2]) / second;
    found.by[0] = joint[0][ALPHA] / first - by_green * found.by[1] - by_blue * found.by[2];
    const F size = size_of<F>(found.by[0]) + size_of<F>(found.by[1]) + size_of<F>(found.by[2]);
    for (int c = 0; c < 3; c++) found.by[c] = size < LARGE ? found.by[c] : zero;
    const F shades = found.by[0] * mean[0] + found.by[1] * mean[1] + found.by[2] * mean[2];
    found.rest = mean[ALPHA] - (size < LARGE ? shades : zero);
    return found;
}

// Sums over 3x3 pixels: of their values and squares, and of the steps from side to side.
template <class F> struct Sums {
    F values, squares, across, down;
};
// How much of the variance of filtered alpha in 3x3 pixels is structure, how much the samples' mean
// counts beside it, and what alpha lacks of that.
template <class F> struct Lacking {
    F structure, weight, lack;
};
template <class F>
FN Lacking<F> lacking(const Sums<F>& around, F here, F own, F doubt, const Gain& gain) {
    const F across = around.across / 6.0f, down = around.down / 6.0f;
    const F mean = around.values / 9.0f, zero = F(0.0f);
    const F sloped = (1.0f - SLOPED) * PLANE * (across * across + down * down);
    const F varied = larger<F>(around.squares / 9.0f - mean * mean - sloped, zero);
    const F chance = larger<F>(mean * (1.0f - mean), zero);
    Lacking<F> found;
    found.structure = varied / (varied + gain.noise * chance + FAINTEST);
    found.weight = found.structure * gain.exact / (gain.exact + doubt + FAINTEST);
    found.lack = own - here;
    return found;
}

// Between two numbers; of a share of 0, the second one says nothing.
template <class F> FN F between(F first, F second, F share) {
    const F mixed = first * (1.0f - share) + second * share;
    return share == 0.0f ? first : mixed;
}

// 3x3 pixels by a Gaussian.
template <class F> FN F softened(const F (&around)[3][3]) {
    F line[3];
    UNROLL for (int i = 0; i < 3; i++) {
        line[i] = SIDE * (around[0][i] + around[2][i]) + MIDDLE * around[1][i];
    }
    return SIDE * (line[0] + line[2]) + MIDDLE * line[1];
}

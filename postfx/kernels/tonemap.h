// Pixels of the tone mapper: the guide of its grid, and what is kept of the last frame.
#pragma once
#include "number.h"

constexpr int SIDE = 256;
constexpr int COEFFICIENTS = 12;
constexpr int KNOTS = 16;
constexpr float BROKEN = 1e4f;
// Stops: of lag and jump from which on light changes, between two lights, and between two exposures
// that cannot be.
constexpr double LAG = 0.25;
constexpr double JUMP = 0.0625;
constexpr double MOST_APART = 1e4;
constexpr double MOST_STOPS = 64.0;
constexpr double RELEASE = 0.95;  // of the share that the grid covers, in each later frame

// What decides how much is kept, and what is made of it.
struct Following {
    float keep, follow, past, scale;
};
struct Followed {
    double kept, made_for, now, share;
};
FN double larger_of(double x, double other) { return x > other ? x : other; }
FN double apart(double x, double other) { return x < other ? other - x : x - other; }
FN Followed followed(double now, const Following& by, const float* before) {
    const double lag = apart(before[1], now), jump = apart(before[2], now), gone = before[3];
    const bool known = by.past > 0.0f && lag <= MOST_APART && jump <= MOST_APART;
    if (!(known && gone >= -1.0 && gone <= 1.0)) return {0.0, now, now, 0.0};
    const double change = larger_of(larger_of(lag / LAG, jump / JUMP) - 1.0, 0.0);
    const double followed = double(by.follow) * (change < 1.0 ? change : 1.0);
    const double share = larger_of(larger_of(followed, RELEASE * gone), 1.0 - double(by.keep));
    return {1.0 - share, now + (1.0 - share) * (double(before[1]) - now), now, share};
}

// A double's logarithm and power of 2: series, to its last bits, for a normal x > 0 and |x| < 1000.
FN double log2_of_double(double x) {
    const Long all = __builtin_bit_cast(Long, x);
    const Long exponent = (all - 0x3FE6A09E667F3BCDLL) >> 52;
    const double m = __builtin_bit_cast(double, all - (exponent << 52));
    const double z = (m - 1.0) / (m + 1.0), q = z * z;
    double sum = 0.0;
    for (int k = 23; k >= 1; k -= 2) sum = sum * q + 1.0 / k;
    return double(exponent) + 2.0 * 1.4426950408889634 * z * sum;
}
FN double exp2_of_double(double x) {
    const Long n = Long(x < 0.0 ? x - 0.5 : x + 0.5);
    const double r = (x - double(n)) * 0.6931471805599453;
    double sum = 1.0;
    for (int k = 14; k >= 1; k--) sum = 1.0 + sum * r / k;
    return sum * __builtin_bit_cast(double, (n + 1023) << 52);
}

// Level of a shaped colour in the grid, before the clip: ramps of each channel of a matrix's
// result.
struct Guide {
    float matrix[9], bias[3], shifts[3][KNOTS], slopes[3][KNOTS], mix[3], mix_bias;
};
struct Ramps {
    const Guide& guide;
    float slopes[3][KNOTS];

    explicit Ramps(const Guide& guide) : guide(guide) {
        for (int c = 0; c < 3; c++) {
            for (int k = 0; k < KNOTS; k++) slopes[c][k] = guide.mix[c] * guide.slopes[c][k];
        }
    }
    template <class F> FN_MEMBER F level(F r, F g, F b) const {
        F sum = F(guide.mix_bias);
        for (int c = 0; c < 3; c++) {
            const float* m = guide.matrix + 3 * c;
            const F value = m[0] * r + m[1] * g + m[2] * b + guide.bias[c];
            UNROLL for (int k = 0; k < KNOTS; k++) {
                sum += slopes[c][k] * larger<F>(value - guide.shifts[c][k], F(0.0f));
            }
        }
        return sum;
    }
};

FN float least_of(float x) { return x; }
FN float most_of(float x) { return x; }
FN float least_of(Wide x) { return __builtin_reduce_min(x); }
FN float most_of(Wide x) { return __builtin_reduce_max(x); }

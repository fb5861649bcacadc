// The tone mapper: what is kept of the last frame, and numbers that Python has, too.
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

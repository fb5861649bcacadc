// Pixels of the picture's parts: coded for the filters, in proportion, and decoded again.
#pragma once
#include "../number.h"
#include "denoise.h"

constexpr float DARKEST = 1e-30f;
constexpr float LEAST_SQUARE = 1e-12f;  // of a vector that has a direction

// What is taken off a part's values, what the rest is multiplied by, and its limit.
struct Coding {
    float offset, factor, most;
};

// A value for the filters, without reflectance: NaN counts as 0, infinity as the largest number.
template <class F> FN F coded(F value, F reflectance, const Coding& by) {
    const F held = within<F>(known<F>(value), -MAX_FLOAT, MAX_FLOAT);
    return smaller<F>(larger<F>(held - by.offset, F(0.0f)) * by.factor / reflectance, F(by.most));
}

// How much this frame counts beside a history of `count` samples that is distrusted.
template <class F> FN F newer_share(F count, F distrust) {
    const F one = F(1.0f), share = one / (larger<F>(count, F(0.0f)) + one);
    return count > 0.0f ? share + (one - share) * distrust : one;
}

// Mixed with what was before, unless that is broken.
template <class F> FN F accumulated(F now, F before, F share) {
    const F mixed = before + (now - before) * share;
    return mixed <= MAX_FLOAT ? mixed : now;
}

// What a filtered value is multiplied by, what is added, and its bounds; above 0, `kind` is
// vectors, which get length 1, below 0 distances, whose reciprocal and coverage were filtered:
// `shift` then stands for none.
struct Decoding {
    float scale, shift, low, high, kind;
};
template <class F> FN F decoded(F value, const Decoding& by) {
    return within<F>(value * by.scale + by.shift, by.low, by.high);
}
template <class F> FN F distance_of(F reciprocal, F coverage, const Decoding& by) {
    const F distance = within<F>(coverage / larger<F>(reciprocal, F(DARKEST)), by.low, by.high);
    return coverage >= 0.5f ? distance * by.scale : F(by.shift);
}
template <class F> FN F scale_to_one(F square) {
    return square > LEAST_SQUARE ? 1.0f / root_of(square) : F(0.0f);
}

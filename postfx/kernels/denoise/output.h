// Pixels of the output: what was removed and how visible it is, and blends.
#pragma once
#include "../number.h"
#include "denoise.h"

// exposed luminance below which smaller differences are no more visible
constexpr float DARK = 1e-3f;

// Exposed luminance, within what the network sees.
template <class F> FN F luminance_of(F red, F green, F blue, float exposure) {
    const F r = smaller<F>(within<F>(red, 0.0f, MAX_FLOAT) * exposure, F(MAX_COLOUR));
    const F g = smaller<F>(within<F>(green, 0.0f, MAX_FLOAT) * exposure, F(MAX_COLOUR));
    const F b = smaller<F>(within<F>(blue, 0.0f, MAX_FLOAT) * exposure, F(MAX_COLOUR));
    return 0.2126f * r + 0.7152f * g + 0.0722f * b;
}

// What was removed as the eye sees it: times the slope of sqrt(y / (1 + y)) at the result.
template <class F> FN F seen_difference(F noisy, F clean) {
    const F seen = larger<F>(clean, F(DARK));
    const F slope = 0.5f / (root_of(seen * (1.0f + seen)) * (1.0f + seen));
    return within<F>((noisy - clean) * slope, -1.0f, 1.0f);
}

// From one value to another; both ends are exact.
template <class F> FN F blended_by(F from, F to, F share) {
    return share == 1.0f ? to : from + (to - from) * share;
}

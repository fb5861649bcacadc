// What the network looks at, pixel by pixel, and how far guides are trusted.
#pragma once
#include "window.h"

constexpr int FEATURES = 27 + HIDDEN;
constexpr int PLANAR = FEATURES - HIDDEN;
constexpr float DOUBT = 0.7f;
constexpr float FAINT = 1e-4f;

// A value within bounds around 0; NaN is 0.
template <class F> FN F held(F value, float low, float high) {
    return within<F>(known<F>(value), low, high);
}

// Change of depth since the frame before, by its logarithm.
template <class F> FN F depth_change(F before, F depth) {
    const F ratio = within<F>(before, NEAREST, MAX_DEPTH) / larger<F>(depth, F(NEAREST));
    return within<F>(4.0f * log_of<F>(ratio), -1.0f, 1.0f);
}

// What the network looks at, pixel by pixel, and how far guides are trusted.
#pragma once
#include "window.h"

constexpr int FEATURES = 27 + HIDDEN;
constexpr int PLANAR = FEATURES - HIDDEN;
constexpr float MAX_DEPTH = 1e10f;
constexpr float UNKNOWN = 1e-3f;  // share of a reprojected pixel that the history may lack
constexpr float DOUBT = 0.7f;
constexpr float FAINT = 1e-4f;

// A value within bounds around 0; NaN is 0.
template <class F> FN F held(F value, float low, float high) { return within<F>(known<F>(value), low, high); }

// Where a pixel was in the frame before, edges repeated: the first of four pixels, the shares of those right of it and
// below, and the nearest one.
template <class F> struct Located {
    typename Of<F>::Int x0, y0, x1, y1, near;
    F right, lower;
    F inside;  // 1 in the picture, else 0
};
template <class F> FN Located<F> locate(F px, F py, int h, int w) {
    typedef typename Of<F>::Int I;
    const F one = F(1.0f), zero = F(0.0f);
    Located<F> found;
    found.inside = px >= -0.5f ? one : zero;
    found.inside = px <= float(w) - 0.5f ? found.inside : zero;
    found.inside = py >= -0.5f ? found.inside : zero;
    found.inside = py <= float(h) - 0.5f ? found.inside : zero;
    const F last_x = F(float(w - 1)), last_y = F(float(h - 1));
    const F x = within<F>(px, 0.0f, float(w - 1)), y = within<F>(py, 0.0f, float(h - 1));
    found.near = whole(nearest_of(y)) * I(w) + whole(nearest_of(x));
    found.x0 = whole(x);
    found.y0 = whole(y);
    const F left = number(found.x0), upper = number(found.y0);
    found.right = x - left;
    found.lower = y - upper;
    found.x1 = whole(smaller<F>(left + 1.0f, last_x));
    found.y1 = whole(smaller<F>(upper + 1.0f, last_y));
    return found;
}

// Whether more than a trace of a pixel is missing in the history, by its neighbours' counts.
FN bool is_unknown(float a, float b, float c, float d, float tx, float ty) {
    if (smaller<float>(smaller<float>(a, b), smaller<float>(c, d)) > 0.0f) return false;
    const float left = 1.0f - tx, upper = 1.0f - ty;
    float lacking = a <= 0.0f ? left * upper : 0.0f;
    lacking += b <= 0.0f ? tx * upper : 0.0f;
    lacking += c <= 0.0f ? left * ty : 0.0f;
    lacking += d <= 0.0f ? tx * ty : 0.0f;
    return lacking > UNKNOWN;
}

// Change of depth since the frame before, by its logarithm.
template <class F> FN F depth_change(F before, F depth) {
    const F ratio = within<F>(before, NEAREST, MAX_DEPTH) / larger<F>(depth, F(NEAREST));
    return within<F>(4.0f * log_of<F>(ratio), -1.0f, 1.0f);
}

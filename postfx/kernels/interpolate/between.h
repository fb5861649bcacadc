// Places in pictures that lie between their pixels.
//
// In files that include this, numbers are rounded as they are written, but in functions that say
// FUSED: a place that is rounded otherwise may be another pixel, and a motion the one that fits.
#pragma once
#include "../rows.h"
#pragma clang fp contract(off)
#define FUSED _Pragma("clang fp contract(on)")

typedef Picture Field;
typedef View<const bool, 2> Known;
typedef NewPicture NewField;

FN Long floor_to_whole(double x) { return Long(__builtin_floor(x)); }
FN double size_of(double x) { return __builtin_fabs(x); }

// Between 0 and the last; NaN becomes 0.
FN double within_double(double x, double last) {
    return smaller<double>(larger<double>(x, 0.0), last);
}

// Two numbers of a pixel, and four.
typedef float Two __attribute__((ext_vector_type(2)));
typedef double WideTwo __attribute__((ext_vector_type(2)));
FN WideTwo two_at(const float* at) {
    return {double(at[0]), double(at[1])};
}

// The pixels before and after a place of a row, which is held in it, and how far it is from the
// first to the second one.
struct Beside {
    Long first, second;
    double share;
};
FN Beside beside_of(double at, Long size) {
    // so that there is a pixel after the last place, too
    const double last = double(float(double(size) - 1.001));
    const double place = smaller<double>(last, larger<double>(0.0, at));
    const Long first = Long(place);
    return {first, first + 1, place - double(first)};
}

// Value between four pixels; edges are repeated.
FN double value_between(const Plane& picture, double y, double x) {
    const Beside down = beside_of(y, picture.size[0]), across = beside_of(x, picture.size[1]);
    const float *upper = picture(down.first), *lower = picture(down.second);
    const double u = across.share, v = down.share;
    const double above = upper[across.first] * (1.0 - u) + upper[across.second] * u;
    const double below = lower[across.first] * (1.0 - u) + lower[across.second] * u;
    return above * (1.0 - v) + below * v;
}

// Whether a place is in the picture, at a pixel that is known.
FN bool is_within(const Known& known, double y, double x) {
    const Long h = known.size[0], w = known.size[1];
    const bool inside = x > -0.5 && y > -0.5 && x < double(float(w) - 0.5f)
                     && y < double(float(h) - 0.5f);
    if (!inside) return false;
    return known(smaller<Long>(Long(y + 0.5), h - 1))[smaller<Long>(Long(x + 0.5), w - 1)];
}

// What is looked at in a frame's planes. Sums have an order that neither vectors nor threads
// change.
#pragma once
#include "number.h"

constexpr int WORTH = 1048576;  // bytes to look at or to copy that are worth another thread
constexpr int PIECE = 4096;  // numbers that are looked at before one looks whether more is needed

// Numbers of twice the precision, as many as F has.
typedef double WideDouble __attribute__((ext_vector_type(WIDE)));
template <class F> struct Twice;
template <> struct Twice<float> {
    typedef double Type;
};
template <> struct Twice<Wide> {
    typedef WideDouble Type;
};
template <class F> using Double = typename Twice<F>::Type;

FN double widen(float x) { return double(x); }
FN WideDouble widen(Wide x) { return __builtin_convertvector(x, WideDouble); }
FN double size_of(double x) { return __builtin_fabs(x); }
FN WideDouble size_of(WideDouble x) { return __builtin_elementwise_abs(x); }

// A pixel's luminance by Rec.709, 0 where it is negative or not finite, and whether it is the
// latter.
template <class F> struct Light {
    Double<F> light, unknown;
};
template <class F> FN Light<F> light_of(const float* pixel) {
    typedef Double<F> D;
    const D red = widen(pick<F, 3>(pixel)), green = widen(pick<F, 3>(pixel + 1));
    const D value = 0.2126 * red + 0.7152 * green + 0.0722 * widen(pick<F, 3>(pixel + 2));
    const D zero = D(0.0), one = D(1.0), unknown = size_of(value) < __builtin_inf() ? zero : one;
    const D light = value > 0.0 ? value : zero;
    return {unknown > 0.0 ? zero : light, unknown};
}

// 1 for a depth above 0 and below the farthest, else 0.
template <class F> FN F hit_of(F depth, float farthest) {
    const F one = F(1.0f), zero = F(0.0f), near = depth < farthest ? one : zero;
    return depth > 0.0f ? near : zero;
}

// 1 for a hit among at most one of four hits, and for a miss among at least three, else 0.
template <class F> FN F is_odd(F hit, F around) {
    const F one = F(1.0f), zero = F(0.0f);
    const F alone = around <= 1.0f ? one : zero, hole = around >= 3.0f ? one : zero;
    return hit > 0.0f ? alone : hole;
}

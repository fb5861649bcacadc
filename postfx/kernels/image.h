// Pixels of whole pictures: cubic resampling, transparency overlays, places compared.
#pragma once
#include "rows.h"

template <class F> FN F finite(F value) {
    return size_of<F>(value) < __builtin_inff() ? value : F(0.0f);
}
FN Four finite(Four value) {
    return __builtin_elementwise_abs(value) < Four(__builtin_inff()) ? value : Four(0.0f);
}
FN Four larger_four(Four x, Four other) { return x > other ? x : other; }
FN Four smaller_four(Four x, Four other) { return x < other ? x : other; }

// Weights of four taps around a position t in [0, 1) after the second one (Keys 1981, a = -0.5).
// Each product is rounded, as in the portable definition: a colour that nearly nothing covers is a
// quotient by its alpha, so that the last bits of alpha count.
constexpr int TAPS = 4;
struct Taps {
    float at[TAPS];
};
FN Taps catmull_rom(float t) {
    _Pragma("clang fp contract(off)");
    return {{((-0.5f * t + 1.0f) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1.0f,
             ((-1.5f * t + 2.0f) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t}};
}
template <class V> FN V sum_of_taps(const Taps& taps, V a, V b, V c, V d) {
    _Pragma("clang fp contract(off)");
    return taps.at[0] * a + taps.at[1] * b + taps.at[2] * c + taps.at[3] * d;
}

// Porter and Duff 1984, premultiplied.
template <class F> FN F over(F front, F alpha, F behind) {
    const F covered = within<F>(known<F>(alpha), 0.0f, 1.0f);
    return finite<F>(front) + (1.0f - covered) * finite<F>(behind);
}

// Colours of what covers a pixel: light over alpha; infinite where light comes from what covers
// nothing, `empty` where there is nothing at all.
FN Four straight(Four pixel, float empty) {
    const Four light = finite(pixel), zero = 0.0f;
    const float alpha = light[3], infinite = __builtin_inff();
    if (alpha > 0.0f) return light / alpha;
    const Four beyond = light > zero ? Four(infinite) : Four(-infinite);
    return light == zero ? Four(empty) : beyond;
}

// Alpha within [0, 1], and colours within the least and the most of what covers, times that alpha.
FN Four held(Four pixel, Four least, Four most) {
    const float alpha = within<float>(known<float>(pixel[3]), 0.0f, 1.0f);
    const Four infinite = __builtin_inff();
    const Four high = smaller_four(pixel, most * alpha), low = least * alpha;
    const Four under = __builtin_elementwise_abs(most) < infinite ? high : pixel;
    const Four over = larger_four(under, low);
    Four found = __builtin_elementwise_abs(least) < infinite ? over : under;
    found[3] = alpha;
    return found;
}

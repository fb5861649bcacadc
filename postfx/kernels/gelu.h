// GELU, the same on a CPU and a GPU: `number.h` or `number.cuh` comes before.
#pragma once

// An activation and its slope.
template <class F> struct Active {
    F value, slope;
};

// z times the normal distribution's share below z; error of that share below 1e-7 (Abramowitz and
// Stegun 7.1.26).
template <class F> FN Active<F> gelu_of(F z) {
    const F size = size_of<F>(z) * 0.7071067811865476f;
    const F bell = exp_of<F>(larger<F>(-size * size, F(-80.0f)));
    const F t = 1.0f / (1.0f + 0.3275911f * size);
    F tail = 1.061405429f * t - 1.453152027f;
    tail = tail * t + 1.421413741f;
    tail = tail * t - 0.284496736f;
    tail = (tail * t + 0.254829592f) * t * bell * 0.5f;
    const F share = z > 0.0f ? 1.0f - tail : tail;
    return {z * share, share + z * bell * 0.3989422804014327f};
}

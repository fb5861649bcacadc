// Activations of small networks, and what their kernels are told of a network and a grid.
#pragma once
#include "number.h"
#include "gelu.h"

constexpr int RELU = 0;
constexpr int GELU = 1;
constexpr int SINE = 2;
constexpr int MOST_LAYERS = 5;
constexpr int MOST_LEVELS = 16;

// The argument `network`: sizes are of what the first layer reads, then of each layer's outputs.
struct Facts {
    float layers, inputs, encoded, bands, activation, sizes[MOST_LAYERS + 1];
};

// The argument `grid`: `sides` are each level's cells along an axis.
struct GridFacts {
    float dims, numbers, entries, levels, sides[MOST_LEVELS];
};

struct Hyper {
    float rate, slow, slower, epsilon;
};

// NaN stays NaN.
template <class F> FN Active<F> relu_of(F z) {
    const F one = F(1.0f), zero = F(0.0f);
    return {larger<F>(zero, z), z > 0.0f ? one : zero};
}

// Sine and cosine of whole pi + rest, for rest in [-pi/2, pi/2]; Taylor series, absolute error
// below 2e-7.
template <class F> struct Waves {
    F sine, cosine;
};
template <class F> FN Waves<F> waves_of(F whole, F rest) {
    const F square = rest * rest, odd = whole * 0.5f;
    const F sign = 1.0f - 4.0f * (odd - floor_of(odd));
    F sine = square * float(-1.0 / 39916800) + float(1.0 / 362880);
    sine = sine * square + float(-1.0 / 5040);
    sine = sine * square + float(1.0 / 120);
    sine = sine * square + float(-1.0 / 6);
    F cosine = square * float(1.0 / 479001600) + float(-1.0 / 3628800);
    cosine = cosine * square + float(1.0 / 40320);
    cosine = cosine * square + float(-1.0 / 720);
    cosine = cosine * square + float(1.0 / 24);
    cosine = cosine * square - 0.5f;
    return {sign * (sine * square * rest + rest), sign * (cosine * square + 1.0f)};
}
template <class F> FN Active<F> sine_of(F z) {
    const F whole = floor_of(z * 0.3183098861837907f + 0.5f);
    F rest = z - whole * 3.140625f;  // pi in three parts, the first two of few bits
    rest = rest - whole * 9.67502593994e-4f;
    rest = rest - whole * 1.50995799e-7f;
    const Waves<F> waves = waves_of<F>(whole, rest);
    return {waves.sine, waves.cosine};
}

template <int KIND, class F> FN Active<F> activated(F z) {
    if constexpr (KIND == RELU) return relu_of<F>(z);
    else if constexpr (KIND == GELU) return gelu_of<F>(z);
    else return sine_of<F>(z);
}

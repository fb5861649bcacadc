// Reflectance of rows of both albedos.
#pragma once
#include "light.h"
#include "../rows.h"

// What pixels leave to the next frame, in the place of the first one.
template <class F> FN void store_state(float* at, const F (&state)[STATE]) {
    UNROLL for (int i = 0; i < STATE; i += 4) {
        spread_four<STATE>(at + i, state[i], state[i + 1], state[i + 2], state[i + 3]);
    }
}

// Of the pixels of a row from one on.
template <class F> FN Tint<F> tint_at(const float* some, const float* others, Long x) {
    const float *a = some + 3 * x, *b = others + 3 * x;
    return tinted<F>(pick<F, 3>(a) + pick<F, 3>(b), pick<F, 3>(a + 1) + pick<F, 3>(b + 1),
                     pick<F, 3>(a + 2) + pick<F, 3>(b + 2));
}

// A row, planar.
FN void fill_tints(const float* some, const float* others, Long count, float* red, float* green,
                   float* blue) {
    across(0, count, EACH(F, Long x) {
        const Tint<F> found = tint_at<F>(some, others, x);
        store<F>(red + x, found.red);
        store<F>(green + x, found.green);
        store<F>(blue + x, found.blue);
    });
}

// Windows of pictures between four pixels, in vectors.
#pragma once
#include "between.h"

typedef double WideFour __attribute__((ext_vector_type(4)));

FN Eight magnitude(Eight x) { return __builtin_elementwise_abs(x); }
FN Four magnitude(Four x) { return __builtin_elementwise_abs(x); }
template <class V> FN V most_of(V x, V other) { return x > other ? x : other; }
template <class V> FN V least_of(V x, V other) { return x < other ? x : other; }

// Sums by halves, so that every level adds in the same order.
FN float total(Four x) {
    const Two half = x.lo + x.hi;
    return half[0] + half[1];
}
FN float total(Eight x) { return total(x.lo + x.hi); }

// The largest of four numbers that are not NaN, or of those at two places that are not.
FN float largest_of(Four x) {
    const Two half = most_of<Two>(x.lo, x.hi);
    return larger<float>(half[0], half[1]);
}

// Some numbers as they are where the share is 0, and others where it is 1.
template <class V> FN V mixed(V some, V others, float share) {
    FUSED;
    return some + (others - some) * share;
}
// total + some * weight, in one instruction.
template <class V> FN V added(V sum, V some, float weight) {
    FUSED;
    return sum + some * weight;
}

// A window between four pixels: its first number in a picture, and its share of a pixel.
struct Window {
    const float* at;
    Long stride;
    float across, down;
};

// COUNT rows of a window, of which V has one.
template <class V, int COUNT> struct Lines {
    V row[COUNT];

    FN_MEMBER explicit Lines(const Window& window) {
        V upper = line(window, 0);
        UNROLL for (int j = 0; j < COUNT; j++) {
            const V lower = line(window, j + 1);
            row[j] = mixed<V>(upper, lower, window.down);
            upper = lower;
        }
    }
    FN_MEMBER static V line(const Window& window, Long row) {
        const float* at = window.at + row * window.stride;
        return mixed<V>(load<V>(at), load<V>(at + 1), window.across);
    }
};

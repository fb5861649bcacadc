// Pixels of the classical filter: accumulation along the motion, and an a-trous filter.
#pragma once
#include "prepare.h"

constexpr float LEAST_SHARE = 0.2f;  // of this frame in the accumulated colour
constexpr float STEP = 0.1f;         // relative change of depth from which on it is something else
// Edges: relative depth, share of the depth's own slope, and standard deviations of luminance.
constexpr float FLAT = 0.02f;
constexpr float SLANT = 0.3f;
constexpr float LUMINANCE = 4.0f;

// Relative luminance of linear Rec.709.
template <class F> FN F luminance(F r, F g, F b) { return 0.2126f * r + 0.7152f * g + 0.0722f * b; }

// What was accumulated before: mean colour, count, and the first two moments of luminance; how much
// of it is used, 0 where it is not known, and its depth.
template <class F> struct Past {
    F colour[3], count, mean, square, valid, depth;
};

// A pixel after this frame: mean colour and the variance of its luminance, and its state.
template <class F> struct Gathered {
    F light[4], state[STATE];
};
template <class F>
FN Gathered<F> gathered(const Light<F>& own, const Past<F>& past, F depth, float gain) {
    const F zero = F(0.0f), one = F(1.0f);
    const F near = size_of<F>(past.depth - depth) <= STEP * depth ? one : zero;
    const F missed = past.depth >= MAX_DEPTH ? one : zero,
            misses = depth >= MAX_DEPTH ? missed : zero;
    const F known = past.valid > 0.0f ? larger<F>(near, misses) : zero;
    const F count = known > 0.0f ? larger<F>(past.count, zero) : zero;
    const F alpha = larger<F>(one / (count + one), F(LEAST_SHARE));
    const F lum = luminance<F>(own.rgb[0], own.rgb[1], own.rgb[2]);
    const F scale = gain / larger<F>(past.valid, F(1e-3f));
    const F before = past.mean * scale, squared = past.square * scale * gain;
    const F mean = squared > 0.0f ? before + (lum - before) * alpha : lum;
    const F square = squared > 0.0f ? squared + (lum * lum - squared) * alpha : lum * lum;
    const F counted = smaller<F>(one / alpha, F(MAX_COUNT));
    Gathered<F> found;
    F total = zero;
    for (int c = 0; c < 3; c++) {
        found.light[c] = past.colour[c] + (own.rgb[c] - past.colour[c]) * alpha;
        total += size_of<F>(found.light[c]);
        found.state[c] = found.light[c];
    }
    found.light[3] = larger<F>(square - mean * mean * (one - one / counted), zero) / counted;
    found.state[3] = counted;
    found.state[4] = mean;
    found.state[5] = smaller<F>(square, F(MOST_STATE));
    for (int i = 6; i < STATE; i++) found.state[i] = zero;
    const F held = total + mean <= MOST_STATE ? one : zero,
            kept = square <= MAX_LIGHT ? held : zero;
    for (int i = 0; i < 6; i++) found.state[i] = kept > 0.0f ? found.state[i] : zero;
    // Light that is broken leaves nothing.
    for (int c = 0; c < 4; c++) found.light[c] = total <= MOST_STATE ? found.light[c] : zero;
    return found;
}

// 1 / depth; 0 where there is nothing.
template <class F> FN F nearness_of(F depth) {
    const F zero = F(0.0f), found = depth < MAX_DEPTH ? 1.0f / depth : zero;
    return depth > 0.0f ? found : zero;
}

// The smaller step to a neighbour: the larger one may cross an edge.
template <class F> FN F slope(F before, F here, F after) {
    const F left = here - before, right = after - here;
    return size_of<F>(left) < size_of<F>(right) ? left : right;
}

// A surface: its normal, 1 / depth with the steps of that, and luminance.
template <class F> struct Surface {
    F normal[3], near, lum;
};

// What edges leave of a tap: normals by their cosine to the 32nd power, where there are some, depth
// by a plane, and luminance by 1 / its standard deviation.
template <class F>
FN F likeness(const Surface<F>& own, const Surface<F>& other, F way, F spread) {
    F a = F(0.0f), b = F(0.0f);
    for (int c = 0; c < 3; c++) {
        a += own.normal[c] * other.normal[c];
        b += own.normal[c] * own.normal[c];
    }
    a = b > 0.5f ? larger<F>(a, F(0.0f)) : F(1.0f);
    for (int i = 0; i < 5; i++) a *= a;
    const F apart = size_of<F>(other.near - own.near - way);
    const F off = apart / (FLAT * own.near + SLANT * size_of<F>(way) + 1e-12f)
                + size_of<F>(other.lum - own.lum) * spread;
    return a * exp_of<F>(larger<F>(-off, F(-60.0f)));
}

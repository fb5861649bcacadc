// Pixels of what the network and its filters read: motion, and what accumulates over time.
#pragma once
#include "light.h"

// share of a pixel's depth below which a neighbour is clearly nearer
constexpr float CLEARLY = 0.9f;
constexpr float MOST_MOTION = 1e5f;    // pixels a frame, more than a picture can have

// Motion of a pixel; what no motion can be, such as NaN, becomes 0.
template <class F> FN F possible_motion(F value) {
    const F zero = F(0.0f), held = value < MOST_MOTION ? value : zero;
    return value > -MOST_MOTION ? held : zero;
}

// Reflectance brought towards the mean around a pixel, as far as it is not trusted (1 to -1). A
// broken answer doubts nothing.
template <class F> FN F doubted(F own, F mean, F trust) {
    const F zero = F(0.0f), share = 0.5f - 0.5f * trust;
    const F known_share = share <= 1.0f ? share : zero;
    return own - (own - mean) * (share >= 0.0f ? known_share : zero);
}

// What a pixel leaves to the next frame, and to the pyramid.
template <class F> struct Accumulated {
    F state[STATE], level[3], importance;
};

// A running mean of light; where it or the network's answer is broken, this frame's light alone,
// and nothing for the next one.
template <class F>
FN Accumulated<F> accumulate(const Light<F>& light, const F (&past)[4], F distrust, F importance,
                             const F (&hidden)[HIDDEN]) {
    const F one = F(1.0f), zero = F(0.0f), share = one / (larger<F>(past[3], zero) + one);
    const F alpha = share + (one - share) * distrust;
    Accumulated<F> found;
    found.state[3] = smaller<F>(one / alpha, F(MAX_COUNT));
    F total = found.state[3] + size_of<F>(importance);
    for (int i = 0; i < HIDDEN; i++) {
        found.state[4 + i] = hidden[i];
        total += size_of<F>(hidden[i]);
    }
    for (int c = 0; c < 3; c++) {
        found.state[c] = past[c] + (light.rgb[c] - past[c]) * alpha;
        total += size_of<F>(found.state[c]);
    }
    // Light beyond all bounds takes this frame's with it when it is rounded, also where it counts
    // nothing.
    const F kept = size_of<F>(past[0]) + size_of<F>(past[1]) + size_of<F>(past[2]);
    total += kept <= MOST_STATE ? zero : kept;
    for (int c = 0; c < 3; c++)
        found.level[c] = total <= MOST_STATE ? found.state[c] : light.rgb[c];
    found.importance = total <= MOST_STATE ? importance : one;
    for (int i = 0; i < STATE; i++) found.state[i] = total <= MOST_STATE ? found.state[i] : zero;
    return found;
}

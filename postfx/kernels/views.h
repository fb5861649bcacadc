// Formulas that turn light of a scene, at least 0, into light of a display.
#pragma once
#include "number.h"

// Exposure, a matrix to the formula's primaries, the weights of luminance there, and the display's
// most light.
struct Showing {
    float exposure, matrix[9], red, green, blue, most;
};
template <class F> struct Shown {
    F r, g, b;
};

// Khronos PBR Neutral, specification 1.0, whose numbers these are.
constexpr float NEUTRAL_OFFSET = 0.04f;
constexpr float NEUTRAL_START = 0.8f - NEUTRAL_OFFSET;
constexpr float NEUTRAL_ROOM = 1.0f - NEUTRAL_START;
constexpr float DESATURATION = 0.15f;

struct Neutral {
    template <class F> FN_MEMBER static Shown<F> show(const Showing&, F r, F g, F b) {
        const F least = smaller<F>(smaller<F>(r, g), b);
        const F curved = least - 6.25f * least * least;
        const F offset = least < 2.0f * NEUTRAL_OFFSET ? curved : F(NEUTRAL_OFFSET);
        const F peak = larger<F>(larger<F>(r, g), b) - offset;
        const F over = larger<F>(peak - NEUTRAL_START, F(0.0f)) + NEUTRAL_ROOM;
        const F squeezed = 1.0f - NEUTRAL_ROOM * NEUTRAL_ROOM / over;
        const F grey = 1.0f - 1.0f / (DESATURATION * (peak - squeezed) + 1.0f);
        const F scale = squeezed / larger<F>(peak, F(NEUTRAL_START)) * (1.0f - grey);
        const F kept = peak < NEUTRAL_START ? F(1.0f) : scale;
        const F added = peak < NEUTRAL_START ? F(0.0f) : grey * squeezed;
        return {(r - offset) * kept + added, (g - offset) * kept + added,
                (b - offset) * kept + added};
    }
};

// Reinhard et al. 2002, equation 3, where the most light is 1.
struct Reinhard {
    template <class F> FN_MEMBER static Shown<F> show(const Showing& by, F r, F g, F b) {
        const F share = 1.0f / (1.0f + (by.red * r + by.green * g + by.blue * b) / by.most);
        return {r * share, g * share, b * share};
    }
};

// Of numbers that are finite.
template <class Formula, class F> FN Shown<F> show_light(const Showing& by, F r, F g, F b) {
    const float* const m = by.matrix;
    const F x = m[0] * r + m[1] * g + m[2] * b, y = m[3] * r + m[4] * g + m[5] * b;
    const F z = m[6] * r + m[7] * g + m[8] * b;
    return Formula::template show<F>(by, within<F>(x * by.exposure, 0.0f, BRIGHTEST),
                                     within<F>(y * by.exposure, 0.0f, BRIGHTEST),
                                     within<F>(z * by.exposure, 0.0f, BRIGHTEST));
}

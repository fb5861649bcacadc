// An output pixel from 3x3 samples: by predicted weights and distance, log-encoded, sharpened, and
// blended with the reprojected history.
//
// It is told by an accessor where its samples and weights lie: at a corner of its render pixel at
// scale 2, at its centre at scale 1, anywhere else.
#pragma once
#include "window.h"

constexpr int TAPS = 9;
// Reflectance that radiance is multiplied by: none; the guides', as far as they are trusted; that
// of the render pixels.
enum Reflectance { NONE, GUIDED, OWN };

// The head's channels of a row of pixels.
struct Head {
    const float* at;
    Long plane;
};

// A row of output: what all its pixels share.
struct Row {
    Head head;
    const float* radiance;  // the first of the three rows of samples
    Long plane, line;
    const float *moved, *past, *share;  // of the row of render pixels
    const float* guide[4];              // reflectance and trust, of output pixels
    Long left;                          // the first output column in the frame
    float y, right, bottom, across, down;
};

FN float gauss(float distance) { return exp_of<float>(-2.0f * (distance * distance)); }

// Weights of three samples by their distance, and those of the softened picture, which sum to 1.
struct Distances {
    float near[3], wide[3];
};
FN Distances distances_of(float offset) {
    Distances found;
    float total = 0.0f;
    for (int i = 0; i < 3; i++) {
        const float distance = float(i - 1) + offset;
        found.near[i] = gauss(distance);
        found.wide[i] = exp_of<float>(-0.5f * (distance * distance));
        total += found.wide[i];
    }
    for (int i = 0; i < 3; i++) found.wide[i] /= total;
    return found;
}
struct Weights {
    float near[TAPS], wide[TAPS];
};
FN Weights weights_of(const Distances& down, const Distances& across) {
    Weights found;
    for (int k = 0; k < TAPS; k++) {
        found.near[k] = down.near[k / 3] * across.near[k % 3];
        found.wide[k] = down.wide[k / 3] * across.wide[k % 3];
    }
    return found;
}

// Of the left and of the right output pixel in a render pixel, where the output doubles both sides.
struct Sides {
    Weights left, right;
};
FN Sides sides_of(const Distances& down, const Params& params) {
    return {weights_of(down, distances_of(params.jitter_x + 0.25f)),
            weights_of(down, distances_of(params.jitter_x - 0.25f))};
}

// Accessors.

struct AtCorner {
    const Row& row;
    const Weights& weights;
    Long x;
    int corner, side;

    template <class F> FN_MEMBER F predicted(int channel) const {
        return load<F>(row.head.at + (channel + corner) * row.head.plane + x);
    }
    template <class F> FN_MEMBER F sample(const float* from) const { return load<F>(from + x); }
    template <class F, int STEP> FN_MEMBER F render(const float* from) const {
        return pick<F, STEP>(from + STEP * x);
    }
    template <class F> FN_MEMBER F guide(int c) const {
        return pick<F, 2>(row.guide[c] + 2 * x + side);
    }
    template <class F> FN_MEMBER F near(int k) const { return F(weights.near[k]); }
    template <class F> FN_MEMBER F wide(int k) const { return F(weights.wide[k]); }
    template <class F> FN_MEMBER F column() const {
        return ramp<F>(float(row.left + 2 * x + side), 2.0f);
    }
};

struct AtCentre {
    const Row& row;
    const Weights& weights;
    Long x;

    template <class F> FN_MEMBER F predicted(int channel) const {
        const float* at = row.head.at + channel * row.head.plane + x;
        const F upper = load<F>(at) + load<F>(at + row.head.plane);
        const F lower = load<F>(at + 2 * row.head.plane) + load<F>(at + 3 * row.head.plane);
        return 0.25f * (upper + lower);
    }
    template <class F> FN_MEMBER F sample(const float* from) const { return load<F>(from + x); }
    template <class F, int STEP> FN_MEMBER F render(const float* from) const {
        return pick<F, STEP>(from + STEP * x);
    }
    template <class F> FN_MEMBER F guide(int c) const { return load<F>(row.guide[c] + x); }
    template <class F> FN_MEMBER F near(int k) const { return F(weights.near[k]); }
    template <class F> FN_MEMBER F wide(int k) const { return F(weights.wide[k]); }
    template <class F> FN_MEMBER F column() const { return ramp<F>(float(row.left + x), 1.0f); }
};

// Columns of an output at any scale: the render pixel of each, how far right it lies there, and the
// weights of its samples, each in a row of their own.
struct Columns {
    const int* index;
    const float *lean, *near, *wide;
    Long width;
};
struct Anywhere {
    const Row& row;
    const Columns& columns;
    const Distances& distances;
    float lower;
    Long x;

    template <class F> FN_MEMBER F predicted(int channel) const {
        const float* at = row.head.at + channel * row.head.plane;
        const int* index = columns.index + x;
        const F a = gather<F>(at, index), b = gather<F>(at + row.head.plane, index);
        const F c = gather<F>(at + 2 * row.head.plane, index);
        const F d = gather<F>(at + 3 * row.head.plane, index);
        const F left = a + (c - a) * lower, right = b + (d - b) * lower;
        return left + (right - left) * load<F>(columns.lean + x);
    }
    template <class F> FN_MEMBER F sample(const float* from) const {
        return gather<F>(from, columns.index + x);
    }
    template <class F, int STEP> FN_MEMBER F render(const float* from) const {
        return gather<F, STEP>(from, columns.index + x);
    }
    template <class F> FN_MEMBER F guide(int c) const { return load<F>(row.guide[c] + x); }
    template <class F> FN_MEMBER F near(int k) const {
        return distances.near[k / 3] * load<F>(columns.near + k % 3 * columns.width + x);
    }
    template <class F> FN_MEMBER F wide(int k) const {
        return distances.wide[k / 3] * load<F>(columns.wide + k % 3 * columns.width + x);
    }
    template <class F> FN_MEMBER F column() const { return ramp<F>(float(row.left + x), 1.0f); }
};

// The pixel.

template <class F> struct Lit {
    F rgb[3], trust;
};

// How much of the history it keeps: nothing where it lay beyond the border, or where the history
// does not hold it.
template <class F, class At> FN F trust_of(const Row& row, const At& at) {
    const F px = at.template column<F>() + at.template render<F, 2>(row.moved) * row.across;
    const F py = F(row.y) + at.template render<F, 2>(row.moved + 1) * row.down;
    const F count = at.template render<F, 4>(row.past + 3), zero = F(0.0f);
    F kept = at.template render<F, 1>(row.share) * (1.0f - at.template predicted<F>(BLEND));
    kept = px >= -0.5f ? kept : zero;
    kept = px <= row.right ? kept : zero;
    kept = py >= -0.5f ? kept : zero;
    kept = py <= row.bottom ? kept : zero;
    return count >= 0.0f ? kept : zero;
}

template <class F, Reflectance BY, class At> FN Lit<F> upsample_pixel(const Row& row,
                                                                      const At& at) {
    constexpr int PLANES = BY == GUIDED ? 6 : 3;
    F sums[PLANES] = {}, soft[PLANES] = {};
    F total = F(TINY);
    UNROLL for (int k = 0; k < TAPS; k++) {
        const F weight = at.template predicted<F>(TAP_WEIGHTS + 4 * k) * at.template near<F>(k);
        const F wide = at.template wide<F>(k);
        total += weight;
        UNROLL for (int c = 0; c < PLANES; c++) {
            const float* from = row.radiance + c * row.plane + k / 3 * row.line + k % 3;
            const F value = at.template sample<F>(from);
            sums[c] += weight * value;
            soft[c] += wide * value;
        }
    }
    Lit<F> lit;
    const F sharpen = at.template predicted<F>(SHARPEN);
    UNROLL for (int c = 0; c < 3; c++) {
        if constexpr (BY == GUIDED) {
            const F factor = at.template guide<F>(c), trust = at.template guide<F>(3);
            sums[c] = sums[3 + c] + (sums[c] * factor - sums[3 + c]) * trust;
            soft[c] = soft[3 + c] + (soft[c] * factor - soft[3 + c]) * trust;
        }
        if constexpr (BY == OWN) {
            sums[c] *= at.template guide<F>(c);
            soft[c] *= at.template guide<F>(c);
        }
        const F encoded = log_encode<F>(sums[c] / total);
        const F sharp = encoded + sharpen * (encoded - log_encode<F>(soft[c]));
        lit.rgb[c] = larger<F>(sharp, F(0.0f));
    }
    lit.trust = trust_of<F>(row, at);
    return lit;
}

// A number of a pixel blended with the history: rounding never makes light negative, and broken
// values count as 0.
template <class F> FN F blended(F current, F warped, F trust) {
    const F zero = F(0.0f), now = current <= MOST_LOG ? current : zero;
    const F mixed = now + (warped - now) * trust;
    return mixed <= MOST_LOG ? larger<F>(mixed, zero) : now;
}

// Light, which is not encoded: a sum of parts is enlarged and blended as the parts are.

template <class F> struct LightWeights {
    F taps[TAPS], total;
};
template <class F, class At> FN LightWeights<F> light_weights(const At& at) {
    LightWeights<F> found;
    found.total = F(TINY);
    UNROLL for (int k = 0; k < TAPS; k++) {
        found.taps[k] = at.template predicted<F>(TAP_WEIGHTS + 4 * k) * at.template near<F>(k);
        found.total += found.taps[k];
    }
    return found;
}

template <class F, class At>
FN F light_sample(const Row& row, const At& at, const LightWeights<F>& weights, Long channel) {
    F sum = F(0.0f);
    UNROLL for (int k = 0; k < TAPS; k++) {
        const float* from = row.radiance + channel * row.plane + k / 3 * row.line + k % 3;
        sum += weights.taps[k] * at.template sample<F>(from);
    }
    return sum / weights.total;
}

template <class F> FN F blended_light(F current, F warped, F trust, float darken) {
    const F zero = F(0.0f), now = current <= MAX_FLOAT ? current * darken : zero;
    const F mixed = now + (larger<F>(zero, warped) - now) * trust;
    return mixed <= MAX_FLOAT ? larger<F>(mixed, zero) : now;
}

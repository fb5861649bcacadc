// Pixels of colour: the shaper, a cube of colours, and the code values of a display. NaN counts as
// 0.
#pragma once
#include "rows.h"

constexpr float BRIGHTEST = 1e10f;
// Of Rec.2020's luminance.
constexpr float RED = 0.2627f;
constexpr float GREEN = 0.678f;
constexpr float BLUE = 0.0593f;
constexpr float DARK = 1e-9f;
constexpr int STEPS = 4096;

template <class F> struct Colour {
    F r, g, b;
};
template <class F> FN Colour<F> colour_at(const float* at) {
    return {pick<F, 3>(at), pick<F, 3>(at + 1), pick<F, 3>(at + 2)};
}
template <class F> FN void store_colour(float* at, const Colour<F>& colour) {
    store_triples<F>(at, colour.r, colour.g, colour.b);
}

// A value that is no number, or too large, is none that makes another one so.
template <class F> FN F finite(F value) {
    return within<F>(known<F>(value), -BRIGHTEST, BRIGHTEST);
}
template <class F> FN Colour<F> finite(const Colour<F>& colour) {
    return {finite<F>(colour.r), finite<F>(colour.g), finite<F>(colour.b)};
}

struct Matrix {
    float at[9];

    template <class F> FN_MEMBER F row(int i, const Colour<F>& colour) const {
        return at[3 * i] * colour.r + at[3 * i + 1] * colour.g + at[3 * i + 2] * colour.b;
    }
    template <class F> FN_MEMBER Colour<F> apply(const Colour<F>& colour) const {
        return {row<F>(0, colour), row<F>(1, colour), row<F>(2, colour)};
    }
};

// A matrix, then log2(1 + exposure * x / toe) * scale in [0, 1]. Light above the range is scaled
// down as a whole.
struct Shaping {
    float exposure, toe, scale;
};
struct Shaper {
    const Matrix& matrix;
    float gain, most, scale;

    Shaper(const Shaping& by, const Matrix& matrix)
        : matrix(matrix), gain(by.exposure / by.toe),
          most(exp2_of<float>(smaller<float>(1.0f / by.scale, 126.0f)) - 1.0f), scale(by.scale) {}

    template <class F> FN_MEMBER F lit(int row, const Colour<F>& colour) const {
        return larger<F>(matrix.row<F>(row, colour), F(0.0f)) * gain;
    }
    template <class F> FN_MEMBER F encoded(F light) const {
        return smaller<F>(log2_of<F>(light + 1.0f) * scale, F(1.0f));
    }
    template <class F> FN_MEMBER Colour<F> shape(const Colour<F>& colour) const {
        const Colour<F> held = finite<F>(colour);
        const F r = lit<F>(0, held), g = lit<F>(1, held), b = lit<F>(2, held);
        const F fit = most / larger<F>(larger<F>(r, g), larger<F>(b, F(most)));
        return {encoded<F>(r * fit), encoded<F>(g * fit), encoded<F>(b * fit)};
    }
};

// Tetrahedral look-up in a cube (size, size, size, 3), by rows: first where and how much, in
// vectors, then the colours.
typedef View<const float, 4> Cube;

struct LookUp {
    const float* cube;
    Long size, width;
    Room<int> places;    // of the first three of four corners
    Room<float> shares;  // of a colour, largest first

    LookUp(const Cube& cube, Long width)
        : cube(cube.at), size(cube.size[0]), width(width), places(3 * width), shares(3 * width) {}
    explicit operator bool() const { return bool(places) && bool(shares); }

    // Colours within [0, 1] of pixels of a row.
    template <class F> FN_MEMBER void find(const Colour<F>& shaped, Long x) const {
        typedef typename Of<F>::Int I;
        const int end = int(size - 2), along_blue = 3;
        const int along_green = int(3 * size), along_red = int(3 * size * size);
        const float last = float(size - 1);
        F r = within<F>(known<F>(shaped.r), 0.0f, 1.0f) * last;
        F g = within<F>(known<F>(shaped.g), 0.0f, 1.0f) * last;
        F b = within<F>(known<F>(shaped.b), 0.0f, 1.0f) * last;
        const I i = whole(smaller<F>(r, F(float(end)))), j = whole(smaller<F>(g, F(float(end))));
        const I k = whole(smaller<F>(b, F(float(end))));
        r -= number(i);
        g -= number(j);
        b -= number(k);
        // The first step goes along the axis of the largest share, the last along that of the
        // smallest.
        const I to_red = I(along_red), to_green = I(along_green), to_blue = I(along_blue);
        const I beside = g >= b ? to_green : to_blue, redder = r >= b ? to_red : beside;
        const I step = r >= g ? redder : beside;
        const I under = r >= g ? to_green : to_red, bluest = g >= b ? to_blue : under;
        const I final = r >= b ? bluest : under;
        const F most = larger<F>(larger<F>(r, g), b), least = smaller<F>(smaller<F>(r, g), b);
        const I at = i * to_red + j * to_green + k * to_blue;
        store_int<F>(places.at + x, at);
        store_int<F>(places.at + width + x, at + step);
        store_int<F>(places.at + 2 * width + x,
                     at + (along_red + along_green + along_blue) - final);
        store<F>(shares.at + x, most);
        store<F>(shares.at + width + x,
                 larger<F>(smaller<F>(r, g), smaller<F>(larger<F>(r, g), b)));
        store<F>(shares.at + 2 * width + x, least);
    }

    // Colours are read with the number behind, the fourth with the one before it, as it may be the
    // cube's last.
    FN_MEMBER void put(float* out) const {
        const Long across = 3 * (size * size + size + 1);
        const int *first = places.at, *second = first + width, *third = second + width;
        const float *most = shares.at, *middle = most + width, *least = middle + width;
        for (Long x = 0; x < width; x++) {
            const float* at = cube + first[x];
            const Four last = load<Four>(at + across - 1);
            const Four near = load<Four>(at) * (1.0f - most[x])
                            + load<Four>(cube + second[x]) * (most[x] - middle[x]);
            const Four far = load<Four>(cube + third[x]) * (middle[x] - least[x])
                           + __builtin_shufflevector(last, last, 1, 2, 3, 3) * least[x];
            const Four found = near + far;
            if (x + 1 < width) {
                store(out + 3 * x, found);
            } else {
                for (int c = 0; c < 3; c++) out[3 * x + c] = found[c];
            }
        }
    }
};

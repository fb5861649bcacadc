// Pixels of the pyramid behind the network: pooled, mixed with the coarser level, filtered.
#pragma once
#include "../number.h"
#include "denoise.h"

// Mean over a cell of 2x2 pixels, weighted by their importance: the weights, and their mean.
template <class F> struct Cell {
    F weights[4], importance;
};

template <class F> FN Cell<F> cell_of(F a, F b, F c, F d) {
    const F total = 0.25f * (a + b + c + d);
    const F share = 0.25f / larger<F>(total, F(LEAST_IMPORTANCE));
    return {{share * a, share * b, share * c, share * d}, total};
}

template <class F> FN F pooled(const Cell<F>& cell, F a, F b, F c, F d) {
    return cell.weights[0] * a + cell.weights[1] * b + cell.weights[2] * c + cell.weights[3] * d;
}

// The coarser result where the network trusts it more than the level's own colour.
template <class F> FN F mixed_pixel(F coarse, F own, F share) {
    return coarse + (own - coarse) * share;
}

// A normalised 5x5 kernel of its own for every pixel: taps beyond the picture do not count.
constexpr int SIDE = 5, REACH = 2;
struct Filter {
    const float* planes;
    const float* weights;  // of a row; the next tap's lie a step behind
    Long plane, line, step;
    Long bottom, right;
};

// Sums over taps, of which each row's lie in the picture.
template <class F, int CHANNELS> struct Filtered {
    F total = F(TINY), sums[CHANNELS] = {};

    FN_MEMBER void add(const Filter& filter, Long y, Long x, Long row, Long column) {
        const float* planes = filter.planes + (y + row - REACH) * filter.line + x + column - REACH;
        const F weight = load<F>(filter.weights + (row * SIDE + column) * filter.step + x);
        total += weight;
        UNROLL for (int c = 0; c < CHANNELS; c++) {
            sums[c] += weight * load<F>(planes + c * filter.plane);
        }
    }
    FN_MEMBER void store_at(float* out, Long plane) const {
        UNROLL for (int c = 0; c < CHANNELS; c++) store<F>(out + c * plane, sums[c] / total);
    }
};
// All of them, and those of the rows and columns that the picture has.
template <class F, int CHANNELS>
FN Filtered<F, CHANNELS> filter_inside(const Filter& filter, Long y, Long x) {
    Filtered<F, CHANNELS> found;
    UNROLL for (int tap = 0; tap < KERNEL; tap++) found.add(filter, y, x, tap / SIDE, tap % SIDE);
    return found;
}
template <class F, int CHANNELS>
FN Filtered<F, CHANNELS> filter_edge(const Filter& filter, Long y, Long x) {
    const Long top = larger<Long>(REACH - y, 0);
    const Long bottom = smaller<Long>(filter.bottom - y + REACH, SIDE);
    const Long width = Of<F>::COUNT;  // a vector is not beside the left or the right edge
    const Long left = width > 1 ? 0 : larger<Long>(REACH - x, 0);
    const Long right = width > 1 ? SIDE : smaller<Long>(filter.right - x + REACH, SIDE);
    Filtered<F, CHANNELS> found;
    AS_IT_IS for (Long row = top; row < bottom; row++) {
        AS_IT_IS for (Long i = left; i < right; i++) found.add(filter, y, x, row, i);
    }
    return found;
}

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

template <class F, bool EDGE, int CHANNELS>
FN void filter_pixel(const Filter& filter, Long y, Long x, F (&found)[CHANNELS]) {
    F total = F(TINY);
    F sums[CHANNELS] = {};
    UNROLL for (int tap = 0; tap < KERNEL; tap++) {
        const Long v = y + tap / SIDE - REACH, u = x + tap % SIDE - REACH;
        if (EDGE && (v < 0 || v >= filter.bottom || u < 0 || u >= filter.right)) continue;
        const F weight = load<F>(filter.weights + tap * filter.step + x);
        total += weight;
        UNROLL for (int c = 0; c < CHANNELS; c++) {
            sums[c] += weight * load<F>(filter.planes + c * filter.plane + v * filter.line + u);
        }
    }
    UNROLL for (int c = 0; c < CHANNELS; c++) found[c] = sums[c] / total;
}

// Pixels of the pyramid behind the network: pooled, and mixed with the coarser level.
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

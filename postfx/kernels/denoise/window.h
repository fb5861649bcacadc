// The part of a frame that kernels work on, and where output pixels lie in it.
#pragma once
#include "../number.h"
#include "denoise.h"

struct Params {
    float exposure, jitter_x, jitter_y, gain;
};
// The part's first row and column and the frame's size, in the render and in the output.
struct Window {
    float top, left, height, width, out_top, out_left, out_height, out_width;

    bool doubles() const { return out_width == 2 * width && out_height == 2 * height; }
    bool keeps_size() const { return out_width == width && out_height == height; }
};

// The pixel of the part that holds the centre of an output pixel, and how far off its centre.
struct Place {
    Long index;
    float offset;
};

FN Place centre_of(Long position, Long size, Long out_size) {
    const Long at = (2 * position + 1) * size, index = at / (2 * out_size);
    return {index, float(double(at - index * 2 * out_size) / double(2 * out_size) - 0.5)};
}
FN Place row_of(const Window& window, Long row, Long rows) {
    const Long out = Long(window.out_height), y = Long(window.out_top) + row;
    const Place at = centre_of(y < out ? y : out - 1, Long(window.height), out);
    return {clip(at.index - Long(window.top), rows), at.offset};
}
FN Place column_of(const Window& window, Long column, Long columns) {
    const Long out = Long(window.out_width), x = Long(window.out_left) + column;
    const Place at = centre_of(x < out ? x : out - 1, Long(window.width), out);
    return {clip(at.index - Long(window.left), columns), at.offset};
}

// Share of the right or lower of the two quarter-pixel corners at an offset.
FN float lean_of(float offset) { return within<float>(2.0f * offset + 0.5f, 0.0f, 1.0f); }

// log(1 + x) of an exposed colour.
template <class F> FN F log_encode(F exposed) {
    return log1p_of<F>(within<F>(exposed, 0.0f, MAX_COLOUR));
}

#include "tonemap.h"

// Shaped colour averaged by area: colour (height, width, 3), params (3,), matrix (9,) -> lowres (1,
// 3, 256, 256).
extern "C" __global__ void lowres(View colour, View params, View matrix, View lowres) {
    const int height = colour.size[0], width = colour.size[1];
    PIXEL(SIDE, SIDE);
    const Shaper by = shaper(params, matrix);
    // Whole numbers below 2^24 over 256: exact.
    const float top = float(y * height) / SIDE, bottom = float((y + 1) * height) / SIDE;
    const float left = float(x * width) / SIDE, right = float((x + 1) * width) / SIDE;
    const int last_row = min(int(ceilf(bottom)), height),
              last_column = min(int(ceilf(right)), width);
    Colour sum = {0.0f, 0.0f, 0.0f};
    for (int j = int(top); j < last_row; j++) {
        const float high = fminf(j + 1.0f, bottom) - fmaxf(float(j), top);
        const float* pixel = colour.at + 3 * (j * width + int(left));
        Colour row = {0.0f, 0.0f, 0.0f};
#pragma unroll 4
        for (int i = int(left); i < last_column; i++, pixel += 3) {
            const float wide = fminf(i + 1.0f, right) - fmaxf(float(i), left);
            add(row, shaped(by, pixel), wide);
        }
        add(sum, row, high);
    }
    const float share = 1.0f / ((bottom - top) * (right - left));
    const int here = y * SIDE + x, plane = SIDE * SIDE;
    put(lowres.at + here, sum * share, plane);
}

// Means of rows and channels of the small copy: lowres (1, 3, 256, 256) -> light (256, 3).
extern "C" __global__ void light(View lowres, View light) {
    const int channels = 3;
    PIXEL(channels, SIDE);
    const float* row = lowres.at + (x * SIDE + y) * SIDE;
    double total = 0.0;
#pragma unroll 8
    for (int i = 0; i < SIDE; i++) total += row[i];
    light.at[channels * y + x] = float(total / SIDE);
}

// How much of the last grid is kept: light (256, 3), params (4,), before (1, 4) -> after (1, 4).
// In double precision, so that nothing depends on the order of the sum.

extern "C" __global__ void follow(View light, View params, View before, View after) {
    const int values = light.size[0] * light.size[1];
    PIXEL(1, 1);  // one thread makes all four numbers
    const Following& by = *reinterpret_cast<const Following*>(params.at);
    double total = 0.0;
#pragma unroll 8
    for (int i = 0; i < values; i++) total += light.at[i];
    const Followed found = followed(total / values / by.scale, by, before.at);
    const double numbers[4] = {found.kept, found.made_for, found.now, found.share};
    for (int i = 0; i < 4; i++) after.at[i] = float(numbers[i]);
}

// Exponential smoothing over time: previous, current (1, 16, 16, 8, 12), keep (1, 4) -> result (1,
// 16, 16, 8, 12).
const int CELL = LEVELS * COEFFICIENTS;

// A thread makes as many numbers as a cell has, spread over the grid, so that neighbouring threads
// read neighbours.
extern "C" __global__ void smooth(View previous, View current, View keep, View result) {
    const int width = result.size[2], cells = result.size[1] * width;
    PIXEL(width, result.size[1]);
    const float weight = keep.at[0];
    const int first = y * width + x;
#pragma unroll 16
    for (int k = 0; k < CELL; k++) {
        const int at = k * cells + first;
        const float value = current.at[at], change = previous.at[at] - value;
        // it may be unset
        result.at[at] = weight > 0.0f && fabsf(change) <= BROKEN ? value + weight * change : value;
    }
}

// Exposure over time: previous (3,), current (1, 1), keep (1, 4), params (3,) -> result (3,).
// In double precision, so that the exposure of a still picture stays as it is to the bit. NaN is
// not below MOST_STOPS, either.

extern "C" __global__ void expose(View previous, View current, View keep, View params,
                                  View result) {
    PIXEL(1, 1);  // one thread makes all three numbers
    double stops = current.at[0];
    const double kept = keep.at[0], change = log2(double(previous.at[0])) - stops;
    if (kept > 0.0 && fabs(change) <= MOST_STOPS) stops += kept * change;  // it may be unset
    result.at[0] = float(exp2(stops));
    result.at[1] = params.at[1] / params.at[0];
    result.at[2] = params.at[2];
}

// Slices a bilateral grid at every pixel, applies the affine colour matrix found there and looks
// the result up in a cube: colour (height, width, 3), params (3,), matrix (9,), guide (112,), grid
// (1, 16, 16, 8, 12), cube (size, size, size, 3) -> output (height, width, 3).

// The guide's numbers as all threads of a block read them: every slope times the weight of its
// channel.
FN void read_guide(const View& guide, float* numbers) {
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    for (int i = thread; i < GUIDE_SIZE; i += threads) {
        const bool slope = i >= SLOPES && i < MIX;
        numbers[i] = guide.at[i] * (slope ? guide.at[MIX + (i - SLOPES) / KNOTS] : 1.0f);
    }
    __syncthreads();
}

// Level of a shaped colour in the grid, 0..1 before the clip: a sum of ramps over each channel of a
// matrix's result.
FN float level_of(const Colour& colour, const Four* numbers) {
    const float* const scalars = &numbers->x;
    float level = scalars[GUIDE_SIZE - 1];
    UNROLL for (int c = 0; c < 3; c++) {
        const float value = scalars[3 * c] * colour.r + scalars[3 * c + 1] * colour.g
                            + scalars[3 * c + 2] * colour.b + scalars[9 + c];
        UNROLL for (int k = 0; k < KNOTS / 4; k++) {
            const Four shift = numbers[(SHIFTS + c * KNOTS) / 4 + k],
                       slope = numbers[(SLOPES + c * KNOTS) / 4 + k];
            level += slope.x * fmaxf(value - shift.x, 0.0f) + slope.y * fmaxf(value - shift.y, 0.0f)
                + (slope.z * fmaxf(value - shift.z, 0.0f) + slope.w * fmaxf(value - shift.w, 0.0f));
        }
    }
    return level;
}

FN float applied(const Four& row, const Colour& colour) {
    return row.x * colour.r + row.y * colour.g + row.z * colour.b + row.w;
}

extern "C" __global__ void slice_apply(View colour, View params, View matrix, View guide, View grid,
                                       View cube, View output) {
    __shared__ Four numbers[GUIDE_SIZE / 4];
    read_guide(guide, &numbers->x);
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const int cells_high = grid.size[1], cells_wide = grid.size[2], levels = grid.size[3];
    const int here = 3 * (y * width + x);
    const Colour seen = shaped(shaper(params, matrix), colour.at + here);
    const Between row = between_cells((y + 0.5f) * cells_high / height - 0.5f, cells_high);
    const Between column = between_cells((x + 0.5f) * cells_wide / width - 0.5f, cells_wide);
    const Between level = between_cells(level_of(seen, numbers) * levels - 0.5f, levels);
    Four red = {0.0f, 0.0f, 0.0f, 0.0f}, green = red, blue = red;
    UNROLL for (int corner = 0; corner < 8; corner++) {
        const int j = corner & 4 ? row.second : row.first,
                  i = corner & 2 ? column.second : column.first;
        const int k = corner & 1 ? level.second : level.first;
        const float weight = (corner & 4 ? row.share : 1.0f - row.share)
                             * (corner & 2 ? column.share : 1.0f - column.share)
                             * (corner & 1 ? level.share : 1.0f - level.share);
        const int cell = 3 * ((j * cells_wide + i) * levels + k);
        add(red, four(grid, cell), weight);
        add(green, four(grid, cell + 1), weight);
        add(blue, four(grid, cell + 2), weight);
    }
    const Colour found = looked_up(cube,
                                   {applied(red, seen), applied(green, seen), applied(blue, seen)});
    put(output.at + here, found);
}

// Exponential smoothing over time: previous, current (1, 16, 16, 8, 12), keep (1, 4) -> result (1, 16, 16, 8, 12).
const int CELL = 8 * 12;

// A thread makes as many numbers as a cell has, spread over the grid, so that neighbouring threads read neighbours.
extern "C" __global__ void smooth(View previous, View current, View keep, View result) {
    const int width = result.size[2], cells = result.size[1] * width;
    PIXEL(width, result.size[1]);
    const float weight = keep.at[0];
    const int first = y * width + x;
#pragma unroll 16
    for (int k = 0; k < CELL; k++) {
        const int at = k * cells + first;
        const float value = current.at[at], change = previous.at[at] - value;
        result.at[at] = weight > 0.0f && fabsf(change) <= 1e4f ? value + weight * change : value;  // it may be unset
    }
}

#include "views.h"

// Looks colours up in a cube: colour (height, width, 3), params (3,), matrix (9,), cube (size,
// size, size, 4) -> output (height, width, 3).
extern "C" __global__ void __launch_bounds__(256, 4)
    apply_cube_fours(View colour, View params, View matrix, View cube, View output) {
    // A thread makes two pixels beside each other.
    __shared__ Pair staged[DOWN][3 * ACROSS];
    const int width = output.size[1], height = output.size[0], start = 2 * ACROSS * blockIdx.x;
    const int y = blockIdx.y * DOWN + threadIdx.y,
              x = min(start + 2 * int(threadIdx.x), (width - 1) / 2 * 2);
    if (y >= height) return;
    const Shaper by = shaper(params, matrix);
    const size_t here = 3 * (size_t(y) * width + x);
    const int count = x + 1 < width ? 6 : 3;
    float light[6], found[6];
    if (width % 2 == 0) {
        UNROLL for (int i = 0; i < 3; i++) {
            const Pair two = pair(colour, here / 2 + i);
            light[2 * i] = two.x;
            light[2 * i + 1] = two.y;
        }
    } else {
        UNROLL for (int i = 0; i < 6; i++) light[i] = colour.at[here + (i < count ? i : 0)];
    }
    const Colour places[2] = {shaped(by, light), shaped(by, light + 3)};
    UNROLL for (int k = 0; k < 2; k++) {
        const Colour one = looked_up<4>(cube, places[k]);
        put(found + 3 * k, one);
    }
    put_pixels(staged[threadIdx.y], found, output, y, x, start);
}

// Colour (height, width, 3) to a display's code values: decoded if it is code values, turned by a
// matrix, cut, encoded. params (12,), decode (4098,), encode (4098,): see postfx/kernels/colour.py.

// A table between its entries, at a share of it in [0, 1].
FN float looked_up(const View& table, float share) {
    const float place = share * float(STEPS);
    const int i = int(place);
    const float low = __ldg(table.at + i);
    return low + (place - i) * (__ldg(table.at + i + 1) - low);
}

FN float root(float value) { return sqrtf(sqrtf(sqrtf(value))); }

extern "C" __global__ void encode_display(View colour, View params, View decode, View encode,
                                          View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const float* const m = params.at;
    const float most = m[MOST], exponent = m[EXPONENT];
    const bool codes = m[CODES] > 0.0f;
    const int here = 3 * (y * width + x);
    float in[3], light[3];
    for (int c = 0; c < 3; c++) {
        in[c] = clamped(colour.at[here + c], -BRIGHTEST, BRIGHTEST);
        if (codes) in[c] = looked_up(decode, fminf(fmaxf(in[c], 0.0f), 1.0f));
    }
    for (int c = 0; c < 3; c++)
        light[c] = fminf(
            fmaxf(m[3 * c] * in[0] + m[3 * c + 1] * in[1] + m[3 * c + 2] * in[2], 0.0f), most);
    const float luminance = RED * light[0] + GREEN * light[1] + BLUE * light[2];
    const float gain = exponent == 0.0f ? 1.0f : powf(fmaxf(luminance, DARK), exponent);
    for (int c = 0; c < 3; c++)
        output.at[here + c] = looked_up(encode, root(fminf(light[c] * gain, 1.0f)));
}

// Views that are formulas: colour (height, width, 3), params (14,) -> output (height, width, 3).
template <class Formula>
FN void show(const View& colour, const View& params, const View& output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = 3 * (size_t(y) * width + x);
    float in[3];
    for (int c = 0; c < 3; c++) in[c] = clamped(colour.at[here + c], -BRIGHTEST, BRIGHTEST);
    const Showing& by = *reinterpret_cast<const Showing*>(params.at);
    const Shown<float> shown = show_light<Formula, float>(by, in[0], in[1], in[2]);
    put(output.at + here, {shown.r, shown.g, shown.b});
}

extern "C" __global__ void show_neutral(View colour, View params, View output) {
    show<Neutral>(colour, params, output);
}

extern "C" __global__ void show_reinhard(View colour, View params, View output) {
    show<Reinhard>(colour, params, output);
}

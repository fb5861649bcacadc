// Shaped colour averaged by area: colour (height, width, 3), params (3,), matrix (9,) -> lowres (1, 3, 256, 256).
extern "C" __global__ void lowres(View colour, View params, View matrix, View lowres) {
    const int side = 256, height = colour.size[0], width = colour.size[1];
    PIXEL(side, side);
    const Shaper by = shaper(params, matrix);
    // Whole numbers below 2^24 over 256: exact.
    const float top = float(y * height) / side, bottom = float((y + 1) * height) / side;
    const float left = float(x * width) / side, right = float((x + 1) * width) / side;
    const int last_row = min(int(ceilf(bottom)), height), last_column = min(int(ceilf(right)), width);
    Colour sum = {0.0f, 0.0f, 0.0f};
    for (int j = int(top); j < last_row; j++) {
        const float high = fminf(j + 1.0f, bottom) - fmaxf(float(j), top);
        const float* pixel = colour.at + 3 * (j * width + int(left));
        Colour row = {0.0f, 0.0f, 0.0f};
#pragma unroll 4
        for (int i = int(left); i < last_column; i++, pixel += 3) {
            const float wide = fminf(i + 1.0f, right) - fmaxf(float(i), left);
            const Colour seen = shaped(by, pixel);
            row = {row.r + wide * seen.r, row.g + wide * seen.g, row.b + wide * seen.b};
        }
        sum = {sum.r + high * row.r, sum.g + high * row.g, sum.b + high * row.b};
    }
    const float share = 1.0f / ((bottom - top) * (right - left));
    const int here = y * side + x, plane = side * side;
    lowres.at[here] = sum.r * share;
    lowres.at[plane + here] = sum.g * share;
    lowres.at[2 * plane + here] = sum.b * share;
}

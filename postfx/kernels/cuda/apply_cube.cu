// Looks colours up in a cube: colour (height, width, 3), params (3,), matrix (9,), cube (size, size, size, 3) ->
// output (height, width, 3). Tetrahedral between the corners: see postfx/kernels/apply_cube.py.
const float LARGEST = 1e10f;

extern "C" __global__ void apply_cube(View colour, View params, View matrix, View cube, View output) {
    const int width = output.size[1], size = cube.size[0];
    PIXEL(width, output.size[0]);
    const Shaper by = shaper(params);
    const int here = 3 * (y * width + x), step[3] = {size * size, size, 1};
    float in[3], share[3];
    for (int c = 0; c < 3; c++) in[c] = clamped(colour.at[here + c], -LARGEST, LARGEST);
    int first = 0;
    for (int c = 0; c < 3; c++) {
        const float* const m = matrix.at + 3 * c;
        const float place = shaped(by, m[0] * in[0] + m[1] * in[1] + m[2] * in[2]) * (size - 1);
        const int corner = min(int(place), size - 2);
        first += corner * step[c];
        share[c] = place - corner;
    }
    // The axes from the largest share to the smallest: each step along one leads to the tetrahedron's next corner.
    const int last = share[2] <= share[0] && share[2] <= share[1] ? 2 : share[1] <= share[0] ? 1 : 0;
    const int one = last == 0 ? 1 : 0, other = last == 2 ? 1 : 2;
    const int largest = share[one] >= share[other] ? one : other, middle = one + other - largest;
    const int second = first + step[largest], third = second + step[middle], fourth = third + step[last];
    const float w0 = 1.0f - share[largest], w1 = share[largest] - share[middle], w2 = share[middle] - share[last];
    for (int c = 0; c < 3; c++)
        output.at[here + c] = w0 * __ldg(cube.at + 3 * first + c) + w1 * __ldg(cube.at + 3 * second + c)
            + (w2 * __ldg(cube.at + 3 * third + c) + share[last] * __ldg(cube.at + 3 * fourth + c));
}

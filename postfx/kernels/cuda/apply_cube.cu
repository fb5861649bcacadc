// Looks colours up in a cube: colour (height, width, 3), params (3,), matrix (9,), cube (size, size, size, 3) ->
// output (height, width, 3).
extern "C" __global__ void apply_cube(View colour, View params, View matrix, View cube, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const int here = 3 * (y * width + x);
    const Colour found = looked_up(cube, shaped(shaper(params, matrix), colour.at + here));
    output.at[here] = found.r;
    output.at[here + 1] = found.g;
    output.at[here + 2] = found.b;
}

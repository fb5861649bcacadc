// A checkerboard of two greys: rows (height,), columns (width,), greys (2,) -> output (height, width, 3).
extern "C" __global__ void checkerboard(View rows, View columns, View greys, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const float grey = rows.at[y] == columns.at[x] ? greys.at[0] : greys.at[1];
    for (int c = 0; c < 3; c++) output.at[3 * (y * width + x) + c] = grey;
}

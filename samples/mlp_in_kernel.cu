// The kernels of mlp_in_kernel.py on a GPU: a thread makes one pixel.
#include <postfx/mlp.cuh>

__device__ inline void features_of(const float* normal, int x, int y, int width, int height,
                                   float* found) {
    for (int c = 0; c < 3; c++) found[c] = normal[c];
    found[3] = (2 * x + 1) / float(width) - 1, found[4] = (2 * y + 1) / float(height) - 1;
}

extern "C" __global__ void shade_by_network(View parameters, View normal, View albedo,
                                            View shaded) {
    const int height = shaded.size[0], width = shaded.size[1];
    PIXEL(width, height);
    const size_t at = 3 * (size_t(y) * width + x);
    float features[5], light[3];
    features_of(normal.at + at, x, y, width, height, features);
    mlp<GELU, 5, 32, 32, 3>(parameters.at, features, light);
    for (int c = 0; c < 3; c++) shaded.at[at + c] = albedo.at[at + c] * fmaxf(light[c], 0.0f);
}

extern "C" __global__ void features_of_pixels(View normal, View points) {
    const int height = normal.size[0], width = normal.size[1];
    PIXEL(width, height);
    const size_t pixel = size_t(y) * width + x;
    features_of(normal.at + 3 * pixel, x, y, width, height, points.at + 5 * pixel);
}

extern "C" __global__ void shade_by_values(View albedo, View values, View shaded) {
    const int height = shaded.size[0], width = shaded.size[1];
    PIXEL(width, height);
    const size_t at = 3 * (size_t(y) * width + x);
    for (int c = 0; c < 3; c++)
        shaded.at[at + c] = albedo.at[at + c] * fmaxf(values.at[at + c], 0.0f);
}

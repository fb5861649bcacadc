#include "scene.h"

// What a network reads of each pixel: camera (16,), box (4,), depth (height, width, 1), normal
// (height, width, 3) -> points (height * width, 9).
extern "C" __global__ void scene_points(View camera, View box, View depth, View normal,
                                        View points) {
    const SceneCamera& from = *reinterpret_cast<const SceneCamera*>(camera.at);
    const SceneBox& scene = *reinterpret_cast<const SceneBox*>(box.at);
    const int height = depth.size[0], width = depth.size[1];
    for (int at = blockIdx.y * blockDim.x + threadIdx.x; at < points.size[0];
         at += gridDim.y * blockDim.x) {
        const float* const facing = normal.at + 3 * size_t(at);
        const float normals[3] = {facing[0], facing[1], facing[2]};
        const float column = from.at_column<float>(float(at % width), width);
        const float row = from.at_row(at / width, height);
        const Point<float> found = point_of<float>(from, scene, column, row, depth.at[at], normals);
        for (int c = 0; c < POINT; c++) points.at[POINT * size_t(at) + c] = found.at[c];
    }
}

// Light of what it gave: values (height * width, 3), both albedos and colour (height, width, 3) ->
// output (height, width, 3).
extern "C" __global__ void scene_light(View values, View diffuse, View specular, View colour,
                                       View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = 3 * (size_t(y) * width + x);
    float given[3], albedo[3], light[3];
    for (int c = 0; c < 3; c++) {
        given[c] = values.at[here + c];
        albedo[c] = diffuse.at[here + c] + specular.at[here + c];
        light[c] = colour.at[here + c];
    }
    shade<float>(given, albedo, light);
    for (int c = 0; c < 3; c++) output.at[here + c] = light[c];
}

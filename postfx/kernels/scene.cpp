// Rows around a network that sees each pixel of one scene alone: see scene.py.
#include "rows.h"
#include "scene.h"

static void scene_points_rows(Long first, Long last, Given<SceneCamera> camera,
                              Given<SceneBox> box, Picture depth, Picture normal,
                              View<float, 2> points) {
    const Long height = depth.size[0], width = depth.size[1];
    for (Long y = first / width; y * width < last; y++) {
        const Long start = y * width;
        const float row = camera->at_row(int(y), int(height));
        across(larger<Long>(first - start, 0), smaller<Long>(last - start, width), EACH(F, Long x) {
            const float* facing = normal(y, x);
            const F normals[3] = {pick<F, 3>(facing), pick<F, 3>(facing + 1),
                                  pick<F, 3>(facing + 2)};
            const F column = camera->at_column<F>(ramp<F>(float(x), 1.0f), int(width));
            const auto found = point_of<F>(*camera, *box, column, row, load<F>(depth(y, x)),
                                           normals);
            for (int c = 0; c < POINT; c++) spread<POINT>(points(start + x) + c, found.at[c]);
        });
    }
}
EXPORT(scene_points, scene_points_rows)

static void scene_light_row(Long y, View<const float, 2> values, Picture diffuse, Picture specular,
                            Picture colour, View<float, 3> output) {
    const Long width = output.size[1];
    across(0, width, EACH(F, Long x) {
        F given[3], albedo[3], light[3];
        for (int c = 0; c < 3; c++) {
            given[c] = pick<F, 3>(values(y * width + x) + c);
            albedo[c] = pick<F, 3>(diffuse(y, x) + c) + pick<F, 3>(specular(y, x) + c);
            light[c] = pick<F, 3>(colour(y, x) + c);
        }
        shade<F>(given, albedo, light);
        store_triples<F>(output(y, x), light[0], light[1], light[2]);
    });
}
EXPORT(scene_light, scene_light_row)

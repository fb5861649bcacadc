// Motion of what smooth surfaces reflect, pixel by pixel: few are smooth.
#include "reflections.h"
#include "../rows.h"

static void reflection_row(Long y, Picture motion, Picture depth, Picture normal, Picture roughness,
                           Picture diffuse, Picture specular, Picture hit_distance,
                           Given<Camera> camera, View<float, 3> reflected) {
    const int height = int(depth.size[0]), width = int(depth.size[1]);
    const Surfaces<Picture> surfaces = {depth, normal, hit_distance, *camera, height, width};
    const float *from = motion(y), *hit = hit_distance(y), *far = depth(y), *rough = roughness(y);
    const float *some = diffuse(y), *others = specular(y);
    float* out = reflected(y);
    across(0, 2 * width, EACH(F, Long i) {
        store<F>(out + i, possible_motion<F>(load<F>(from + i)));
    });
    for (int x = 0; x < width; x++) {
        if (!reflects(hit[x], far[x], rough[x], some + 3 * x, others + 3 * x)) continue;
        surfaces.follow(int(y), x, rough[x], out + 2 * x);
    }
}
EXPORT(denoise_reflections, reflection_row)

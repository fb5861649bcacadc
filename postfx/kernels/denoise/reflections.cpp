// Motion of what smooth surfaces reflect, pixel by pixel: few are smooth.
#include "reflections.h"

static void reflection_rows(Long first, Long last, Picture motion, Picture depth, Picture normal,
                            Picture roughness, Picture diffuse, Picture specular,
                            Picture hit_distance, Given<Camera> camera, View<float, 3> reflected) {
    const Surfaces surfaces = {depth, normal, hit_distance, *camera};
    for (Long y = first; y < last; y++) {
        const float *from = motion(y), *hit = hit_distance(y), *far = depth(y),
                    *rough = roughness(y);
        const float *some = diffuse(y), *others = specular(y);
        float* out = reflected(y);
        across(0, 2 * depth.size[1], PIXELS(auto one, Long i) {
            typedef decltype(one) F;
            store<F>(out + i, possible_motion<F>(load<F>(from + i)));
        });
        for (Long x = 0; x < depth.size[1]; x++) {
            const float z = far[x];
            if (!(hit[x] > 0.0f && z > 0.0f && z < FARTHEST)) continue;
            if (!reflects(some + 3 * x, others + 3 * x, rough[x])) continue;
            const Vector ray = surfaces.ray(y, x), still = camera->motion(ray, 1.0f / z);
            const float own_x = out[2 * x], own_y = out[2 * x + 1];
            const float most = STILL
                               + PART * larger<float>(size_of<float>(own_x), size_of<float>(own_y));
            if (!(size_of<float>(still.x - own_x) <= most
                  && size_of<float>(still.y - own_y) <= most))
                continue;
            const float bend = surfaces.curvature(y, x), mean = surfaces.inverse_distance(y, x);
            if (bend < 0.0f || mean < 0.0f) continue;
            const float smooth = 1.0f - within<float>(rough[x], 0.0f, 1.0f);
            const float inverse = mean / (smooth * (root_of(smooth) + 1.0f - smooth)) + 2.0f * bend;
            const float stretched = inverse * root_of(ray.x * ray.x + ray.y * ray.y + 1.0f);
            const Vector moved = camera->motion(ray, stretched / (1.0f + stretched * z));
            if (moved.z > 1e-3f) {
                out[2 * x] = moved.x;
                out[2 * x + 1] = moved.y;
            }
        }
    }
}
EXPORT(denoise_reflections, reflection_rows)

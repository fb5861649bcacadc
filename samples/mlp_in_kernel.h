// The kernels of mlp_in_kernel.py on a CPU: a vector of pixels at once.
#include "mlp.h"
#include "rows.h"

typedef View<const float, 3> Picture;
typedef View<float, 3> NewPicture;

// Of pixels x, x + 1 ... of a row: their normals, and where they lie between -1 and 1.
template <class F> FN void features_of(const Picture& normal, Long x, Long y, F (&found)[5]) {
    const float height = float(normal.size[0]), width = float(normal.size[1]);
    for (int c = 0; c < 3; c++) found[c] = pick<F, 3>(normal(y, x) + c);
    found[3] = ramp<F>(float(2 * x + 1), 2.0f) / width - 1.0f;
    found[4] = F(float(2 * y + 1) / height - 1.0f);
}
template <class F> FN void shade(const float* albedo, const F (&light)[3], float* shaded) {
    F colour[3];
    for (int c = 0; c < 3; c++) colour[c] = pick<F, 3>(albedo + c) * larger<F>(F(0.0f), light[c]);
    store_triples<F>(shaded, colour[0], colour[1], colour[2]);
}

static void shade_by_network(Long first, Long last, View<const float, 1> parameters,
                             Picture normal, Picture albedo, NewPicture shaded) {
    for (Long y = first; y < last; y++) {
        across(0, shaded.size[1], EACH(F, Long x) {
            F features[5], light[3];
            features_of<F>(normal, x, y, features);
            mlp<GELU, 5, 32, 32, 3>(parameters.at, features, light);
            shade<F>(albedo(y, x), light, shaded(y, x));
        });
    }
}
EXPORT(shade_by_network, shade_by_network)

static void features_of_pixels(Long first, Long last, Picture normal, NewPicture points) {
    for (Long y = first; y < last; y++) {
        across(0, points.size[1], EACH(F, Long x) {
            F features[5];
            features_of<F>(normal, x, y, features);
            for (int k = 0; k < 5; k++) spread<5, F>(points(y, x) + k, features[k]);
        });
    }
}
EXPORT(features_of_pixels, features_of_pixels)

static void shade_by_values(Long first, Long last, Picture albedo, Picture values,
                            NewPicture shaded) {
    for (Long y = first; y < last; y++) {
        across(0, shaded.size[1], EACH(F, Long x) {
            F light[3];
            for (int c = 0; c < 3; c++) light[c] = pick<F, 3>(values(y, x) + c);
            shade<F>(albedo(y, x), light, shaded(y, x));
        });
    }
}
EXPORT(shade_by_values, shade_by_values)

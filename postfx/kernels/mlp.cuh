// What mlp.h, which follows in the place of its include, needs on a GPU. A thread evaluates its
// point:
//
//     #include <postfx/mlp.cuh>
//     float features[14], light[3];
//     mlp<GELU, 14, 64, 64, 3>(parameters.at, features, light);
#include "number.cuh"
#include "gelu.h"

enum Activation { RELU, GELU, SINE };

template <int KIND, class F> FN Active<F> activated(F z) {
    if (KIND == SINE) return {sinf(z), cosf(z)};
    if (KIND == GELU) return gelu_of<F>(z);
    return {z < 0.0f ? 0.0f : z, z > 0.0f ? 1.0f : 0.0f};
}

#include "mlp.h"
#undef FN
#undef FN_MEMBER
#undef UNROLL

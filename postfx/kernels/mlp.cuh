// What mlp.h, which follows in the place of its include, needs on a GPU. A thread evaluates its
// point:
//
//     #include <postfx/mlp.cuh>
//     float features[14], light[3];
//     mlp<GELU, 14, 64, 64, 3>(parameters.at, features, light);
#define FN __device__ inline
#define FN_MEMBER __device__
#define UNROLL _Pragma("unroll")

enum Activation { RELU, GELU, SINE };

template <class F> struct Active {
    F value;
};
template <int KIND, class F> FN Active<F> activated(F z) {
    if (KIND == SINE) return {sinf(z)};
    if (KIND == GELU) return {0.5f * z * (1.0f + erff(z * 0.7071067811865476f))};
    return {z < 0.0f ? 0.0f : z};
}

#include "mlp.h"
#undef FN
#undef FN_MEMBER
#undef UNROLL

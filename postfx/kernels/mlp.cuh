// What mlp.h, which follows in the place of its include, needs on a GPU. A thread evaluates its
// point:
//
//     #include <postfx/mlp.cuh>
//     float features[14], light[3];
//     mlp<GELU, 14, 64, 64, 3>(parameters.at, features, light);
//
// Where all threads of a warp are there, and the network is neither tiny nor wide, they do so
// together by the matrix units. Results have float32's precision either way.
#include "number.cuh"
#include "gelu.h"
#include "matrix.cuh"

enum Activation { RELU, GELU, SINE };

template <int KIND, class F> FN Active<F> activated(F z) {
    if (KIND == SINE) return {sinf(z), cosf(z)};
    if (KIND == GELU) return gelu_of<F>(z);
    return {z < 0.0f ? 0.0f : z, z > 0.0f ? 1.0f : 0.0f};
}

#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
#define MATRIX_UNITS
#include "mlp_warp.cuh"
#endif
#include "mlp.h"
#undef MATRIX_UNITS
#undef FN
#undef FN_MEMBER
#undef UNROLL

// A small network inside of a kernel of one's own, between its other instructions: of as many
// points as F has numbers, and on a GPU, whose sources include <postfx/mlp.cuh>, of a thread's
// point, or of a warp's by its matrix units.
//
//     #include "mlp.h"
//     F features[14], light[3];
//     mlp<GELU, 14, 64, 64, 3>(parameters.at, features, light);
//
// `parameters` are those of postfx.neural.Network: of each layer the weights (outputs, inputs) and
// the biases. Sizes are what the first layer reads, then the outputs of every layer; an activation
// follows each but the last.
#pragma once
#include "neural.h"

// COUNT outputs of a layer at once, so that each input is read once for them.
template <int READS, int COUNT, class F>
FN void mlp_outputs(const float* weights, const float* biases, const F* features, F* values) {
    F sums[COUNT];
    UNROLL for (int j = 0; j < COUNT; j++) sums[j] = F(biases[j]);
    for (int i = 0; i < READS; i++) {
        const F feature = features[i];
        UNROLL for (int j = 0; j < COUNT; j++) sums[j] += weights[j * READS + i] * feature;
    }
    UNROLL for (int j = 0; j < COUNT; j++) values[j] = sums[j];
}
template <int READS, int MAKES, class F>
FN void mlp_layer(const float* parameters, const F* features, F* values) {
    constexpr int TOGETHER = 8, REST = MAKES % TOGETHER, WHOLE = MAKES - REST;
    const float* const biases = parameters + READS * MAKES;
    for (int j = 0; j < WHOLE; j += TOGETHER) {
        mlp_outputs<READS, TOGETHER>(parameters + j * READS, biases + j, features, values + j);
    }
    if constexpr (REST > 0) {
        mlp_outputs<READS, REST>(parameters + WHOLE * READS, biases + WHOLE, features,
                                 values + WHOLE);
    }
}

template <int KIND, int READS, int MAKES, int... REST> struct MlpLayers {
    template <class F> FN_MEMBER static void run(const float* parameters, const F* features,
                                                 F* values) {
        F made[MAKES];
        mlp_layer<READS, MAKES>(parameters, features, made);
        for (int j = 0; j < MAKES; j++) made[j] = activated<KIND, F>(made[j]).value;
        MlpLayers<KIND, MAKES, REST...>::run(parameters + (READS + 1) * MAKES, made, values);
    }
};
template <int KIND, int READS, int MAKES> struct MlpLayers<KIND, READS, MAKES> {  // the last one
    template <class F> FN_MEMBER static void run(const float* parameters, const F* features,
                                                 F* values) {
        mlp_layer<READS, MAKES>(parameters, features, values);
    }
};

template <int KIND, int... SIZES, class F>
FN void mlp(const float* parameters, const F* features, F* values) {
#ifdef MATRIX_UNITS
    if (mlp_by_warp<KIND, SIZES...>(parameters, features, values)) return;
#endif
    MlpLayers<KIND, SIZES...>::run(parameters, features, values);
}

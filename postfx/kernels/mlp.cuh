// A small network inside of a kernel of one's own, between its other instructions; a thread evaluates a point.
//
//     #include <postfx/mlp.cuh>
//     float features[14], light[3];
//     mlp<GELU, 14, 64, 64, 3>(parameters.at, features, light);
//
// `parameters` are those of postfx.neural.Network: of each layer the weights (outputs, inputs) and the biases. Sizes are
// what the first layer reads, then the outputs of every layer; an activation follows each but the last.

enum Activation { RELU, GELU, SINE };

template <int KIND>
__device__ inline float mlp_activate(float z) {
    if (KIND == SINE) return sinf(z);
    if (KIND == GELU) return 0.5f * z * (1.0f + erff(z * 0.7071067811865476f));
    return fmaxf(z, 0.0f);
}

// A layer that others follow. The sums of eight outputs are made at once, so that each input is read once for them.
template <int KIND, int READS, int MAKES, int... REST>
struct MlpLayers {
    __device__ static inline void run(const float* parameters, const float* features, float* values) {
        const float* const biases = parameters + READS * MAKES;
        float made[MAKES];
        for (int first = 0; first < MAKES; first += 8) {
            float sums[8];
#pragma unroll
            for (int j = 0; j < 8; j++) sums[j] = first + j < MAKES ? biases[first + j] : 0.0f;
            for (int i = 0; i < READS; i++) {
#pragma unroll
                for (int j = 0; j < 8; j++) {
                    if (first + j < MAKES) sums[j] += parameters[(first + j) * READS + i] * features[i];
                }
            }
#pragma unroll
            for (int j = 0; j < 8; j++) {
                if (first + j < MAKES) made[first + j] = mlp_activate<KIND>(sums[j]);
            }
        }
        MlpLayers<KIND, MAKES, REST...>::run(biases + MAKES, made, values);
    }
};

// The last layer.
template <int KIND, int READS, int MAKES>
struct MlpLayers<KIND, READS, MAKES> {
    __device__ static inline void run(const float* parameters, const float* features, float* values) {
        const float* const biases = parameters + READS * MAKES;
        for (int j = 0; j < MAKES; j++) {
            float sum = biases[j];
            for (int i = 0; i < READS; i++) sum += parameters[j * READS + i] * features[i];
            values[j] = sum;
        }
    }
};

template <int KIND, int... SIZES>
__device__ inline void mlp(const float* parameters, const float* features, float* values) {
    MlpLayers<KIND, SIZES...>::run(parameters, features, values);
}

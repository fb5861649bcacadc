// What the CUDA kernels share: tensors, positions and the small functions of postfx/kernels/numeric.py.
//
// A kernel takes one View for each of its bindings, in their order. A thread makes one pixel: x counts the axis after
// `row_axis`, y that axis itself (postfx/kernels/kernel.py). Kernels whose row binding has one axis run as one block.

struct View {
    float* __restrict__ at;
    int size[4];
};

#define PIXEL(width, height) \
    const int x = blockIdx.x * blockDim.x + threadIdx.x, y = blockIdx.y * blockDim.y + threadIdx.y; \
    if (x >= (width) || y >= (height)) return

const float MAX_COLOUR = 1e4f, TINY = 1e-8f, MAX_COUNT = 32.0f, MAX_DEPTH = 1e10f, MAX_FLOAT = 3e38f;
// Channels of the fine head, of a filter kernel and of the parameters: postfx/kernels/denoise_layout.py.
enum { HIDDEN = 8, KERNEL = 25, PHASES = 25, BLEND = 61, SHARPEN = 65, MIX = 69, DISTRUST = 70, IMPORTANCE = 71, MEMORY = 72 };
enum { EXPOSURE, JITTER_X, JITTER_Y, FRESH, GAIN };

struct Colour {
    float r, g, b;
};

// Within [low, high], which holds 0 or lies above it; a NaN becomes the value nearest to 0.
__device__ inline float clamped(float value, float low, float high) {
    return fminf(fmaxf(low, value == value ? value : 0.0f), high);
}

__device__ inline int within(int index, int size) {
    return min(max(index, 0), size - 1);
}

// A row that goes on beyond its end as in a mirror, and stops at its start.
__device__ inline int mirrored(int index, int size) {
    return max(size - 1 - abs(index - (size - 1)), 0);
}

// The render pixel that holds an output pixel's centre; `offset` becomes the centre's offset from it in [-0.5, 0.5).
__device__ inline int centre(int position, int size, int out_size, float& offset) {
    const long long at = (2LL * position + 1) * size;  // in units of 1 / (2 out_size): exact
    const int index = int(at / (2LL * out_size));
    offset = float(double(at - index * (2LL * out_size)) / (2.0 * out_size) - 0.5);
    return index;
}

// log(1 + x) of an exposed colour in [0, 1e4].
__device__ inline float log_encode(float exposed) {
    return log1pf(fminf(fmaxf(0.0f, exposed), MAX_COLOUR));
}

// Reflectance that colour is divided by at a pixel (y, x) of albedos (h, w, 3).
__device__ inline Colour demodulation(const View& diffuse, const View& specular, int y, int x) {
    const int at = 3 * (y * diffuse.size[1] + x);
    const float r = clamped(diffuse.at[at] + specular.at[at], 0.0f, 4.0f);
    const float g = clamped(diffuse.at[at + 1] + specular.at[at + 1], 0.0f, 4.0f);
    const float b = clamped(diffuse.at[at + 2] + specular.at[at + 2], 0.0f, 4.0f);
    const float peak = fmaxf(r, fmaxf(g, b)), floor = 0.15f * peak;
    if (peak < 0.005f) return {1.0f, 1.0f, 1.0f};
    return {fmaxf(r, floor) + 0.01f, fmaxf(g, floor) + 0.01f, fmaxf(b, floor) + 0.01f};
}

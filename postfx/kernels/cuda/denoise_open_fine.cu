// Activations of the fine head, from channels last in half precision, four phases a pixel, to planes.
extern "C" __global__ void __launch_bounds__(256) denoise_open_fine(View raw, View fine) {
    PIXEL(fine.size[3], fine.size[2]);
    const size_t plane = size_t(fine.size[2]) * fine.size[3];
    const size_t pixel = size_t(y / 2) * raw.size[2] + x / 2;
    const Halves* const from = halves(raw) + (4 * pixel + 2 * (y % 2) + x % 2) * (FINE / 8);
    float* const to = fine.at + size_t(y) * fine.size[3] + x;
#pragma unroll
    for (int first = 0; first < FINE; first += 8) {
        const Halves some = from[first / 8];
#pragma unroll
        for (int i = 0; i < 8; i++) {
            const int channel = first + i;
            const float logit = from_half(some.at[i]);
            to[channel * plane] = channel < BLEND ? weight_of(logit) : channel < MEMORY ? gate_of(logit) : tanhf(logit);
        }
    }
}

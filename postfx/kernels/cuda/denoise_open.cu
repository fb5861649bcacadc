// Activations of a level's heads, from channels last in half precision to planes.
extern "C" __global__ void __launch_bounds__(256) denoise_open(View raw, View heads) {
    PIXEL(heads.size[3], heads.size[2]);
    const size_t plane = size_t(heads.size[2]) * heads.size[3], at = size_t(y) * heads.size[3] + x;
    const Halves* const from = halves(raw) + at * (raw.size[3] / 8);
    float* const to = heads.at + at;
    for (int first = 0; first < heads.size[1]; first += 8) {
        const Halves some = from[first / 8];
#pragma unroll
        for (int i = 0; i < 8; i++) {
            const int channel = first + i;
            const float logit = from_half(some.at[i]);
            if (channel < heads.size[1]) to[channel * plane] = channel < KERNEL ? weight_of(logit) : gate_of(logit);
        }
    }
}

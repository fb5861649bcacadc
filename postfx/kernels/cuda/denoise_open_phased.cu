// Activations of the fine head, from planes that hold the four phases of each channel one after the other.
extern "C" __global__ void __launch_bounds__(256) denoise_open_phased(View phased, View fine) {
    PIXEL(fine.size[3], fine.size[2]);
    const size_t plane = size_t(fine.size[2]) * fine.size[3], part = size_t(phased.size[2]) * phased.size[3];
    const float* const from = phased.at + (2 * (y % 2) + x % 2) * part + size_t(y / 2) * phased.size[3] + x / 2;
    float* const to = fine.at + size_t(y) * fine.size[3] + x;
    for (int channel = 0; channel < FINE; channel++) {
        const float logit = from[4 * channel * part];
        to[channel * plane] = channel < BLEND ? weight_of(logit) : channel < MEMORY ? gate_of(logit) : tanhf(logit);
    }
}

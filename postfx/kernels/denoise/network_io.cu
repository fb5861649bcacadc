// Channels of a pixel together, in half precision; zeros up to a multiple of eight.
extern "C" __global__ void __launch_bounds__(256) denoise_pack(View planes, View packed) {
    PIXEL(packed.size[2], packed.size[1]);
    const size_t plane = size_t(planes.size[2]) * planes.size[3],
                 at = size_t(y) * packed.size[2] + x;
    const float* const from = planes.at + at;
    Halves* const to = halves(packed) + at * (packed.size[3] / 8);
    for (int first = 0; first < packed.size[3]; first += 8) {
        Halves some;
        UNROLL for (int i = 0; i < 8; i++)
            some.at[i] = first + i < planes.size[1] ? to_half(from[(first + i) * plane]) : 0;
        to[first / 8] = some;
    }
}

// Activations of a level's heads, from channels last to planes, both in half precision.
extern "C" __global__ void __launch_bounds__(256) denoise_open_half(View raw, View heads) {
    PIXEL(heads.size[3], heads.size[2]);
    const size_t plane = size_t(heads.size[2]) * heads.size[3], at = size_t(y) * heads.size[3] + x;
    const Halves* const from = halves(raw) + at * (raw.size[3] / 8);
    Half* const to = reinterpret_cast<Half*>(heads.at) + at;
    for (int first = 0; first < heads.size[1]; first += 8) {
        const Halves some = from[first / 8];
        UNROLL for (int i = 0; i < 8; i++) {
            const int channel = first + i;
            const float logit = from_half(some.at[i]);
            if (channel < heads.size[1])
                to[channel * plane] = to_half(channel < KERNEL ? weight_of(logit) : gate_of(logit));
        }
    }
}

// The activation of a channel of the fine head.
FN float fine_of(int channel, float logit) {
    if (channel < BLEND) return weight_of(logit);
    return channel < MEMORY ? gate_of(logit) : tanhf(logit);
}

// Activations of the fine head, from channels last, four phases a pixel, to planes, both in half
// precision.
extern "C" __global__ void __launch_bounds__(256) denoise_open_fine_half(View raw, View fine) {
    PIXEL(fine.size[3], fine.size[2]);
    const size_t plane = size_t(fine.size[2]) * fine.size[3];
    const size_t pixel = size_t(y / 2) * raw.size[2] + x / 2;
    const Halves* const from = halves(raw) + (4 * pixel + 2 * (y % 2) + x % 2) * (FINE / 8);
    Half* const to = reinterpret_cast<Half*>(fine.at) + size_t(y) * fine.size[3] + x;
    UNROLL for (int first = 0; first < FINE; first += 8) {
        const Halves some = from[first / 8];
        UNROLL for (int i = 0; i < 8; i++) {
            const int channel = first + i;
            const float logit = from_half(some.at[i]);
            to[channel * plane] = to_half(fine_of(channel, logit));
        }
    }
}

// Activations of the fine head, from planes that hold the four phases of each channel one after the
// other.
extern "C" __global__ void __launch_bounds__(256) denoise_open_phased(View phased, View fine) {
    PIXEL(fine.size[3], fine.size[2]);
    const size_t plane = size_t(fine.size[2]) * fine.size[3],
                 part = size_t(phased.size[2]) * phased.size[3];
    const float* const from = phased.at + (2 * (y % 2) + x % 2) * part
                              + size_t(y / 2) * phased.size[3] + x / 2;
    float* const to = fine.at + size_t(y) * fine.size[3] + x;
    for (int channel = 0; channel < FINE; channel++) {
        const float logit = from[4 * channel * part];
        to[channel * plane] = fine_of(channel, logit);
    }
}

// The expected squared error of a part's pixels: log_error (1, 1, hp, wp), part_rows (th,),
// part_columns (tw,) -> error (th, tw, 1).
extern "C" __global__ void denoise_open_error(View log_error, View part_rows, View part_columns,
                                                                        View error) {
    PIXEL(error.size[1], error.size[0]);
    error.at[size_t(y) * error.size[1] + x] = expf(
        clamped(log_error.at[size_t(y) * log_error.size[3] + x], LEAST_LOG_ERROR, MOST_LOG_ERROR));
}

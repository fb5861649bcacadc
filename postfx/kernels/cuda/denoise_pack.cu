// Channels of a pixel together, in half precision; zeros up to a multiple of eight.
extern "C" __global__ void __launch_bounds__(256) denoise_pack(View planes, View packed) {
    PIXEL(packed.size[2], packed.size[1]);
    const size_t plane = size_t(planes.size[2]) * planes.size[3], at = size_t(y) * packed.size[2] + x;
    const float* const from = planes.at + at;
    Halves* const to = halves(packed) + at * (packed.size[3] / 8);
    for (int first = 0; first < packed.size[3]; first += 8) {
        Halves some;
#pragma unroll
        for (int i = 0; i < 8; i++)
            some.at[i] = first + i < planes.size[1] ? to_half(from[(first + i) * plane]) : 0;
        to[first / 8] = some;
    }
}

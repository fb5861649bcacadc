// Importance-weighted mean over 2x2 pixels: finer (4, 2 hp, 2 wp) -> level (4, hp, wp); channel 3 is the importance.
extern "C" __global__ void denoise_pool(View finer, View level) {
    const int height = level.size[1], width = level.size[2];
    PIXEL(width, height);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    const size_t fine = 2 * plane;  // pairs in a fine plane; a fine row holds `width` of them
    const Pair* upper = &pair(finer, size_t(2 * y) * width + x);
    const Pair* lower = upper + width;
    const Pair ab = upper[3 * fine], cd = lower[3 * fine];
    const Pair r0 = upper[0], g0 = upper[fine], b0 = upper[2 * fine];
    const Pair r1 = lower[0], g1 = lower[fine], b1 = lower[2 * fine];
    const float total = 0.25f * (ab.x + ab.y + cd.x + cd.y), share = 0.25f / (total + TINY);
    float* to = level.at + here;
    to[0] = share * (ab.x * r0.x + ab.y * r0.y + cd.x * r1.x + cd.y * r1.y);
    to[plane] = share * (ab.x * g0.x + ab.y * g0.y + cd.x * g1.x + cd.y * g1.y);
    to[2 * plane] = share * (ab.x * b0.x + ab.y * b0.y + cd.x * b1.x + cd.y * b1.y);
    to[3 * plane] = total;
}

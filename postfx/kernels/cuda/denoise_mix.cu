// The coarser result where the network trusts it more than the level's own colour: coarse (3, about hp / 2, about wp / 2),
// level (4, hp, wp), heads (1, 26 or more, hp, wp), rows (hp,) and columns (wp,) of coarse that pixels lie in
// -> mixed (3, hp, wp).
extern "C" __global__ void denoise_mix(View coarse, View level, View heads, View rows, View columns, View mixed) {
    const int height = mixed.size[1], width = mixed.size[2];
    PIXEL(width, height);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    const size_t below_plane = size_t(coarse.size[1]) * coarse.size[2];
    const size_t below = size_t(int(rows.at[y])) * coarse.size[2] + int(columns.at[x]);
    // The full head has the channel elsewhere than the short ones of the coarser levels.
    const size_t channel = heads.size[1] > KERNEL + 1 ? MIX : KERNEL;
    const float own = heads.at[channel * plane + here];
    const float r = coarse.at[below], g = coarse.at[below_plane + below], b = coarse.at[2 * below_plane + below];
    const float r1 = level.at[here], g1 = level.at[plane + here], b1 = level.at[2 * plane + here];
    mixed.at[here] = r + (r1 - r) * own;
    mixed.at[plane + here] = g + (g1 - g) * own;
    mixed.at[2 * plane + here] = b + (b1 - b) * own;
}

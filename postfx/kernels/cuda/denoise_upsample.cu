// Enlarges, sharpens and blends with the past: radiance (3, h + 2, w + 2), fine (1, 80, hp, wp), moved (h, w, 2),
// warped (height, width, 3), params (5,) -> output, next_history (height, width, 3).
extern "C" __global__ void denoise_upsample(View radiance, View fine, View moved, View warped, View params,
                                            View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Enlarged found = enlarged(x, y, width, height, radiance, fine, moved, params);
    const float darken = 1.0f / params.at[EXPOSURE];
    const int at = 3 * (y * width + x);
    blend_history(found.colour.r, found.kept, at, darken, warped, output, next_history);
    blend_history(found.colour.g, found.kept, at + 1, darken, warped, output, next_history);
    blend_history(found.colour.b, found.kept, at + 2, darken, warped, output, next_history);
}

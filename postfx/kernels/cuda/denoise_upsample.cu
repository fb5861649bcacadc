// Enlarges, sharpens and blends with the past: radiance (3, th + 2, tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2),
// past (th, tw, 4), warped (out_th, out_tw, 3), params (4,), window (8,), keep -> output, next_history
// (out_th, out_tw, 3).
extern "C" __global__ void denoise_upsample(View radiance, View fine, View moved, View past, View warped, View params,
                                            View window, View keep, View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1), u = min(part.out_left + x, part.width - 1);
    const Enlarged found = enlarged(u, v, part, radiance, fine, moved, past, params, keep);
    const float darken = 1.0f / params.at[EXPOSURE];
    const int at = 3 * (y * width + x);
    blend_history(found.colour.r, found.kept, at, darken, warped, output, next_history);
    blend_history(found.colour.g, found.kept, at + 1, darken, warped, output, next_history);
    blend_history(found.colour.b, found.kept, at + 2, darken, warped, output, next_history);
}

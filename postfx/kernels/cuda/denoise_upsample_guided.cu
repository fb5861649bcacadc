// Enlarges radiance without reflectance, puts that back and blends with the past: radiance
// (3, th + 2, tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2), past (th, tw, 4), warped (out_th, out_tw, 3),
// guide_diffuse_albedo, guide_specular_albedo (height, width, 3), params (4,), window (8,), keep -> output, next_history
// (out_th, out_tw, 3).
extern "C" __global__ void denoise_upsample_guided(View radiance, View fine, View moved, View past,
                                                   View warped, View guide_diffuse_albedo, View guide_specular_albedo,
                                                   View params, View window, View keep, View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1), u = min(part.out_left + x, part.width - 1);
    const Colour factor = demodulation(guide_diffuse_albedo, guide_specular_albedo, v, u);
    const Enlarged found = enlarged(u, v, part, radiance, fine, moved, past, params, keep);
    const float darken = 1.0f / params.at[EXPOSURE];
    const int at = 3 * (y * width + x);
    const float r = log_encode(expm1f(found.colour.r) * factor.r);
    const float g = log_encode(expm1f(found.colour.g) * factor.g);
    const float b = log_encode(expm1f(found.colour.b) * factor.b);
    blend_history(r, found.kept, at, darken, warped, output, next_history);
    blend_history(g, found.kept, at + 1, darken, warped, output, next_history);
    blend_history(b, found.kept, at + 2, darken, warped, output, next_history);
}

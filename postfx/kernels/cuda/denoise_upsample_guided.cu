// Enlarges radiance without reflectance, puts that back and blends with the past: radiance (3, h + 2, w + 2),
// fine (1, 80, hp, wp), moved (h, w, 2), warped, guide_diffuse_albedo, guide_specular_albedo (height, width, 3),
// params (5,) -> output, next_history (height, width, 3).
extern "C" __global__ void denoise_upsample_guided(View radiance, View fine, View moved, View warped,
                                                   View guide_diffuse_albedo, View guide_specular_albedo, View params,
                                                   View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Colour factor = demodulation(guide_diffuse_albedo, guide_specular_albedo, y, x);
    const Enlarged found = enlarged(x, y, width, height, radiance, fine, moved, params);
    const float darken = 1.0f / params.at[EXPOSURE];
    const int at = 3 * (y * width + x);
    const float r = log_encode(expm1f(found.colour.r) * factor.r);
    const float g = log_encode(expm1f(found.colour.g) * factor.g);
    const float b = log_encode(expm1f(found.colour.b) * factor.b);
    blend_history(r, found.kept, at, darken, warped, output, next_history);
    blend_history(g, found.kept, at + 1, darken, warped, output, next_history);
    blend_history(b, found.kept, at + 2, darken, warped, output, next_history);
}

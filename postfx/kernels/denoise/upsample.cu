// Enlarges, sharpens and blends with the past: radiance (3, th + 2, tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2),
// past (th, tw, 4), warped (out_th, out_tw, 3), params (4,), window (8,), keep -> output, next_history
// (out_th, out_tw, 3).
template <class Number>
__device__ inline void upsample(View radiance, View fine, View moved, View past, View warped, View params, View window,
                                View keep, View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1), u = min(part.out_left + x, part.width - 1);
    const Enlarged found = enlarged<Number>(u, v, part, radiance, fine, moved, past, params, keep);
    blend_pixel(found, y * width + x, params, warped, output, next_history);
}

extern "C" __global__ void denoise_upsample(View radiance, View fine, View moved, View past, View warped, View params,
                                            View window, View keep, View output, View next_history) {
    upsample<float>(radiance, fine, moved, past, warped, params, window, keep, output, next_history);
}

extern "C" __global__ void denoise_upsample_half(View radiance, View fine, View moved, View past, View warped,
                                                 View params, View window, View keep, View output, View next_history) {
    upsample<Half>(radiance, fine, moved, past, warped, params, window, keep, output, next_history);
}

// Enlarges radiance without reflectance times the guides', as far as these are trusted, and for the rest with that of the
// render size; sharpens it and blends with the past: radiance (6, th + 2, tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2),
// past (th, tw, 4), warped (out_th, out_tw, 3), guide_diffuse_albedo, guide_specular_albedo (height, width, 3), trust
// (cells, cells, 1), params (4,), window (8,), keep -> output, next_history (out_th, out_tw, 3).

// Where an output pixel's centre lies among the cells along a side, from centre to centre.
__device__ inline float place_of(int position, int size, int out_size, int first, int count) {
    float offset;
    const int at = within(centre(position, size, out_size, offset) - first, count);
    const float place = (at + offset + 0.5f) / TRUST_CELL - 0.5f;
    return fminf(fmaxf(place, 0.0f), float((min(count, size - first) - 1) / TRUST_CELL));
}

__device__ inline float trusted(const View& trust, float down, float across) {
    const int upper = int(down), lower = min(upper + 1, trust.size[0] - 1);
    const int left = int(across), right = min(left + 1, trust.size[1] - 1);
    const float *const above = trust.at + upper * trust.size[1], *const below = trust.at + lower * trust.size[1];
    const float high = above[left] + (above[right] - above[left]) * (across - left);
    const float low = below[left] + (below[right] - below[left]) * (across - left);
    return high + (low - high) * (down - upper);
}

template <class Number>
__device__ inline void upsample_guided(View radiance, View fine, View moved, View past, View warped,
                                       View guide_diffuse_albedo, View guide_specular_albedo, View trust, View params,
                                       View window, View keep, View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1), u = min(part.out_left + x, part.width - 1);
    const Guide guide = {demodulation(guide_diffuse_albedo, guide_specular_albedo, v, u),
                         trusted(trust, place_of(v, part.h, part.height, part.top, moved.size[0]),
                                 place_of(u, part.w, part.width, part.left, moved.size[1]))};
    const Enlarged found = enlarged<Number, BY_GUIDES>(u, v, part, radiance, fine, moved, past, params, keep, guide);
    blend_pixel(found, y * width + x, params, warped, output, next_history);
}

extern "C" __global__ void denoise_upsample_guided(View radiance, View fine, View moved, View past, View warped,
                                                   View guide_diffuse_albedo, View guide_specular_albedo, View trust,
                                                   View params, View window, View keep, View output,
                                                   View next_history) {
    upsample_guided<float>(radiance, fine, moved, past, warped, guide_diffuse_albedo, guide_specular_albedo, trust,
                           params, window, keep, output, next_history);
}

extern "C" __global__ void denoise_upsample_guided_half(View radiance, View fine, View moved, View past, View warped,
                                                        View guide_diffuse_albedo, View guide_specular_albedo,
                                                        View trust, View params, View window, View keep, View output,
                                                        View next_history) {
    upsample_guided<Half>(radiance, fine, moved, past, warped, guide_diffuse_albedo, guide_specular_albedo, trust,
                          params, window, keep, output, next_history);
}

// At the render size, where samples lie at the centres of the output's pixels: radiance without reflectance, which is
// multiplied after they are weighed, so that texture of one pixel is not resampled; else radiance that already holds it.
// radiance (6, th + 2, tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2), past (th, tw, 4), warped (out_th, out_tw, 3),
// factor (th, tw, 3), params (4,), window (8,), keep -> output, next_history (out_th, out_tw, 3).
template <class Number>
__device__ inline void upsample_unscaled(View radiance, View fine, View moved, View past, View warped, View factor,
                                         View params, View window, View keep, View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1), u = min(part.out_left + x, part.width - 1);
    const bool centred = params.at[JITTER_X] == 0.0f && params.at[JITTER_Y] == 0.0f;
    const float* const by = factor.at + 3 * (size_t(within(v - part.top, factor.size[0])) * factor.size[1]
                                             + within(u - part.left, factor.size[1]));
    const Guide guide = {centred ? Colour{by[0], by[1], by[2]} : Colour{1.0f, 1.0f, 1.0f}, 1.0f};
    View seen = radiance;
    if (!centred) seen.at += 3 * size_t(radiance.size[1]) * radiance.size[2];
    const Enlarged found = enlarged<Number, BY_OWN>(u, v, part, seen, fine, moved, past, params, keep, guide);
    blend_pixel(found, y * width + x, params, warped, output, next_history);
}

extern "C" __global__ void denoise_upsample_unscaled(View radiance, View fine, View moved, View past, View warped,
                                                     View factor, View params, View window, View keep, View output,
                                                     View next_history) {
    upsample_unscaled<float>(radiance, fine, moved, past, warped, factor, params, window, keep, output, next_history);
}

extern "C" __global__ void denoise_upsample_unscaled_half(View radiance, View fine, View moved, View past, View warped,
                                                          View factor, View params, View window, View keep, View output,
                                                          View next_history) {
    upsample_unscaled<Half>(radiance, fine, moved, past, warped, factor, params, window, keep, output, next_history);
}

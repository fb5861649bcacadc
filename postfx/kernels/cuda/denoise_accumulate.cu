// Running mean of demodulated colour: colour, diffuse_albedo and specular_albedo (h, w, 3), depth (h, w, 1),
// past (th, tw, 4), fine (1, 80, hp, wp), params (4,), window (8,) -> next_state (th, tw, 12), next_depth (th, tw, 1),
// level (4, hp, wp), which is the mean with its importance. All are zero beyond the frame.
__device__ inline float size_of(const Four& value) {
    return fabsf(value.x) + fabsf(value.y) + fabsf(value.z) + fabsf(value.w);
}

extern "C" __global__ void denoise_accumulate(View colour, View diffuse_albedo, View specular_albedo, View depth,
                                              View past, View fine, View params, View window, View next_state,
                                              View next_depth, View level) {
    const int height = level.size[1], width = level.size[2];
    PIXEL(width, height);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    float* to = level.at + here;
    const Window part = window_of(window);
    const bool kept = y < past.size[0] && x < past.size[1];
    const size_t pixel = size_t(y) * past.size[1] + x;
    if (!kept || part.top + y >= colour.size[0] || part.left + x >= colour.size[1]) {
        for (int c = 0; c < 4; c++) to[c * plane] = 0.0f;
        if (kept) next_depth.at[pixel] = 0.0f;
        for (int c = 0; c < 3 && kept; c++) four(next_state, 3 * pixel + c) = {0.0f, 0.0f, 0.0f, 0.0f};
        return;
    }
    const size_t source = size_t(part.top + y) * colour.size[1] + part.left + x;
    const float* rgb = colour.at + 3 * source;
    const float* head = fine.at + here;
    const float exposure = params.at[EXPOSURE], red = rgb[0], green = rgb[1], blue = rgb[2], z = depth.at[source];
    const float distrust = head[DISTRUST * plane], importance = head[IMPORTANCE * plane];
    const Four before = four(past, pixel);
    const Four hidden[2] = {{head[MEMORY * plane], head[(MEMORY + 1) * plane], head[(MEMORY + 2) * plane],
                             head[(MEMORY + 3) * plane]},
                            {head[(MEMORY + 4) * plane], head[(MEMORY + 5) * plane], head[(MEMORY + 6) * plane],
                             head[(MEMORY + 7) * plane]}};
    const Colour factor = demodulation(diffuse_albedo, specular_albedo, part.top + y, part.left + x);
    const float share = 1.0f / (fmaxf(before.w, 0.0f) + 1.0f), alpha = share + (1.0f - share) * distrust;
    const float r = fminf(clamped(red, 0.0f, MAX_FLOAT) * exposure / factor.r, MAX_COLOUR);
    const float g = fminf(clamped(green, 0.0f, MAX_FLOAT) * exposure / factor.g, MAX_COLOUR);
    const float b = fminf(clamped(blue, 0.0f, MAX_FLOAT) * exposure / factor.b, MAX_COLOUR);
    const Four mean = {before.x + (r - before.x) * alpha, before.y + (g - before.y) * alpha,
                       before.z + (b - before.z) * alpha, fminf(1.0f / alpha, MAX_COUNT)};
    // What is broken is this frame's colour alone, and nothing that the next one knows.
    const float total = size_of(mean) + size_of(hidden[0]) + size_of(hidden[1]) + fabsf(importance);
    const bool whole = total <= MOST_STATE;
    // Nor is what lies at the part's edge, where the frame goes on.
    const bool edge = (y == 0 && part.top > 0) || (x == 0 && part.left > 0) ||
        (y == past.size[0] - 1 && part.top + y + 1 < colour.size[0]) ||
        (x == past.size[1] - 1 && part.left + x + 1 < colour.size[1]);
    const bool known = whole && !edge;
    const Four none = {0.0f, 0.0f, 0.0f, 0.0f};
    four(next_state, 3 * pixel) = known ? mean : none;
    four(next_state, 3 * pixel + 1) = known ? hidden[0] : none;
    four(next_state, 3 * pixel + 2) = known ? hidden[1] : none;
    next_depth.at[pixel] = z;
    to[0] = whole ? mean.x : r;
    to[plane] = whole ? mean.y : g;
    to[2 * plane] = whole ? mean.z : b;
    to[3 * plane] = whole ? importance : 1.0f;
}

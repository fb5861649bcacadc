// The network's input and the reprojected accumulation: colour, diffuse_albedo, specular_albedo and
// normal (h, w, 3), roughness and depth (h, w, 1), moved (th, tw, 2), state (h, w, 12), last_depth
// (h, w, 1), warped (out_th, out_tw, 3), depth_scale (1,), params (4,), window (8,), keep, rows
// (hp,) and columns (wp,) of the part as the network sees them -> past (th, tw, 4), whose count is
// -1 where the history lacks a pixel of the frame, and
// features (1, 35, hp, wp): colour 0, accumulated colour 3, last output 6, diffuse albedo 9,
// specular albedo 12, normal 15, roughness 18, depth 19, its change 20, valid history 21, sample
// count 22, jitter 23, length of motion 25, inverse scale 26, hidden state 27. In half precision
// they are together, (1, hp, wp, 40).

// Mean of the output pixels that render pixel (y, x) of the frame touches.
FN Colour touched_mean(const View& warped, unsigned y, unsigned x, const Window& part) {
    const unsigned h = part.h, w = part.w, height = part.height, width = part.width;
    const int left = int(x * width / w) - part.out_left,
              right = int(((x + 1) * width + w - 1) / w) - part.out_left;
    const int top = int(y * height / h) - part.out_top,
              bottom = int(((y + 1) * height + h - 1) / h) - part.out_top;
    if (is_doubled(part)) {  // four pixels, all read at once
        const size_t upper = 3 * (size_t(top) * warped.size[1] + left) / 2,
                     lower = upper + 3 * warped.size[1] / 2;
        const Pair a = pair(warped, upper), b = pair(warped, upper + 1),
                   c = pair(warped, upper + 2);
        const Pair d = pair(warped, lower), e = pair(warped, lower + 1),
                   f = pair(warped, lower + 2);
        return {(a.x + b.y + d.x + e.y) * 0.25f, (a.y + c.x + d.y + f.x) * 0.25f,
                (b.x + c.y + e.x + f.y) * 0.25f};
    }
    Colour sum = {0.0f, 0.0f, 0.0f};
    for (int j = top; j < bottom; j++) {
        const float* row = warped.at + 3 * (size_t(j) * warped.size[1]);
        for (int i = left; i < right; i++) add(sum, three(row + 3 * i), 1.0f);
    }
    return sum * (1.0f / float((bottom - top) * (right - left)));
}

FN Colour three(const View& picture, size_t pixel) { return three(picture.at + 3 * pixel); }

FN void put_bounded(float* to, const Colour& value, float low, float high, size_t step = 1) {
    put(to, {clamped(value.r, low, high), clamped(value.g, low, high), clamped(value.b, low, high)},
        step);
}

FN void put_four(float* to, const Four& value) {
    put(to, {value.x, value.y, value.z});
    to[3] = value.w;
}

// All channels of a pixel go to planes, or stay together in half precision.
FN void keep_planes(const float* channels, const View& features, size_t pixel, size_t plane) {
    UNROLL for (int i = 0; i < FEATURES; i++) features.at[i * plane + pixel] = channels[i];
}

FN void keep_together(const float* channels, const View& packed, size_t pixel) {
    Halves* const to = halves(packed) + pixel * (packed.size[3] / 8);
    UNROLL for (int first = 0; first < FEATURES; first += 8) {
        Halves some;
        UNROLL for (int i = 0; i < 8; i++)
            some.at[i] = first + i < FEATURES ? to_half(channels[first + i]) : 0;
        to[first / 8] = some;
    }
}

// This frame's colour of a channel without reflectance, log-encoded; `share` is one over the
// reflectance.
FN float encoded_now(float value, float exposure, float share) {
    return log1p_of(fminf(clamped(value, 0.0f, MAX_FLOAT) * exposure * share, MAX_COLOUR));
}

// The same of the last output, which is log-encoded; what no frame can hold counts as the
// brightest.
FN float encoded_last(float encoded, float share) {
    return log_encode(expm1_of(fminf(fmaxf(encoded, 0.0f), MOST_LOG)) * share);
}

// The change of depth since the frame before.
FN float depth_change(float before, float depth) {
    const float ratio = clamped(before, NEAREST, MAX_DEPTH) / fmaxf(depth, NEAREST);
    return fminf(fmaxf(4.0f * logf(ratio), -1.0f), 1.0f);
}

template <class Number>
__global__ void denoise_features(View colour, View diffuse_albedo, View specular_albedo,
                                 View normal, View roughness, View depth, View moved, View state,
                                 View last_depth, View warped, View depth_scale, View params,
                                 View window, View keep, View seen_rows, View seen_columns,
                                 View past, View features) {
    const int height = seen_rows.size[0], width = seen_columns.size[0];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int row = int(seen_rows.at[y]), column = int(seen_columns.at[x]);
    const int w = part.w, v = part.top + row, u = part.left + column;
    const size_t pixel = size_t(v) * w + u, seen = size_t(y) * width + x;
    // Everything is read before the first write, so that the reads wait together.
    const float exposure = params.at[EXPOSURE], gain = params.at[GAIN],
                used = share_of(keep, row, column);
    const float jitter_x = params.at[JITTER_X], jitter_y = params.at[JITTER_Y],
                scale = depth_scale.at[0];
    const Colour now = three(colour, pixel), direction = three(normal, pixel);
    const Colour diffuse = three(diffuse_albedo, pixel), specular = three(specular_albedo, pixel);
    const float rough = roughness.at[pixel], z = clamped(depth.at[pixel], 0.0f, MAX_DEPTH);
    const Pair motion = pair(moved, size_t(row) * moved.size[1] + column);
    const Recalled memory = recall(state, last_depth, float(u) + motion.x, float(v) + motion.y,
                                   used);
    const Colour mean = touched_mean(warped, v, u, part);
    const Colour factor = demodulation(diffuse_albedo, specular_albedo, v, u);
    const Colour share = {1.0f / factor.r, 1.0f / factor.g, 1.0f / factor.b};
    const Colour kept = Colour{memory.mean.x, memory.mean.y, memory.mean.z} * gain;

    float to[FEATURES];
    put(to, {encoded_now(now.r, exposure, share.r), encoded_now(now.g, exposure, share.g),
             encoded_now(now.b, exposure, share.b)});
    put(to + 3, {log_encode(kept.r * memory.valid), log_encode(kept.g * memory.valid),
                 log_encode(kept.b * memory.valid)});
    put(to + 6, {encoded_last(mean.r, memory.valid * share.r),
                 encoded_last(mean.g, memory.valid * share.g),
                 encoded_last(mean.b, memory.valid * share.b)});
    put_bounded(to + 9, diffuse, 0.0f, MOST_REFLECTANCE);
    put_bounded(to + 12, specular, 0.0f, MOST_REFLECTANCE);
    put_bounded(to + 15, direction, -1.0f, 1.0f);
    to[18] = clamped(rough, 0.0f, 1.0f);
    to[19] = scale / (scale + z);
    to[20] = depth_change(memory.depth, z) * memory.valid;
    to[21] = memory.valid;
    to[22] = fmaxf(memory.mean.w, 0.0f) / MAX_COUNT;
    to[23] = jitter_x;
    to[24] = jitter_y;
    to[25] = log1pf(sqrtf(motion.x * motion.x + motion.y * motion.y)) * 0.25f;
    to[26] = float(w) / float(part.width);
    put_four(to + 27, memory.first);
    put_four(to + 31, memory.second);
    if (sizeof(Number) == sizeof(Half)) keep_together(to, features, seen);
    else keep_planes(to, features, seen, size_t(height) * width);
    if (y < past.size[0] && x < past.size[1])
        four(past, size_t(y) * past.size[1] + x) = {kept.r, kept.g, kept.b, memory.mean.w};
}

// Planes of what mirrors and glass show: denoising_albedo and denoising_normal (h, w, 3), window
// (8,), seen_rows (hp,), seen_columns (wp,) -> mirrored (1, 6, hp, wp).
extern "C" __global__ void denoise_mirrored(View denoising_albedo, View denoising_normal,
                                            View window, View seen_rows, View seen_columns,
                                            View mirrored) {
    const int height = seen_rows.size[0], width = seen_columns.size[0];
    PIXEL(width, height);
    const Window part = window_of(window);
    const size_t pixel = size_t(part.top + int(seen_rows.at[y])) * part.w + part.left
                         + int(seen_columns.at[x]);
    const Colour albedo = three(denoising_albedo, pixel), normal = three(denoising_normal, pixel);
    const size_t plane = size_t(height) * width;
    float* const to = mirrored.at + size_t(y) * width + x;
    put_bounded(to, albedo, 0.0f, 1.0f, plane);
    put_bounded(to + 3 * plane, normal, -1.0f, 1.0f, plane);
}

// The nearest guide pixel at each corner of a render pixel, as the network sees these:
// guide_diffuse_albedo, guide_specular_albedo and guide_normal (height, width, 3), guide_roughness
// and guide_depth (height, width, 1), depth_scale (1,), window (8,), seen_rows (hp,), seen_columns
// (wp,) -> guides (1, 44, hp, wp), 11 channels a corner.
extern "C" __global__ void denoise_guides(View guide_diffuse_albedo, View guide_specular_albedo,
                                          View guide_normal, View guide_roughness, View guide_depth,
                                          View depth_scale, View window, View seen_rows,
                                          View seen_columns, View guides) {
    const int height = guides.size[2], width = guides.size[3];
    PIXEL(width, height);
    const Window part = window_of(window);
    const unsigned h = part.h, w = part.w, out_height = part.height, out_width = part.width;
    // In quarters of a render pixel.
    const unsigned row = 4 * (part.top + int(seen_rows.at[y])) + 1;
    const unsigned column = 4 * (part.left + int(seen_columns.at[x])) + 1;
    const size_t plane = size_t(height) * width;
    const float scale = depth_scale.at[0];
    float* to = guides.at + size_t(y) * width + x;
    UNROLL for (int corner = 0; corner < 4; corner++, to += 11 * plane) {
        const unsigned v = (row + 2 * (corner / 2)) * out_height / (4 * h);
        const unsigned u = (column + 2 * (corner % 2)) * out_width / (4 * w);
        const size_t pixel = size_t(v) * out_width + u;
        const Colour diffuse = three(guide_diffuse_albedo, pixel);
        const Colour specular = three(guide_specular_albedo, pixel);
        const Colour normal = three(guide_normal, pixel);
        const float rough = guide_roughness.at[pixel], z = guide_depth.at[pixel];
        put_bounded(to, diffuse, 0.0f, 2.0f, plane);
        put_bounded(to + 3 * plane, specular, 0.0f, 2.0f, plane);
        put_bounded(to + 6 * plane, normal, -1.0f, 1.0f, plane);
        to[9 * plane] = clamped(rough, 0.0f, 1.0f);
        to[10 * plane] = scale / (scale + clamped(z, 0.0f, MAX_DEPTH));
    }
}

// How far the guides' reflectance is trusted, in cells of 8x8 render pixels: less, the more of its
// detail is apart from the reflectance of the render size. diffuse_albedo and specular_albedo (h,
// w, 3), guide_diffuse_albedo and guide_specular_albedo (height, width, 3), window (8,), part_rows
// (th,), part_columns (tw,) -> trust (cells, cells, 1).

extern "C" __global__ void denoise_trust(View diffuse_albedo, View specular_albedo,
                                         View guide_diffuse_albedo, View guide_specular_albedo,
                                         View window, View part_rows, View part_columns,
                                         View trust) {
    const int height = trust.size[0], width = trust.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int bottom = min(min(TRUST_CELL * (y + 1), part_rows.size[0]), part.h - part.top);
    const int right = min(min(TRUST_CELL * (x + 1), part_columns.size[0]), part.w - part.left);
    float apart = 0.0f, spread = 0.0f;
    int count = 0;
    for (int i = TRUST_CELL * y; i < bottom; i++) {
        const int row = int(part_rows.at[i]);
        const int first = int(1LL * row * part.height / part.h);
        const int end = int((1LL * (row + 1) * part.height + part.h - 1) / part.h);
        for (int j = TRUST_CELL * x; j < right; j++, count++) {
            const int column = int(part_columns.at[j]);
            const int start = int(1LL * column * part.width / part.w);
            const int stop = int((1LL * (column + 1) * part.width + part.w - 1) / part.w);
            const Colour own = demodulation(diffuse_albedo, specular_albedo, row, column);
            Colour mean = {0.0f, 0.0f, 0.0f};
            float square = 0.0f;
            for (int v = first; v < end; v++)
                for (int u = start; u < stop; u++) {
                    const Colour guide = demodulation(guide_diffuse_albedo, guide_specular_albedo,
                                                      v, u);
                    const float r = guide.r / own.r - 1.0f, g = guide.g / own.g - 1.0f,
                                b = guide.b / own.b - 1.0f;
                    mean = {mean.r + r, mean.g + g, mean.b + b};
                    square += r * r + g * g + b * b;
                }
            const float share = 1.0f / ((end - first) * (stop - start));
            apart += (mean.r * mean.r + mean.g * mean.g + mean.b * mean.b) * (share * share);
            spread += square * share;
        }
    }
    trust.at[y * width + x] = count ? 1.0f - DOUBT * apart / (spread + 3.0f * FAINT * count) : 1.0f;
}

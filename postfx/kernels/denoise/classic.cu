// The classical filter: postfx/kernels/denoise/classic.py says what each kernel reads and writes.

// What a pixel that is known was in the frame before; luminance in its first two hidden channels.
__device__ inline bool is_known(const Recalled& past, float depth) {
    const bool near = fabsf(past.depth - depth) <= STEP * depth;
    return past.valid > 0.0f && (near || (past.depth >= MAX_DEPTH && depth >= MAX_DEPTH));
}

__device__ inline float luminance(const Colour& light) {
    return 0.2126f * light.r + 0.7152f * light.g + 0.0722f * light.b;
}

// 1 / depth of a pixel of the frame, edges repeated; 0 where there is nothing.
__device__ inline float nearness_at(const View& depth, int y, int x) {
    const int h = depth.size[0], w = depth.size[1];
    const float z = depth.at[size_t(within(y, h)) * w + within(x, w)];
    return z > 0.0f && z < MAX_DEPTH ? 1.0f / z : 0.0f;
}

// The smaller step to a neighbour: the larger one may cross an edge.
__device__ inline float slope(float before, float here, float after) {
    const float left = here - before, right = after - here;
    return fabsf(left) < fabsf(right) ? left : right;
}

// Six planes of a pixel's surface, `plane` numbers apart.
__device__ inline void put_surface(float* to, size_t plane, const float* normal, const View& depth,
                                   int y, int x) {
    const float here = nearness_at(depth, y, x);
#pragma unroll
    for (int c = 0; c < 3; c++) to[c * plane] = clamped(normal[c], -1.0f, 1.0f);
    to[3 * plane] = here;
    to[4 * plane] = slope(nearness_at(depth, y, x - 1), here, nearness_at(depth, y, x + 1));
    to[5 * plane] = slope(nearness_at(depth, y - 1, x), here, nearness_at(depth, y + 1, x));
}

// Mean colour, the variance of its luminance, and what the next frame knows: colour, count, and two
// moments.
struct Gathered {
    Colour light;
    float variance, count, mean, square;
};

__device__ inline Gathered gathered(const Colour& own, const Recalled& past, float depth,
                                    float gain) {
    const float count = is_known(past, depth) ? fmaxf(past.mean.w, 0.0f) : 0.0f;
    const float alpha = fmaxf(1.0f / (count + 1.0f), LEAST_SHARE),
                counted = fminf(1.0f / alpha, MAX_COUNT);
    const float now = luminance(own), scale = gain / fmaxf(past.valid, 1e-3f);
    const float before = past.first.x * scale, squared = past.first.y * scale * gain;
    const float mean = squared > 0.0f ? before + (now - before) * alpha : now;
    const float square = squared > 0.0f ? squared + (now * now - squared) * alpha : now * now;
    const float r = past.mean.x * gain, g = past.mean.y * gain, b = past.mean.z * gain;
    return {{r + (own.r - r) * alpha, g + (own.g - g) * alpha, b + (own.b - b) * alpha},
            fmaxf(square - mean * mean * (1.0f - 1.0f / counted), 0.0f) / counted,
            counted,
            mean,
            square};
}

extern "C" __global__ void denoise_classic_gather(View colour, View diffuse_albedo,
                                                  View specular_albedo, View normal, View depth,
                                                  View moved, View state, View last_depth,
                                                  View params, View window, View keep,
                                                  View next_state, View next_depth, View light,
                                                  View surface, View factor) {
    const int th = light.size[1], tw = light.size[2], h = colour.size[0], w = colour.size[1];
    PIXEL(tw, th);
    const Window part = window_of(window);
    const size_t plane = size_t(th) * tw, here = size_t(y) * tw + x;
    const Four none = {0.0f, 0.0f, 0.0f, 0.0f};
    const int v = part.top + y, u = part.left + x;
    if (v >= h || u >= w) {
        for (int c = 0; c < 4; c++) light.at[c * plane + here] = 0.0f;
        for (int c = 0; c < 6; c++) surface.at[c * plane + here] = 0.0f;
        for (int c = 0; c < 3; c++) {
            factor.at[3 * here + c] = 0.0f;
            four(next_state, 3 * here + c) = none;
        }
        next_depth.at[here] = 0.0f;
        return;
    }
    const size_t source = size_t(v) * w + u;
    const float z = depth.at[source];
    const Pair motion = pair(moved, here);
    const Recalled past = recall(state, last_depth, u + motion.x, v + motion.y,
                                 share_of(keep, y, x));
    const Colour by = demodulation(diffuse_albedo, specular_albedo, v, u);
    const Colour own = light_without(colour.at + 3 * source, by, params.at[EXPOSURE]);
    const Gathered now = gathered(own, past, z, params.at[GAIN]);
    const float total = fabsf(now.light.r) + fabsf(now.light.g) + fabsf(now.light.b);
    const bool edge = (y == 0 && v > 0) || (x == 0 && u > 0) || (y == th - 1 && v + 1 < h)
                      || (x == tw - 1 && u + 1 < w);
    const bool held = total + now.mean <= MOST_STATE && now.square <= MAX_LIGHT && !edge;
    four(next_state, 3 * here) = held ? Four{now.light.r, now.light.g, now.light.b, now.count}
                                      : none;
    four(next_state,
         3 * here + 1) = held ? Four{now.mean, fminf(now.square, MOST_STATE), 0.0f, 0.0f} : none;
    four(next_state, 3 * here + 2) = none;
    next_depth.at[here] = z;
    factor.at[3 * here] = by.r;
    factor.at[3 * here + 1] = by.g;
    factor.at[3 * here + 2] = by.b;
    const bool whole = total <= MOST_STATE;  // light that is broken leaves nothing
    light.at[here] = whole ? now.light.r : 0.0f;
    light.at[plane + here] = whole ? now.light.g : 0.0f;
    light.at[2 * plane + here] = whole ? now.light.b : 0.0f;
    light.at[3 * plane + here] = whole ? now.variance : 0.0f;
    put_surface(surface.at + here, plane, normal.at + 3 * source, depth, v, u);
}

// Light and surface of a pixel, from its first numbers.
struct Tap {
    Colour light;
    float variance, normal[3], near;
};

__device__ inline Tap tap_at(const View& light, const View& surface, size_t at) {
    const size_t plane = size_t(light.size[1]) * light.size[2];
    const float *const from = light.at + at, *const on = surface.at + at;
    return {{from[0], from[plane], from[2 * plane]},
            from[3 * plane],
            {on[0], on[plane], on[2 * plane]},
            on[3 * plane]};
}

// What edges leave of a tap: normals by their cosine to the 32nd power, where there are some, depth
// by a plane, and luminance by 1 / its standard deviation.
__device__ inline float likeness(const Tap& own, const Tap& other, float way, float spread) {
    float a = 0.0f, b = 0.0f;
#pragma unroll
    for (int c = 0; c < 3; c++) {
        a += own.normal[c] * other.normal[c];
        b += own.normal[c] * own.normal[c];
    }
    a = b > 0.5f ? fmaxf(a, 0.0f) : 1.0f;
#pragma unroll
    for (int i = 0; i < 5; i++) a *= a;
    const float apart = fabsf(other.near - own.near - way);
    const float off = apart / (FLAT * own.near + SLANT * fabsf(way) + 1e-12f)
                    + fabsf(luminance(other.light) - luminance(own.light)) * spread;
    return a * expf(fmaxf(-off, -60.0f));
}

// 1 / (4 standard deviations of luminance), from the variance of 3x3 pixels of the picture.
__device__ inline float sharpness_at(const View& light, int y, int x, int h, int w) {
    const int width = light.size[2];
    const float* const variance = light.at + 3 * size_t(light.size[1]) * width;
    float sum = 0.0f;
#pragma unroll
    for (int j = -1; j <= 1; j++) {
        const float* const row = variance + size_t(within(y + j, h)) * width;
        const float across = 0.25f * (row[within(x - 1, w)] + row[within(x + 1, w)])
                             + 0.5f * row[x];
        sum += (j ? 0.25f : 0.5f) * across;
    }
    return 1.0f / (LUMINANCE * sqrtf(sum) + 1e-4f);
}

extern "C" __global__ void denoise_atrous(View light, View surface, View step, View window,
                                          View smooth) {
    const int height = light.size[1], width = light.size[2];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int h = min(height, part.h - part.top), w = min(width, part.w - part.left),
              reach = int(step.at[0]);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    float* const to = smooth.at + here;
    if (y >= h || x >= w) {
        for (int c = 0; c < 4; c++) to[c * plane] = 0.0f;
        return;
    }
    const Tap own = tap_at(light, surface, here);
    const float across = surface.at[4 * plane + here], down = surface.at[5 * plane + here];
    const float sharp = sharpness_at(light, y, x, h, w);
    Colour sum = {0.25f * own.light.r, 0.25f * own.light.g, 0.25f * own.light.b};
    float variance = 0.0625f * own.variance, total = 0.25f;
#pragma unroll
    for (int j = -1; j <= 1; j++) {
        const int v = y + j * reach;
        if (v < 0 || v >= h) continue;
#pragma unroll
        for (int i = -1; i <= 1; i++) {
            const int u = x + i * reach;
            if (u < 0 || u >= w || (i == 0 && j == 0)) continue;
            const Tap other = tap_at(light, surface, size_t(v) * width + u);
            const float way = across * float(i * reach) + down * float(j * reach);
            const float weight = (i && j ? 0.0625f : 0.125f) * likeness(own, other, way, sharp);
            total += weight;
            add(sum, other.light, weight);
            variance += weight * weight * other.variance;
        }
    }
    const float share = 1.0f / total;
    to[0] = sum.r * share;
    to[plane] = sum.g * share;
    to[2 * plane] = sum.b * share;
    to[3 * plane] = variance * share * share;
}

// A pixel of the output from the nine around it, each with its reflectance.
extern "C" __global__ void denoise_resolve(View light, View factor, View params, View window,
                                           View output, View next_history) {
    PIXEL(output.size[1], output.size[0]);
    const Window part = window_of(window);
    const int width = light.size[2], h = min(light.size[1], part.h - part.top),
              w = min(width, part.w - part.left);
    const size_t plane = size_t(light.size[1]) * width;
    float right, lower;
    const int row = within(
        centre(min(part.out_top + y, part.height - 1), part.h, part.height, lower) - part.top, h);
    const int column = within(
        centre(min(part.out_left + x, part.width - 1), part.w, part.width, right) - part.left, w);
    lower = params.at[JITTER_Y] - lower;
    right = params.at[JITTER_X] - right;
    const float narrow[3] = {gauss(right - 1.0f), gauss(right), gauss(right + 1.0f)};
    const float high[3] = {gauss(lower - 1.0f), gauss(lower), gauss(lower + 1.0f)};
    const float total = (TINY + narrow[0] + narrow[1] + narrow[2])
                        * (TINY + high[0] + high[1] + high[2]);
    Colour sum = {0.0f, 0.0f, 0.0f};
#pragma unroll
    for (int j = 0; j < 3; j++) {
        const size_t line = size_t(within(row + j - 1, h)) * width;
#pragma unroll
        for (int i = 0; i < 3; i++) {
            const size_t at = line + within(column + i - 1, w);
            const float* const by = factor.at + 3 * at;
            const Colour own = {light.at[at] * by[0], light.at[plane + at] * by[1],
                                light.at[2 * plane + at] * by[2]};
            add(sum, own, high[j] * narrow[i] / total);
        }
    }
    const float darken = 1.0f / params.at[EXPOSURE],
                logs[3] = {log_encode(sum.r), log_encode(sum.g), log_encode(sum.b)};
    const size_t to = 3 * (size_t(y) * output.size[1] + x);
#pragma unroll
    for (int c = 0; c < 3; c++) {
        next_history.at[to + c] = logs[c];
        output.at[to + c] = expm1_of(logs[c]) * darken;
    }
}

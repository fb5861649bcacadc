// The classical filter: postfx/kernels/denoise/classic.py says what each kernel reads and writes.

#include "classic.h"

// 1 / depth of a pixel of the frame, edges repeated.
FN float nearness_at(const View& depth, int y, int x) {
    const int h = depth.size[0], w = depth.size[1];
    return nearness_of<float>(depth.at[size_t(clip(y, h)) * w + clip(x, w)]);
}

// Six planes of a pixel's surface, `plane` numbers apart.
FN void put_surface(float* to, size_t plane, const float* normal, const View& depth, int y, int x) {
    const float here = nearness_at(depth, y, x);
    UNROLL for (int c = 0; c < 3; c++) to[c * plane] = clamped(normal[c], -1.0f, 1.0f);
    to[3 * plane] = here;
    to[4 * plane] = slope<float>(nearness_at(depth, y, x - 1), here, nearness_at(depth, y, x + 1));
    to[5 * plane] = slope<float>(nearness_at(depth, y - 1, x), here, nearness_at(depth, y + 1, x));
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
    const float gain = params.at[GAIN];
    const Past<float> before = {{past.mean.x * gain, past.mean.y * gain, past.mean.z * gain},
                                past.mean.w, past.first.x, past.first.y, past.valid, past.depth};
    const Gathered<float> now = gathered<float>(
        light_without(colour.at + 3 * source, by, params.at[EXPOSURE]), before, z, gain);
    const bool edge = (y == 0 && v > 0) || (x == 0 && u > 0) || (y == th - 1 && v + 1 < h)
                      || (x == tw - 1 && u + 1 < w);
    UNROLL for (int c = 0; c < 3; c++) {
        const float* const state = now.state + 4 * c;
        four(next_state, 3 * here + c) = edge ? none : Four{state[0], state[1], state[2], state[3]};
    }
    next_depth.at[here] = z;
    put(factor.at + 3 * here, by);
    UNROLL for (int c = 0; c < 4; c++) light.at[c * plane + here] = now.light[c];
    put_surface(surface.at + here, plane, normal.at + 3 * source, depth, v, u);
}

// Light and surface of a pixel, from its first numbers.
struct Tap {
    Colour light;
    float variance;
    Surface<float> surface;
};

FN Tap tap_at(const View& light, const View& surface, size_t at) {
    const size_t plane = size_t(light.size[1]) * light.size[2];
    const float *const from = light.at + at, *const on = surface.at + at;
    const float r = from[0], g = from[plane], b = from[2 * plane];
    return {{r, g, b},
            from[3 * plane],
            {{on[0], on[plane], on[2 * plane]}, on[3 * plane], luminance<float>(r, g, b)}};
}

// 1 / (4 standard deviations of luminance), from the variance of 3x3 pixels of the picture.
FN float sharpness_at(const View& light, int y, int x, int h, int w) {
    const int width = light.size[2];
    const float* const variance = light.at + 3 * size_t(light.size[1]) * width;
    float sum = 0.0f;
    UNROLL for (int j = -1; j <= 1; j++) {
        const float* const row = variance + size_t(clip(y + j, h)) * width;
        const float across = 0.25f * (row[clip(x - 1, w)] + row[clip(x + 1, w)]) + 0.5f * row[x];
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
    Colour sum = own.light * 0.25f;
    float variance = 0.0625f * own.variance, total = 0.25f;
    UNROLL for (int j = -1; j <= 1; j++) {
        const int v = y + j * reach;
        if (v < 0 || v >= h) continue;
        UNROLL for (int i = -1; i <= 1; i++) {
            const int u = x + i * reach;
            if (u < 0 || u >= w || (i == 0 && j == 0)) continue;
            const Tap other = tap_at(light, surface, size_t(v) * width + u);
            const float way = across * float(i * reach) + down * float(j * reach);
            const float weight = (i && j ? 0.0625f : 0.125f)
                                 * likeness<float>(own.surface, other.surface, way, sharp);
            total += weight;
            add(sum, other.light, weight);
            variance += weight * weight * other.variance;
        }
    }
    const float share = 1.0f / total;
    put(to, sum * share, plane);
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
    const int row = clip(
        centre(min(part.out_top + y, part.height - 1), part.h, part.height, lower) - part.top, h);
    const int column = clip(
        centre(min(part.out_left + x, part.width - 1), part.w, part.width, right) - part.left, w);
    lower = params.at[JITTER_Y] - lower;
    right = params.at[JITTER_X] - right;
    const float narrow[3] = {gauss(right - 1.0f), gauss(right), gauss(right + 1.0f)};
    const float high[3] = {gauss(lower - 1.0f), gauss(lower), gauss(lower + 1.0f)};
    const float total = (TINY + narrow[0] + narrow[1] + narrow[2])
                        * (TINY + high[0] + high[1] + high[2]);
    Colour sum = {0.0f, 0.0f, 0.0f};
    UNROLL for (int j = 0; j < 3; j++) {
        const size_t line = size_t(clip(row + j - 1, h)) * width;
        UNROLL for (int i = 0; i < 3; i++) {
            const size_t at = line + clip(column + i - 1, w);
            const Colour own = three(light.at + at, plane) * three(factor.at + 3 * at);
            add(sum, own, high[j] * narrow[i] / total);
        }
    }
    const float darken = 1.0f / params.at[EXPOSURE],
                logs[3] = {log_encode(sum.r), log_encode(sum.g), log_encode(sum.b)};
    const size_t to = 3 * (size_t(y) * output.size[1] + x);
    UNROLL for (int c = 0; c < 3; c++) {
        next_history.at[to + c] = logs[c];
        output.at[to + c] = expm1_of(logs[c]) * darken;
    }
}

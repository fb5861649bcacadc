#include "parts.h"

// Reflectance of a part that has another one than the picture: diffuse_albedo and specular_albedo
// (h, w, 3), part_rows (th,), part_columns (tw,) -> factor (th, tw, 3).
extern "C" __global__ void denoise_reflectance(View diffuse_albedo, View specular_albedo,
                                               View part_rows, View part_columns, View factor) {
    const int width = factor.size[1];
    PIXEL(width, factor.size[0]);
    const Colour found = demodulation(diffuse_albedo, specular_albedo, int(part_rows.at[y]),
                                      int(part_columns.at[x]));
    float* const to = factor.at + 3 * (size_t(y) * width + x);
    put(to, found);
}

// Running mean of a part of the picture by the picture's weights: part (h, w, 3), coding (3,),
// factor (th, tw, 3), past (th, tw, 4), moved (th, tw, 2), last_part (h, w, 3), fine (1, 80, hp,
// wp), window (8,) -> next_part (th, tw, 3), part_level (3, hp, wp).
FN float recalled(const float* last, const size_t (&from)[4], int c, float tx, float ty) {
    const float top = last[from[0] + c] + (last[from[1] + c] - last[from[0] + c]) * tx;
    const float bottom = last[from[2] + c] + (last[from[3] + c] - last[from[2] + c]) * tx;
    return top + (bottom - top) * ty;
}

template <class Number>
__global__ void denoise_accumulate_part(View part, View coding, View factor, View past, View moved,
                                        View last_part, View fine, View window, View next_part,
                                        View part_level) {
    const int height = part_level.size[1], width = part_level.size[2];
    PIXEL(width, height);
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
    float* const to = part_level.at + here;
    const Window place = window_of(window);
    const int h = part.size[0], w = part.size[1];
    const int v = place.top + y, u = place.left + x;
    const bool kept = y < past.size[0] && x < past.size[1];
    const size_t pixel = size_t(y) * past.size[1] + x;
    if (!kept || v >= h || u >= w) {
        for (int c = 0; c < 3; c++) to[c * plane] = 0.0f;
        for (int c = 0; c < 3 && kept; c++) next_part.at[3 * pixel + c] = 0.0f;
        return;
    }
    const float* const divisor = factor.at + 3 * pixel;
    const Coding& by = *reinterpret_cast<const Coding*>(coding.at);
    const float count = past.at[4 * pixel + 3];
    const float share = newer_share<float>(
        count, as_float(numbers<Number>(fine)[DISTRUST * plane + here]));
    const bool held = count > 0.0f;
    const float px = held ? fminf(fmaxf(u + moved.at[2 * pixel], 0.0f), float(w - 1)) : 0.0f;
    const float py = held ? fminf(fmaxf(v + moved.at[2 * pixel + 1], 0.0f), float(h - 1)) : 0.0f;
    const int left = int(px), upper = int(py), right = min(left + 1, w - 1),
              lower = min(upper + 1, h - 1);
    const size_t from[4] = {3 * (size_t(upper) * w + left), 3 * (size_t(upper) * w + right),
                            3 * (size_t(lower) * w + left), 3 * (size_t(lower) * w + right)};
    const float* const values = part.at + 3 * (size_t(v) * w + u);
    for (int c = 0; c < 3; c++) {
        const float now = coded<float>(values[c], divisor[c], by);
        const float before = held ? recalled(last_part.at, from, c, px - left, py - upper) : now;
        const float mean = accumulated<float>(now, before, share);
        to[c * plane] = mean;
        next_part.at[3 * pixel + c] = mean;
    }
}

// Parts as parts of the picture: parts (n, H, W, 3), reached (n, h, w) or (n, 1, 1), whole and
// picture (H, W, 3), complete (1,) -> balanced (n, H, W, 3).
extern "C" __global__ void denoise_balance(View parts, View reached, View whole, View picture,
                                           View complete, View balanced) {
    const int count = parts.size[0], height = parts.size[1], width = parts.size[2];
    PIXEL(width, height);
    const size_t stride = 3 * size_t(height) * width, pixel = 3 * (size_t(y) * width + x);
    const bool alone = complete.at[0] > 0.0f, beyond = complete.at[0] < 0.0f;
    const int h = reached.size[1], w = reached.size[2];
    const float* const cover = reached.at + size_t(y) * h / height * w + size_t(x) * w / width;
    for (int c = 0; c < 3; c++) {
        float total = 0.0f;
        for (int k = 0; k < count; k++)
            total += parts.at[k * stride + pixel + c] * cover[size_t(k) * h * w];
        const float dark = alone ? fmaxf(DARKEST - total, 0.0f) : 0.0f;
        const float light = alone ? total + count * dark
                                  : fmaxf(fmaxf(total, whole.at[pixel + c]), DARKEST);
        const float ratio = beyond ? 1.0f : picture.at[pixel + c] / light;
        for (int k = 0; k < count; k++) {
            const size_t at = k * stride + pixel + c;
            balanced.at[at] = (parts.at[at] * cover[size_t(k) * h * w] + dark) * ratio;
        }
    }
}

// A plane from what was filtered: filtered (H, W, 3), decoding (5,): factor, shift, bounds, kind:
// vectors that get length 1 above 0, distances below 0, by their reciprocal and coverage -> plane
// (H, W, c).
FN void decode(const View& filtered, const View& decoding, const View& plane, int y, int x) {
    const int channels = plane.size[2];
    const size_t pixel = size_t(y) * plane.size[1] + x;
    const Decoding& by = *reinterpret_cast<const Decoding*>(decoding.at);
    const float* const from = filtered.at + 3 * pixel;
    float* const to = plane.at + channels * pixel;
    if (by.kind < 0.0f) {
        for (int c = 0; c < channels; c++) to[c] = distance_of<float>(from[0], from[1], by);
        return;
    }
    float square = 0.0f;
    for (int c = 0; c < channels; c++) {
        to[c] = decoded<float>(from[c], by);
        square += to[c] * to[c];
    }
    if (by.kind <= 0.0f) return;
    const float scale = scale_to_one<float>(square);
    for (int c = 0; c < channels; c++) to[c] *= scale;
}

extern "C" __global__ void denoise_decode(View filtered, View decoding, View plane) {
    PIXEL(plane.size[1], plane.size[0]);
    decode(filtered, decoding, plane, y, x);
}

// The same for planes of one channel, of which three were filtered.
extern "C" __global__ void denoise_decode_one(View filtered, View decoding, View plane) {
    PIXEL(plane.size[1], plane.size[0]);
    decode(filtered, decoding, plane, y, x);
}

#include "reflections.h"

// What a frame leaves, at another render size: state (h, w, 12), last_depth (h, w, 1), at_rows
// (height,), at_columns (width,) -> resized (height, width, 12), resized_depth (height, width, 1).
// Bilinear between pixels that hold something, depth of the nearest.

// Four channels, weighted.
FN Four weighted_four(const View& state, const size_t (&from)[4], const float (&share)[4],
                      int group, float scale) {
    Four sum = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int i = 0; i < 4; i++) add(sum, four(state, 3 * from[i] + group), share[i]);
    return sum * scale;
}

extern "C" __global__ void denoise_resize(View state, View last_depth, View at_rows,
                                          View at_columns, View resized, View resized_depth) {
    PIXEL(resized.size[1], resized.size[0]);
    const int h = state.size[0], w = state.size[1];
    const float row = at_rows.at[y], column = at_columns.at[x], ty = row - floorf(row),
                tx = column - floorf(column);
    const int top = int(floorf(row)), first = int(floorf(column));
    const size_t upper = size_t(clip(top, h)) * w, lower = size_t(clip(top + 1, h)) * w;
    const int left = clip(first, w), right = clip(first + 1, w);
    const size_t from[4] = {upper + left, upper + right, lower + left, lower + right};
    float share[4] = {(1.0f - ty) * (1.0f - tx), (1.0f - ty) * tx, ty * (1.0f - tx), ty * tx},
          total = 0.0f;
    for (int i = 0; i < 4; i++) {
        if (!(four(state, 3 * from[i]).w > 0.0f)) share[i] = 0.0f;
        total += share[i];
    }
    const float scale = total > 0.5f ? 1.0f / total : 0.0f;
    const size_t pixel = size_t(y) * resized.size[1] + x;
    const float depth =
        last_depth.at[size_t(clip(int(rintf(row)), h)) * w + clip(int(rintf(column)), w)];
    const Four mean = weighted_four(state, from, share, 0, scale);
    const Four one = weighted_four(state, from, share, 1, scale);
    const Four other = weighted_four(state, from, share, 2, scale);
    resized_depth.at[pixel] = depth;
    four(resized, 3 * pixel) = mean;
    four(resized, 3 * pixel + 1) = one;
    four(resized, 3 * pixel + 2) = other;
}

// The last output where its pixels are now, bicubic, edge repeated, rescaled where the exposure
// changed: history (height, width, 3), moved (th, tw, 2), params (4,), window (8,), out_rows
// (out_th,), out_columns (out_tw,) -> warped (out_th, out_tw, 3), log(1 + exposed).

// Log-encoded colour, not below 0, after an exposure change; NaN stays NaN.
FN float rescaled(float encoded, float gain) {
    const float held = encoded < 0.0f ? 0.0f : encoded;
    return gain == 1.0f ? held : log1pf(expm1f(held) * gain);
}

// A thread makes 2x2 pixels, which move alike where they have a render pixel in common. Most of a
// block's were about as far away as its middle one: those that were so up to SLACK pixels find what
// they read in shared memory, the others read the history.
const int SLACK = 2, BEFORE_WIDE = 2 * ACROSS + 3 + 2 * SLACK,
          BEFORE_HIGH = 2 * DOWN + 3 + 2 * SLACK;

extern "C" __global__ void __launch_bounds__(256, 4)
    denoise_history(View history, View moved, View params, View window, View out_rows,
                    View out_columns, View warped) {
    __shared__ float tile[BEFORE_HIGH][3 * BEFORE_WIDE];
    __shared__ Pair staged[DOWN][3 * ACROSS];
    const Window part = window_of(window);
    const int rows = warped.size[0], columns = warped.size[1];
    const int first_y = 2 * DOWN * blockIdx.y, first_x = 2 * ACROSS * blockIdx.x;
    const auto before_at = [&](int y, int x) {
        return before_of(min(part.out_top + y, part.height - 1),
                         min(part.out_left + x, part.width - 1), part, moved);
    };
    const int y = first_y + 2 * threadIdx.y,
              x = min(first_x + 2 * int(threadIdx.x), (columns - 1) / 2 * 2);
    const int down_by = min(DOWN, rows - 1 - first_y),
              right_by = min(ACROSS, columns - 1 - first_x);
    const Before middle = before_at(first_y + down_by, first_x + right_by), own = before_at(y, x);
    const int top = middle.top - down_by - SLACK, left = middle.left - right_by - SLACK;
    const bool whole = left >= 0 && left + BEFORE_WIDE <= part.width;
    UNROLL for (int j = 0; j < BEFORE_HIGH; j += DOWN) {
        const int row = j + threadIdx.y;
        if (row >= BEFORE_HIGH) break;
        const float* const line = history.at
                                  + size_t(3) * clip(top + row, part.height) * part.width;
        if (whole) {
            UNROLL for (int i = 0; i < 3 * BEFORE_WIDE; i += ACROSS)
                if (i + threadIdx.x < 3 * BEFORE_WIDE)
                    tile[row][i + threadIdx.x] = line[3 * left + i + threadIdx.x];
        } else {
            AS_IT_IS for (int i = threadIdx.x; i < 3 * BEFORE_WIDE; i += ACROSS)
                tile[row][i] = line[3 * clip(left + i / 3, part.width) + i % 3];
        }
    }
    __syncthreads();
    if (y >= rows) return;
    const int row = own.top - top, column = own.left - left;
    const bool held = row >= 0 && row + 5 <= BEFORE_HIGH && column >= 0
                      && column + 5 <= BEFORE_WIDE;
    Colour found[4] = {};
    if (held && is_doubled(part)) {
        const int places[4] = {0, 3, 6, 9};
        const Four across = cubic_weights(own.right - floorf(own.right));
        const Four down = cubic_weights(own.down - floorf(own.down));
        const float weights[4] = {down.x, down.y, down.z, down.w};
        UNROLL for (int j = 0; j < 5; j++) {
            const float* const from = tile[row + j] + 3 * column;
            const Colour one = row_of(from, places, across), two = row_of(from + 3, places, across);
            if (j < 4) add(found[0], one, weights[j]), add(found[1], two, weights[j]);
            if (j > 0) add(found[2], one, weights[j - 1]), add(found[3], two, weights[j - 1]);
        }
    } else {
        UNROLL for (int k = 0; k < 4; k++) {
            const Before one = before_at(y + k / 2, x + k % 2);
            const int j = one.top - top, i = one.left - left;
            const bool inside = j >= 0 && j + 4 <= BEFORE_HIGH && i >= 0 && i + 4 <= BEFORE_WIDE;
            found[k] = moved_picture(
                inside ? tile[0] : history.at,
                inside ? Size{BEFORE_HIGH, BEFORE_WIDE} : Size{part.height, part.width},
                {one.right, one.down, inside ? j : one.top, inside ? i : one.left});
        }
    }
    const float gain = params.at[GAIN];
    UNROLL for (int k = 0; k < 2; k++) {
        if (y + k == rows) break;
        const Colour &one = found[2 * k], &two = found[2 * k + 1];
        const float light[6] = {rescaled(one.r, gain), rescaled(one.g, gain),
                                rescaled(one.b, gain), rescaled(two.r, gain),
                                rescaled(two.g, gain), rescaled(two.b, gain)};
        put_pixels(staged[threadIdx.y], light, warped, y + k, x, first_x);
    }
}

// Motion, of smooth surfaces that of what they reflect: motion (h, w, 2), depth (h, w, 1), normal
// (h, w, 3), roughness (h, w, 1), diffuse_albedo and specular_albedo (h, w, 3), hit_distance (h, w,
// 1), camera (27,) -> reflected (h, w, 2). Sources are given in postfx/kernels/denoise/history.py.

// A plane as reflections.h takes it.
struct Picture {
    const View& view;
    int channels;

    __device__ const float* operator()(int y, int x) const {
        return view.at + channels * (size_t(y) * view.size[1] + x);
    }
};

extern "C" __global__ void denoise_reflections(View motion, View depth, View normal, View roughness,
                                               View diffuse_albedo, View specular_albedo,
                                               View hit_distance, View camera, View reflected) {
    const int h = depth.size[0], w = depth.size[1];
    PIXEL(w, h);
    const size_t pixel = size_t(y) * w + x;
    const Pair own = pair(motion, pixel);
    float moved[2] = {possible_motion<float>(own.x), possible_motion<float>(own.y)};
    const float rough = roughness.at[pixel];
    if (reflects(hit_distance.at[pixel], depth.at[pixel], rough, diffuse_albedo.at + 3 * pixel,
                 specular_albedo.at + 3 * pixel)) {
        const Picture far = {depth, 1}, facing = {normal, 3}, hit = {hit_distance, 1};
        const Surfaces<Picture> surfaces = {far, facing, hit,
                                            *reinterpret_cast<const Camera*>(camera.at), h, w};
        surfaces.follow(y, x, rough, moved);
    }
    pair(reflected, pixel) = {moved[0], moved[1]};
}

// The mask of what is in front of opaque things: colour, opaque_colour (h, w, 3), difference (3,),
// which is exposure, scale and threshold -> reactive (h, w, 1).

// Exposed light as a display shows it, 0 to 1.
FN float seen(float value, float exposure) {
    const float light = fminf(clamped(value, 0.0f, MAX_FLOAT) * exposure, MAX_COLOUR);
    return sqrtf(light / (1.0f + light));
}

extern "C" __global__ void denoise_reactive(View colour, View opaque_colour, View difference,
                                            View reactive) {
    const int width = reactive.size[1];
    PIXEL(width, reactive.size[0]);
    const int here = y * width + x;
    const float exposure = difference.at[0], scale = difference.at[1], threshold = difference.at[2];
    float most = 0.0f;
    for (int c = 0; c < 3; c++)
        most = fmaxf(most, fabsf(seen(colour.at[3 * here + c], exposure)
                                 - seen(opaque_colour.at[3 * here + c], exposure)));
    reactive.at[here] = most >= threshold ? fminf(most * scale, 1.0f) : 0.0f;
}

// The largest value in 3x3, within 0 and 1: reactive (h, w, 1) -> next_reactive (h, w, 1).
extern "C" __global__ void denoise_spread(View reactive, View next_reactive) {
    const int height = reactive.size[0], width = reactive.size[1];
    PIXEL(width, height);
    float most = 0.0f;
    UNROLL for (int j = -1; j <= 1; j++) {
        UNROLL for (int i = -1; i <= 1; i++)
            most = fmaxf(most,
                         clamped(reactive.at[clip(y + j, height) * width + clip(x + i, width)],
                                 0.0f, 1.0f));
    }
    next_reactive.at[y * width + x] = most;
}

// How much of the history each pixel of a part uses: reactive and last_reactive (h, w, 1), moved
// (th, tw, 2), part_rows (th,), part_columns (tw,) -> keep (th, tw, 1).
extern "C" __global__ void denoise_keep(View reactive, View last_reactive, View moved,
                                        View part_rows, View part_columns, View keep) {
    const int width = keep.size[1], h = reactive.size[0], w = reactive.size[1];
    PIXEL(width, keep.size[0]);
    const float v = part_rows.at[y], u = part_columns.at[x];
    const Pair motion = pair(moved, size_t(y) * width + x);
    const int from = clip(int(rintf(v + motion.y)), h) * w + clip(int(rintf(u + motion.x)), w);
    const float now = clamped(reactive.at[int(v) * w + int(u)], 0.0f, 1.0f);
    keep.at[y * width + x] = 1.0f - fmaxf(now, last_reactive.at[from]);
}

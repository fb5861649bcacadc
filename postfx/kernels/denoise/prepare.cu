#include "prepare.h"

// Harmonic mean depth of what was hit, 1 where nothing was: depth (h, w, 1) -> depth_scale (1,).
FN bool is_hit(float z) { return z > 0.0f && z < FARTHEST; }

// Sum of 1 / z over four depths; a product of fractions needs one division, and 4 factors of 1e-6
// to 1e9 stay normal.
FN float nearness(const Four& depth) {
    const bool a = is_hit(depth.x), b = is_hit(depth.y), c = is_hit(depth.z), d = is_hit(depth.w);
    const float p = a ? fmaxf(depth.x, NEAREST) : 1.0f, q = b ? fmaxf(depth.y, NEAREST) : 1.0f;
    const float r = c ? fmaxf(depth.z, NEAREST) : 1.0f, s = d ? fmaxf(depth.w, NEAREST) : 1.0f;
    const float left = (a ? q : 0.0f) + (b ? p : 0.0f), right = (c ? s : 0.0f) + (d ? r : 0.0f);
    return (left * (r * s) + right * (p * q)) / ((p * q) * (r * s));
}

FN int hits_of(const Four& depth) {
    return is_hit(depth.x) + is_hit(depth.y) + is_hit(depth.z) + is_hit(depth.w);
}

// Adds what the threads of a block have, in a fixed order; the first thread's are the sums.
FN void sum_in_block(double (&near)[SUMMING], int (&hits)[SUMMING], double own_near, int own_hits) {
    const int thread = threadIdx.x;
    near[thread] = own_near;
    hits[thread] = own_hits;
    for (int half = SUMMING / 2; half > 0; half /= 2) {
        __syncthreads();
        if (thread >= half) continue;
        near[thread] += near[thread + half];
        hits[thread] += hits[thread + half];
    }
}

// Each block sums some of the pixels. The last one to end adds the blocks' sums, in their order.
extern "C" __global__ void __launch_bounds__(SUMMING, 2)
    denoise_scale(View depth, View depth_scale, View between) {
    __shared__ double near[SUMMING];
    __shared__ int hits[SUMMING];
    __shared__ bool is_last;
    const int thread = threadIdx.x, block = blockIdx.y, first = block * SUMMING + thread,
              step = gridDim.y * SUMMING;
    const int count = depth.size[0] * depth.size[1], fours = count / 4;
    double sum = 0.0;
    int seen = 0;
    for (int i = first; i < fours; i += 4 * step) {
        Four some[4] = {};  // all are read before the first division
        UNROLL for (int k = 0; k < 4; k++)
            if (i + k * step < fours) some[k] = four(depth, i + k * step);
        sum += (nearness(some[0]) + nearness(some[1])) + (nearness(some[2]) + nearness(some[3]));
        seen += (hits_of(some[0]) + hits_of(some[1])) + (hits_of(some[2]) + hits_of(some[3]));
    }
    for (int i = 4 * fours + first; i < count; i += step) {
        const Four one = {depth.at[i], 0.0f, 0.0f, 0.0f};
        sum += nearness(one);
        seen += hits_of(one);
    }
    sum_in_block(near, hits, sum, seen);
    volatile double* const sums = reinterpret_cast<volatile double*>(between.at);
    int* const ended = reinterpret_cast<int*>(between.at + 4 * SUMMING);
    if (thread == 0) {
        sums[block] = near[0];
        sums[SUMMING + block] = hits[0];
        __threadfence();
        is_last = atomicAdd(ended, 1) + 1 == gridDim.y;
    }
    __syncthreads();
    if (!is_last) return;
    __threadfence();
    const bool counts = thread < gridDim.y;
    sum_in_block(near, hits, counts ? sums[thread] : 0.0, counts ? int(sums[SUMMING + thread]) : 0);
    if (thread > 0) return;
    depth_scale.at[0] = hits[0] ? float(hits[0] / near[0]) : 1.0f;
    *ended = 0;
}

// Motion of a clearly nearer neighbour in 3x3, else its own: motion (h, w, 2), depth (h, w, 1),
// part_rows (th,), part_columns (tw,) -> moved (th, tw, 2).

extern "C" __global__ void denoise_dilate(View motion, View depth, View part_rows,
                                          View part_columns, View moved) {
    PIXEL(moved.size[1], moved.size[0]);
    const int height = depth.size[0], width = depth.size[1];
    const int v = int(part_rows.at[y]), u = int(part_columns.at[x]), here = v * width + u;
    float near = depth.at[here] * CLEARLY;
    int at = here;
    UNROLL for (int j = -1; j <= 1; j++) {
        UNROLL for (int i = -1; i <= 1; i++) {
            // A repeated edge changes nothing: no pixel is nearer than itself.
            const int there = clip(v + j, height) * width + clip(u + i, width);
            const float z = depth.at[there];
            if (z < near) near = z, at = there;
        }
    }
    const Pair found = pair(motion, at);
    pair(moved, size_t(y) * moved.size[1] + x) = {possible_motion<float>(found.x),
                                                  possible_motion<float>(found.y)};
}

// Mean reflectance in cells of 8x8 pixels of the frame, from the one before the part's first row
// and column on; the frame's first and last cells repeat beyond it: diffuse_albedo and
// specular_albedo (h, w, 3), part_rows (th,), part_columns (tw,) -> means (cells, cells, 3).
// Eight neighbouring threads sum a column of a cell each; a block makes some cells of a row.
extern "C" __global__ void __launch_bounds__(SUMMING, 2)
    denoise_means(View diffuse_albedo, View specular_albedo, View part_rows, View part_columns,
                  View means) {
    const int h = diffuse_albedo.size[0], w = diffuse_albedo.size[1], cells = SUMMING / TRUST_CELL;
    const int top = int(part_rows.at[0]) / TRUST_CELL - 1,
              left = int(part_columns.at[0]) / TRUST_CELL - 1;
    const int groups = (means.size[1] + cells - 1) / cells, all = groups * means.size[0];
    for (int group = blockIdx.y; group < all; group += gridDim.y) {
        const int y = group / groups, x = (group - y * groups) * cells + threadIdx.x / TRUST_CELL;
        const int first = clip(top + y, (h - 1) / TRUST_CELL + 1) * TRUST_CELL,
                  end = min(first + TRUST_CELL, h);
        const int start = clip(left + x, (w - 1) / TRUST_CELL + 1) * TRUST_CELL,
                  stop = min(start + TRUST_CELL, w);
        const int u = start + threadIdx.x % TRUST_CELL;
        Colour sum = {0.0f, 0.0f, 0.0f};
        UNROLL for (int j = 0; j < TRUST_CELL; j++) {
            const Colour own = demodulation(diffuse_albedo, specular_albedo, min(first + j, h - 1),
                                            min(u, w - 1));
            if (first + j < end && u < stop) add(sum, own, 1.0f);
        }
        sum = {sum_of_eight(sum.r), sum_of_eight(sum.g), sum_of_eight(sum.b)};
        if (x >= means.size[1] || threadIdx.x % TRUST_CELL) continue;
        const float share = 1.0f / ((end - first) * (stop - start));
        float* const to = means.at + 3 * (y * means.size[1] + x);
        put(to, sum * share);
    }
}

// Where a pixel of a side lies among the frame's cells, of which `means` has some from one on.
FN Between cells_around(int at, int size, int from) {
    const Between found = between_cells((at + 0.5f) / TRUST_CELL - 0.5f,
                                        (size - 1) / TRUST_CELL + 1);
    return {found.first - from, found.second - from, found.share};
}

// Reflectance brought towards its mean around a pixel of the frame, as far as it is not trusted (1
// to -1).
FN Colour doubted(const Colour& own, const View& means, int v, int u, int h, int w,
                  const Window& part, float trust) {
    const Between down = cells_around(v, h, part.top / TRUST_CELL - 1);
    const Between across = cells_around(u, w, part.left / TRUST_CELL - 1);
    const float *const above = means.at + 3 * down.first * means.size[1];
    const float *const below = means.at + 3 * down.second * means.size[1];
    float mean[3];
    UNROLL for (int c = 0; c < 3; c++) {
        const int left = 3 * across.first + c, right = 3 * across.second + c;
        const float first = above[left] + (below[left] - above[left]) * down.share;
        const float second = above[right] + (below[right] - above[right]) * down.share;
        mean[c] = first + (second - first) * across.share;
    }
    return {doubted<float>(own.r, mean[0], trust), doubted<float>(own.g, mean[1], trust),
            doubted<float>(own.b, mean[2], trust)};
}

// Running mean of demodulated colour: colour, diffuse_albedo and specular_albedo (h, w, 3), means
// (cells, cells, 3), one cell where planes are not doubted, depth (h, w, 1), past (th, tw, 4), fine
// (1, 80, hp, wp) or its last channels, params (4,), window (8,) -> next_state (th, tw, 12),
// next_depth (th, tw, 1), level (4, hp, wp), which is the mean with its importance, and factor (th,
// tw, 3), the reflectance. All are zero beyond the frame.
template <class Number>
__global__ void denoise_accumulate(View colour, View diffuse_albedo, View specular_albedo,
                                   View means, View depth, View past, View fine, View params,
                                   View window, View next_state, View next_depth, View level,
                                   View factor) {
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
        for (int c = 0; c < 3 && kept; c++) {
            four(next_state, 3 * pixel + c) = {0.0f, 0.0f, 0.0f, 0.0f};
            factor.at[3 * pixel + c] = 0.0f;
        }
        return;
    }
    const size_t source = size_t(part.top + y) * colour.size[1] + part.left + x;
    const float* rgb = colour.at + 3 * source;
    // of a head with fewer channels they are the last ones
    const Number* head = numbers<Number>(fine) + here - size_t(FINE - fine.size[1]) * plane;
    const float exposure = params.at[EXPOSURE], z = depth.at[source];
    const float distrust = as_float(head[DISTRUST * plane]),
                importance = as_float(head[IMPORTANCE * plane]);
    const Four before = four(past, pixel);
    float hidden[HIDDEN];
    UNROLL for (int i = 0; i < HIDDEN; i++) hidden[i] = as_float(head[(MEMORY + i) * plane]);
    Colour by = demodulation(diffuse_albedo, specular_albedo, part.top + y, part.left + x);
    if (means.size[0] > 1)
        by = doubted(by, means, part.top + y, part.left + x, colour.size[0], colour.size[1], part,
                     as_float(head[PLANE_TRUST * plane]));
    const Accumulated<float> found = accumulate<float>(
        light_without(rgb, by, exposure), {before.x, before.y, before.z, before.w}, distrust,
        importance, hidden);
    // What lies at the part's edge, where the frame goes on, is nothing that the next one knows.
    const bool edge = (y == 0 && part.top > 0) || (x == 0 && part.left > 0) ||
        (y == past.size[0] - 1 && part.top + y + 1 < colour.size[0]) ||
        (x == past.size[1] - 1 && part.left + x + 1 < colour.size[1]);
    UNROLL for (int c = 0; c < 3; c++) {
        const float* const state = found.state + 4 * c;
        four(next_state, 3 * pixel + c) = edge ? Four{0.0f, 0.0f, 0.0f, 0.0f}
                                               : Four{state[0], state[1], state[2], state[3]};
    }
    next_depth.at[pixel] = z;
    put(factor.at + 3 * pixel, by);
    UNROLL for (int c = 0; c < 3; c++) to[c * plane] = found.level[c];
    to[3 * plane] = found.importance;
}

// Which path shows what is at a cell, as choose.py chooses it. Pictures are held as (h, w, 4) without what is not
// finite; toned ones are (h + 2 MARGIN, w + 2 MARGIN, 1). Cells are (rows, columns, 8).

// A picture (h, w, 3) as it is held.
extern "C" __global__ void interpolate_hold(View picture, View held) {
    const int w = picture.size[1];
    PIXEL(w, picture.size[0]);
    const size_t at = size_t(y) * w + x;
    const float* const p = picture.at + 3 * at;
    four(held, at) = {known(p[0]), known(p[1]), known(p[2]), 0.0f};
}

// Sum of a block's threads, in all of them.
__device__ inline float block_sum(float value) {
    __shared__ float parts[8];
    for (int mask = 16; mask; mask /= 2) value += __shfl_xor_sync(~0u, value, mask);
    __syncthreads();
    if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = value;
    __syncthreads();
    float total = 0.0f;
    for (int k = 0; k < 8; k++) total += parts[k];
    return total;
}

// The largest value of a block's threads, in all of them.
__device__ inline float block_max(float value) {
    __shared__ float parts[8];
    for (int mask = 16; mask; mask /= 2) value = fmaxf(value, __shfl_xor_sync(~0u, value, mask));
    __syncthreads();
    if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = value;
    __syncthreads();
    float most = parts[0];
    for (int k = 1; k < 8; k++) most = fmaxf(most, parts[k]);
    return most;
}

// Sums over pixels of both pictures, one of each block (parts, 1): of their light, or of its logarithm.
__device__ inline float light_of(const View& picture, int j, int i, int step) {
    const Four p = four(picture, size_t(j) * step * picture.size[1] + size_t(i) * step);
    return fmaxf(RED * p.x + GREEN * p.y + BLUE * p.z, 0.0f);
}

template <class Of>
__device__ inline void sum_lights(const View& before, const View& after, const View& sums, const Of& of) {
    const int h = before.size[0], w = before.size[1], step = min(h, w) >= 256 ? 4 : 1;
    const int rows = (h + step - 1) / step, columns = (w + step - 1) / step;
    float total = 0.0f;
    for (int j = blockIdx.y; j < rows; j += gridDim.y)
        for (int i = threadIdx.x; i < columns; i += blockDim.x)
            total += of(light_of(before, j, i, step)) + of(light_of(after, j, i, step));
    total = block_sum(total);
    if (threadIdx.x == 0) sums.at[blockIdx.y] = total / (2.0f * rows * columns);
}

__device__ inline float sum_of(const View& sums) {
    float total = 0.0f;
    for (int k = 0; k < sums.size[0]; k++) total += sums.at[k];
    return total;
}

extern "C" __global__ void interpolate_lights(View before, View after, View sums) {
    sum_lights(before, after, sums, [](float light) { return light; });
}

extern "C" __global__ void interpolate_logs(View before, View after, View lights, View sums) {
    const float least = 1e-3f * (sum_of(lights) + 1e-12f);
    sum_lights(before, after, sums, [least](float light) { return logf(light + least); });
}

// Light that is toned to about the middle (1,).
extern "C" __global__ void interpolate_level(View sums, View level) {
    PIXEL(1, 1);
    level.at[0] = 4.0f * expf(sum_of(sums));
}

__device__ inline float toned_at(const View& picture, int y, int x, float level) {
    const Four p = four(picture, size_t(within(y, picture.size[0])) * picture.size[1] + within(x, picture.size[1]));
    const float r = fmaxf(p.x, 0.0f), g = fmaxf(p.y, 0.0f), b = fmaxf(p.z, 0.0f);
    return (sqrtf(r / (r + level)) + sqrtf(g / (g + level)) + sqrtf(b / (b + level))) * (1.0f / 3.0f);
}

extern "C" __global__ void interpolate_tone(View before, View after, View level, View toned_before, View toned_after) {
    const int width = toned_before.size[1];
    PIXEL(width, toned_before.size[0]);
    const size_t at = size_t(y) * width + x;
    toned_before.at[at] = toned_at(before, y - MARGIN, x - MARGIN, level.at[0]);
    toned_after.at[at] = toned_at(after, y - MARGIN, x - MARGIN, level.at[0]);
}

// Two toned pictures, and how they are compared.
struct Toned {
    const float *before, *after;
    int h, w, stride;
};

__device__ inline Toned toned_of(const View& before, const View& after) {
    return {before.at, after.at, before.size[0] - 2 * MARGIN, before.size[1] - 2 * MARGIN, before.size[1]};
}

__device__ inline float taper(int i) {
    return i == 0 || i == 7 ? 0.25f : i == 1 || i == 6 ? 0.75f : 1.0f;
}

struct Place {
    const float* at;
    float across, down;
};

__device__ inline Place window_at(const float* toned, int stride, float y, float x) {
    const float v = y - 0.5f * (ROWS - 1), u = x - 3.5f, j = floorf(v), i = floorf(u);
    return {toned + (int(j) + MARGIN) * stride + int(i) + MARGIN, u - i, v - j};
}

// One row of a window and one number more, between pixels across.
template <int N>
__device__ inline void row_at(const Place& place, int stride, int row, float (&found)[N]) {
    const float* const line = place.at + row * stride;
    float last = line[0];
#pragma unroll
    for (int i = 0; i < N; i++) {
        const float next = line[i + 1];
        found[i] = last + place.across * (next - last);
        last = next;
    }
}

// Mean difference of two toned pictures around the places that a path leads to; -1 where one is not in its picture.
__device__ inline float misfit(const Toned& by, float y, float x, const Path& path) {
    if (!(is_inside(by.h, by.w, y + path.ay, x + path.ax) && is_inside(by.h, by.w, y + path.by, x + path.bx)))
        return -1.0f;
    const Place one = window_at(by.before, by.stride, y + path.ay, x + path.ax);
    const Place other = window_at(by.after, by.stride, y + path.by, x + path.bx);
    float upper[8], upper_after[8], lower[8], lower_after[8], total = 0.0f;
    row_at(one, by.stride, 0, upper);
    row_at(other, by.stride, 0, upper_after);
    for (int j = 1; j <= ROWS; j++) {
        row_at(one, by.stride, j, lower);
        row_at(other, by.stride, j, lower_after);
#pragma unroll
        for (int i = 0; i < 8; i++) {
            const float a = upper[i] + one.down * (lower[i] - upper[i]);
            total += taper(i) * fabsf(a - (upper_after[i] + other.down * (lower_after[i] - upper_after[i])));
            upper[i] = lower[i];
            upper_after[i] = lower_after[i];
        }
    }
    return total / COUNT;
}

// Sums of squares of the slopes, across and down: of the difference of two windows, and of their sum.
__device__ inline Pair window_detail(const Toned& by, const Place& one, const Place& other) {
    float upper[9], upper_after[9], lower[9], lower_after[9], apart[9], common[9];
    row_at(one, by.stride, 0, upper);
    row_at(other, by.stride, 0, upper_after);
    Pair sums = {0.0f, 0.0f};
    for (int j = 0; j < ROWS; j++) {
        row_at(one, by.stride, j + 1, lower);
        row_at(other, by.stride, j + 1, lower_after);
        float less[9], more[9];
#pragma unroll
        for (int i = 0; i < 9; i++) {
            const float a = upper[i] + one.down * (lower[i] - upper[i]);
            const float b = upper_after[i] + other.down * (lower_after[i] - upper_after[i]);
            less[i] = a - b;
            more[i] = a + b;
            upper[i] = lower[i];
            upper_after[i] = lower_after[i];
        }
#pragma unroll
        for (int i = 0; i < 8; i++) {
            const float across = less[i + 1] - less[i], along = more[i + 1] - more[i];
            const float down = j ? less[i] - apart[i] : 0.0f, under = j ? more[i] - common[i] : 0.0f;
            sums.x += taper(i) * (across * across + down * down);
            sums.y += taper(i) * (along * along + under * under);
        }
#pragma unroll
        for (int i = 0; i < 9; i++) {
            apart[i] = less[i];
            common[i] = more[i];
        }
    }
    return sums;
}

__device__ inline bool is_still(const Path& path) {
    return fmaxf(fmaxf(fabsf(path.ax), fabsf(path.ay)), fmaxf(fabsf(path.bx), fabsf(path.by))) < STILL;
}

// A toned picture between four pixels.
__device__ inline float value_at(const Toned& by, const float* toned, float y, float x) {
    y = fminf(fmaxf(y, -1.0f), float(by.h));
    x = fminf(fmaxf(x, -1.0f), float(by.w));
    const float j = floorf(y), i = floorf(x), down = y - j, across = x - i;
    const float* const at = toned + (int(j) + MARGIN) * by.stride + int(i) + MARGIN;
    const float upper = at[0] + across * (at[1] - at[0]);
    return upper + down * (at[by.stride] + across * (at[by.stride + 1] - at[by.stride]) - upper);
}

__device__ inline float difference(const Toned& by, float y, float x, const Path& path) {
    return fabsf(value_at(by, by.before, y + path.ay, x + path.ax) - value_at(by, by.after, y + path.by, x + path.bx));
}

__device__ inline float contrast(const Toned& by, float y, float x, const Path& path, const Path& other) {
    return fminf(fabsf(value_at(by, by.before, y + path.ay, x + path.ax)
                       - value_at(by, by.before, y + other.ay, x + other.ax)),
                 fabsf(value_at(by, by.after, y + path.by, x + path.bx)
                       - value_at(by, by.after, y + other.by, x + other.bx)));
}

// Misfit of one of 4x4 cells of the frame after (rows / 4, columns / 4, 1) that the frame before shows too, else -1.
extern "C" __global__ void interpolate_misfits(View before, View after, View ends, View seen, View scale, View found) {
    PIXEL(found.size[1], found.size[0]);
    const int cell = (4 * y + 2) * seen.size[1] + 4 * x + 2;
    const float size = scale.at[0], middle = 0.5f * (size - 1.0f);
    const Four end = four(ends, cell);
    const Path path = {size * end.x, size * end.y, size * end.z, size * end.w, 1.0f, 1.0f};
    found.at[y * found.size[1] + x] = seen.at[cell] > 0.0f
        ? misfit(toned_of(before, after), size * (4 * y + 2) + middle, size * (4 * x + 2) + middle, path) : -1.0f;
}

// The median of misfits that are 0 or more, by a block: digit by digit, as positive floats have the order of whole
// numbers. The mean of the middle two if their count is even, 0 without any.
__device__ inline unsigned select(const float* numbers, int count, int rank) {
    __shared__ int digits[256];
    __shared__ unsigned chosen;
    __shared__ int left;
    unsigned prefix = 0;
    for (int shift = 24; shift >= 0; shift -= 8) {
        __syncthreads();
        for (int k = threadIdx.x; k < 256; k += blockDim.x) digits[k] = 0;
        __syncthreads();
        for (int k = threadIdx.x; k < count; k += blockDim.x) {
            const unsigned bits = __float_as_uint(numbers[k]);
            if (numbers[k] >= 0.0f && (shift == 24 || bits >> (shift + 8) == prefix))
                atomicAdd(&digits[bits >> shift & 255], 1);
        }
        __syncthreads();
        if (threadIdx.x == 0) {
            int before = 0, digit = 0;
            while (digit < 255 && before + digits[digit] <= rank) before += digits[digit++];
            chosen = prefix << 8 | unsigned(digit);
            left = rank - before;
        }
        __syncthreads();
        prefix = chosen;
        rank = left;
    }
    return prefix;
}

extern "C" __global__ void interpolate_noise(View found, View noise) {
    const int count = found.size[0] * found.size[1];
    float known_ones = 0.0f;
    for (int k = threadIdx.x; k < count; k += blockDim.x) known_ones += found.at[k] >= 0.0f;
    const int all = int(block_sum(known_ones));
    const float low = all ? __int_as_float(int(select(found.at, count, (all - 1) / 2))) : 0.0f;
    float above = LARGEST_FLOAT, up_to = 0.0f;
    for (int k = threadIdx.x; k < count; k += blockDim.x) {
        const float value = found.at[k];
        up_to += value >= 0.0f && value <= low;
        if (value > low) above = fminf(above, value);
    }
    up_to = block_sum(up_to);
    above = -block_max(-above);
    const float high = int(up_to) > all / 2 ? low : above;  // of an even count, the second one in the middle
    if (threadIdx.x == 0) noise.at[0] = 0.5f * (low + high);
}

// What arrived at a cell of one side: the mean path to both frames, in cells, its share that is seen, and its depth.
// Where nothing arrived it is that of two neighbours on opposite sides, or NaN and FAR.
struct Arrived {
    Four path;
    float seen, depth;
};

__device__ inline Arrived mean_of(const View& sums, int cell, float depth) {
    const Four p = four(sums, 2 * size_t(cell)), q = four(sums, 2 * size_t(cell) + 1);
    return {{p.x / q.y, p.y / q.y, p.z / q.y, p.w / q.y}, q.x / q.y, depth};
}

__device__ inline Arrived arrived_at(const View& nearest, const View& sums, int y, int x) {
    const int h = nearest.size[0], w = nearest.size[1], cell = y * w + x;
    if (nearest.at[cell] < FAR) return mean_of(sums, cell, nearest.at[cell]);
    Arrived found = {{__int_as_float(0x7fc00000), 0.0f, 0.0f, 0.0f}, 0.0f, nearest.at[cell]};
    float best = FAR;
    const int down[4] = {0, 1, 1, 1}, right[4] = {1, 0, 1, -1};
    for (int k = 0; k < 4; k++) {
        const int j = down[k], i = right[k], step = j * w + i;
        if (y < j || y >= h - j || x < abs(i) || x >= w - abs(i)) continue;
        const float one = nearest.at[cell - step], other = nearest.at[cell + step];
        if (!(one < FAR && fabsf(one - other) <= ALIKE * one && one < best)) continue;
        best = one;
        const Arrived p = mean_of(sums, cell - step, one), q = mean_of(sums, cell + step, other);
        found = {{0.5f * (p.path.x + q.path.x), 0.5f * (p.path.y + q.path.y), 0.5f * (p.path.z + q.path.z),
                  0.5f * (p.path.w + q.path.w)}, 0.5f * (p.seen + q.seen), 0.5f * (one + other)};
    }
    return found;
}

// A path of one frame's side, in pixels: that frame shows it, the other one if most paths that arrived are seen.
__device__ inline Path side_path(const Four& path, float seen, bool is_last, float scale) {
    const float other = seen >= SURE;
    return {scale * path.x, scale * path.y, scale * path.z, scale * path.w, is_last ? other : 1.0f,
            is_last ? 1.0f : other};
}

__device__ inline float most_apart(const Path& one, const Path& other) {
    return fmaxf(fmaxf(fabsf(one.ax - other.ax), fabsf(one.ay - other.ay)),
                 fmaxf(fabsf(one.bx - other.bx), fabsf(one.by - other.by)));
}

// The same without jitter, written to a side (rows, columns, 8) and its depth (rows, columns, 1).
__device__ inline Arrived put_side(const View& nearest, const View& sums, const View& facts, int y, int x,
                                   const View& side, const View& depth) {
    Arrived found = arrived_at(nearest, sums, y, x);
    const float* const shift = facts.at + 5;  // what jitters of both frames take off again
    found.path = {found.path.x - shift[0], found.path.y - shift[1], found.path.z - shift[2], found.path.w - shift[3]};
    const size_t cell = size_t(y) * nearest.size[1] + x;
    four(side, 2 * cell) = found.path;
    four(side, 2 * cell + 1) = {found.seen, 0.0f, 0.0f, 0.0f};
    depth.at[cell] = found.depth;
    return found;
}

// What arrived of both sides, and of that at each cell the nearer path, or their mean where they are alike; NaN
// without. The seventh number of `own` is how many pixels the sides' paths differ from it.
extern "C" __global__ void interpolate_merge(View nearest_before, View sums_before, View nearest_after, View sums_after,
                                             View facts, View scale, View first, View first_depth, View last,
                                             View last_depth, View own) {
    PIXEL(own.size[1], own.size[0]);
    const Arrived before = put_side(nearest_before, sums_before, facts, y, x, first, first_depth);
    const Arrived after = put_side(nearest_after, sums_after, facts, y, x, last, last_depth);
    const float a = before.depth, b = after.depth;
    const Path one = side_path(before.path, before.seen, false, scale.at[0]);
    const Path other = side_path(after.path, after.seen, true, scale.at[0]);
    Path merged = a < b ? one : other;
    if (a < FAR && b < FAR && fabsf(a - b) <= 1.5f * ALIKE * fminf(a, b)) {
        const bool is_any = other.first + one.last > 0.0f;
        merged = {0.5f * (one.ax + other.ax), 0.5f * (one.ay + other.ay), 0.5f * (one.bx + other.bx),
                  0.5f * (one.by + other.by), is_any ? other.first : 1.0f, is_any ? one.last : 1.0f};
    }
    const float apart = fmaxf(a < FAR ? most_apart(one, merged) : 0.0f, b < FAR ? most_apart(other, merged) : 0.0f);
    const size_t cell = size_t(y) * own.size[1] + x;
    four(own, 2 * cell) = {merged.ax, merged.ay, merged.bx, merged.by};
    four(own, 2 * cell + 1) = {merged.first, merged.last, apart, 0.0f};
}

// Cells without a path get that of the farthest of the next ones above, below, to the left and to the right.
extern "C" __global__ void interpolate_fill(View first_depth, View last_depth, View own) {
    const int rows = own.size[0], columns = own.size[1];
    PIXEL(columns, rows);
    const int cell = y * columns + x, steps[4] = {-columns, columns, -1, 1};
    const int counts[4] = {y, rows - 1 - y, x, columns - 1 - x};
    if (fminf(first_depth.at[cell], last_depth.at[cell]) < FAR) return;
    int source = -1;
    float farthest = -1.0f;
    for (int turn = 0; turn < 4; turn++) {
        int at = cell;
        for (int k = 0; k < counts[turn]; k++) {
            at += steps[turn];
            const float depth = fminf(first_depth.at[at], last_depth.at[at]);
            if (!(depth < FAR)) continue;
            if (depth > farthest) farthest = depth, source = at;
            break;
        }
    }
    put_path(own, cell, source < 0 ? Path{0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 1.0f} : path_of(own, source));
}

// Whether around a cell one frame is turned or stretched evenly against the other one, by much.
__device__ inline bool is_turning(const View& own, int y, int x, float size) {
    const int rows = own.size[0], columns = own.size[1], cell = y * columns + x;
    if (!(1 <= y && y < rows - 1 && 1 <= x && x < columns - 1)) return false;
    const Four here = four(own, 2 * cell);
    float most = 0.0f, uneven = 0.0f;
    for (int k = 0; k < 2; k++) {
        const int step = k ? columns : 1;
        const Four p = four(own, 2 * (cell - step)), q = four(own, 2 * (cell + step));
        most = fmaxf(most, fmaxf(fabsf(q.z - p.z - q.x + p.x), fabsf(q.w - p.w - q.y + p.y)));
        uneven = fmaxf(uneven, fmaxf(fmaxf(fabsf(p.x + q.x - 2.0f * here.x), fabsf(p.y + q.y - 2.0f * here.y)),
                                     fmaxf(fabsf(p.z + q.z - 2.0f * here.z), fabsf(p.w + q.w - 2.0f * here.w))));
    }
    return 2.0f * TWIST * size < most && uneven < EVEN;
}

// Whether no path of both sides at a cell and at the four beside it differs from its own: known by how far they are
// from those cells' own ones.
__device__ inline bool is_alone(const View& own, int y, int x, const Path& mine) {
    const int rows = own.size[0], columns = own.size[1], cell = y * columns + x;
    const int beside[4] = {y > 0 ? cell - columns : cell, y < rows - 1 ? cell + columns : cell, x > 0 ? cell - 1 : cell,
                           x < columns - 1 ? cell + 1 : cell};
    float most = own.at[8 * size_t(cell) + 6];
#pragma unroll
    for (int k = 0; k < 4; k++)
        most = fmaxf(most, most_apart(path_of(own, beside[k]), mine) + own.at[8 * size_t(beside[k]) + 6]);
    return most <= 0.99f * OTHER;
}

// The path of each cell: its own, or another one around it that fits much better.
extern "C" __global__ void interpolate_choose(View before, View after, View own, View first, View last,
                                              View first_depth, View last_depth, View noise, View scale, View cells) {
    const int rows = own.size[0], columns = own.size[1];
    PIXEL(columns, rows);
    const Toned toned = toned_of(before, after);
    const int cell = y * columns + x, down[5] = {0, 0, 1, 0, -1}, right[5] = {0, 1, 0, -1, 0};
    const float size = scale.at[0], middle = 0.5f * (size - 1.0f), v = size * y + middle, u = size * x + middle;
    const float least = noise.at[0], unseen = UNSEEN + UNSEEN_NOISE * least;
    const Path mine = path_of(own, cell);
    Path taken = mine, tried = mine;
    const bool is_shown = mine.first + mine.last == 2.0f;
    // no window that is moved alone can fit what turns
    if (!is_alone(own, y, x, mine) && !(is_shown && is_turning(own, y, x, size))) {
        const float depth = fminf(first_depth.at[cell], last_depth.at[cell]);
        const float better = is_still(mine) ? BETTER_STILL : BETTER;
        bool is_seen = false;
        float best = -2.0f;  // not looked at yet: many cells have no other path around them
        for (int k = 0; k < 10; k++) {
            const int step = k % 5, j = y + down[step], i = x + right[step], there = j * columns + i;
            if (!(0 <= j && j < rows && 0 <= i && i < columns)) continue;
            const View& side = k < 5 ? first : last;
            const Path path = side_path(four(side, 2 * size_t(there)), side.at[8 * size_t(there) + 4], k >= 5, size);
            const bool is_other = differ(path, mine, OTHER) && differ(path, taken, OTHER) && differ(path, tried, OTHER);
            if (path.ax != path.ax || !is_other) continue;
            tried = path;
            if (is_shown && depth < BEFORE * (k < 5 ? first_depth : last_depth).at[there]) {
                const float allowed = difference(toned, v, u, path) + least
                    + ONE_THING * contrast(toned, v, u, mine, path);
                if (difference(toned, v, u, mine) <= allowed) continue;
            }
            if (best < -1.0f) {
                best = misfit(toned, v, u, mine);
                is_seen = 0.0f <= best && best < TRUSTED * unseen;
                if (!is_seen && (best < 0.0f || !is_shown)) best = unseen;
            }
            if (best <= least) break;
            float fit = misfit(toned, v, u, path);
            const bool fits = 0.0f <= fit && fit < TRUSTED * unseen;
            if (!fits && (fit < 0.0f || path.first + path.last < 2.0f)) fit = unseen;
            if ((best < APART ? better : BETTER) * fit + least < best) {
                best = fit;
                taken = path;
                is_seen = fits;
            }
        }
        if (is_seen) taken.first = taken.last = 1.0f;
    }
    put_path(cells, cell, taken);
}

// Share of what two pictures show around the places of a path that both show (Wiener).
__device__ inline float sharpness(const Toned& by, float y, float x, const Path& path, float noise) {
    if (path.first + path.last < 2.0f) return 1.0f;
    if (!(is_inside(by.h, by.w, y + path.ay, x + path.ax) && is_inside(by.h, by.w, y + path.by, x + path.bx)))
        return 1.0f;
    const Pair sums = window_detail(by, window_at(by.before, by.stride, y + path.ay, x + path.ax),
                                    window_at(by.after, by.stride, y + path.by, x + path.bx));
    const float apart = fminf(sums.x, MOST_NOISE * noise * noise * SLOPES);
    const float share = sums.y > 0.0f ? fmaxf(1.0f - apart / sums.y, 0.0f) : 1.0f;
    return share > MOSTLY && is_still(path) ? 1.0f : share;
}

// The same over 8x6 places whose paths change from place to place as from a cell to the next ones.
__device__ inline float turned_sharpness(const Toned& by, float y, float x, const View& cells, int cell, float scale,
                                         float noise) {
    const int columns = cells.size[1];
    const Four p = four(cells, 2 * cell), q = four(cells, 2 * (cell + 1)), r = four(cells, 2 * (cell + columns));
    const float size = 1.0f / scale;
    float apart = 0.0f, common = 0.0f, above[8], above_after[8];
    for (int j = 0; j <= ROWS; j++) {
        float left = 0.0f, left_after = 0.0f;
#pragma unroll
        for (int i = 0; i < 8; i++) {
            const float v = y + (j - 0.5f * ROWS), u = x + (i - 3.5f);
            const float down = (j - 0.5f * ROWS) * size, across = (i - 3.5f) * size;
            const float ax = p.x + across * (q.x - p.x) + down * (r.x - p.x);
            const float ay = p.y + across * (q.y - p.y) + down * (r.y - p.y);
            const float bx = p.z + across * (q.z - p.z) + down * (r.z - p.z);
            const float by_ = p.w + across * (q.w - p.w) + down * (r.w - p.w);
            const float one = value_at(by, by.before, v + ay, u + ax), other = value_at(by, by.after, v + by_, u + bx);
            if (i && j) {
                const float right = one - left, right_after = other - left_after;
                const float under = one - above[i], under_after = other - above_after[i];
                apart += (right - right_after) * (right - right_after) + (under - under_after) * (under - under_after);
                common += (right + right_after) * (right + right_after) + (under + under_after) * (under + under_after);
            }
            left = above[i] = one;
            left_after = above_after[i] = other;
        }
    }
    apart = fminf(apart, MOST_NOISE * noise * noise * SLOPES);
    return common > 0.0f ? fmaxf(1.0f - apart / common, 0.0f) : 1.0f;
}

// How sharp the pictures are at cells, written to their seventh number: once for two by two that follow one path. Cells
// are joined.
extern "C" __global__ void interpolate_detail(View before, View after, View noise, View scale, View cells) {
    const int rows = cells.size[0], columns = cells.size[1];
    PIXEL(columns, rows);
    const Toned toned = toned_of(before, after);
    const float size = scale.at[0], middle = 0.5f * (size - 1.0f);
    const int cell = y * columns + x, leader = (y - y % 2) * columns + x - x % 2;
    const Path path = path_of(cells, cell), one = path_of(cells, leader);
    // its leader writes to it, too
    if (cell != leader && !differ(path, one, OTHER) && path.first + path.last == one.first + one.last) return;
    float share = 1.0f;
    if (cells.at[8 * size_t(cell) + 7] > 1.0f && y < rows - 1 && x < columns - 1) {
        if (path.first + path.last == 2.0f)
            share = turned_sharpness(toned, size * y + middle, size * x + middle, cells, cell, size, noise.at[0]);
    } else {
        const float at = cell == leader ? size - 0.5f : middle;
        share = sharpness(toned, size * y + at, size * x + at, path, noise.at[0]);
    }
    cells.at[8 * size_t(cell) + 6] = share;
    if (cell != leader) return;
    for (int k = 1; k < 4; k++) {
        if (y + k / 2 >= rows || x + k % 2 >= columns) continue;
        const int other = cell + k / 2 * columns + k % 2;
        const Path its = path_of(cells, other);
        if (!differ(its, path, OTHER) && its.first + its.last == path.first + path.last)
            cells.at[8 * size_t(other) + 6] = share;
    }
}

// Which path shows what is at a cell, as choose.py chooses it. Pictures are held as (h, w, 4)
// without what is not finite, the fourth number is depth; toned ones are (h + 2 MARGIN, w + 2
// MARGIN, 1). Cells are (rows, columns, 8).

// A picture (h, w, 3) and its depth (h, w, 1) as they are held.
extern "C" __global__ void interpolate_hold(View picture, View depth, View held) {
    const int w = picture.size[1];
    PIXEL(w, picture.size[0]);
    const size_t at = size_t(y) * w + x;
    const float* const p = picture.at + 3 * at;
    four(held, at) = {finite(p[0]), finite(p[1]), finite(p[2]), depth.at[at]};
}

// Sum of a block's threads, in all of them.
FN float block_sum(float value) {
    __shared__ float parts[32];
    for (int mask = 16; mask; mask /= 2) value += __shfl_xor_sync(~0u, value, mask);
    __syncthreads();
    if (threadIdx.x % 32 == 0) parts[threadIdx.x / 32] = value;
    __syncthreads();
    float total = 0.0f;
    for (int k = 0; k < blockDim.x / 32; k++) total += parts[k];
    return total;
}

// Sums over pixels of both pictures, one of each block (parts, 1): of their light, or of its
// logarithm.
FN float light_of(const View& picture, int j, int i, int step) {
    const Four p = four(picture, size_t(j) * step * picture.size[1] + size_t(i) * step);
    return fmaxf(RED * p.x + GREEN * p.y + BLUE * p.z, 0.0f);
}

template <class Of>
FN void sum_lights(const View& before, const View& after, const View& sums, const Of& of) {
    const int h = before.size[0], w = before.size[1], step = min(h, w) >= 256 ? 4 : 1;
    const int rows = (h + step - 1) / step, columns = (w + step - 1) / step;
    float total = 0.0f;
    for (int j = blockIdx.y; j < rows; j += gridDim.y)
        for (int i = threadIdx.x; i < columns; i += blockDim.x)
            total += of(light_of(before, j, i, step)) + of(light_of(after, j, i, step));
    total = block_sum(total);
    if (threadIdx.x == 0) sums.at[blockIdx.y] = total / (2.0f * rows * columns);
}

FN float sum_of(const View& sums) {
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

FN float toned_at(const View& picture, int y, int x, float level) {
    const Four p = four(
        picture, size_t(clip(y, picture.size[0])) * picture.size[1] + clip(x, picture.size[1]));
    const float r = fmaxf(p.x, 0.0f), g = fmaxf(p.y, 0.0f), b = fmaxf(p.z, 0.0f);
    return (sqrtf(r / (r + level)) + sqrtf(g / (g + level)) + sqrtf(b / (b + level)))
           * (1.0f / 3.0f);
}

extern "C" __global__ void interpolate_tone(View before, View after, View level, View toned_before,
                                            View toned_after) {
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

FN Toned toned_of(const View& before, const View& after) {
    return {before.at, after.at, before.size[0] - 2 * MARGIN, before.size[1] - 2 * MARGIN,
            before.size[1]};
}

FN float taper(int i) { return i == 0 || i == 7 ? 0.25f : i == 1 || i == 6 ? 0.75f : 1.0f; }

struct Place {
    const float* at;
    float across, down;
};

// Where the lane's column of a window begins: eight lanes work on one window.
FN Place window_at(const float* toned, int stride, float y, float x) {
    const float v = y - 0.5f * (ROWS - 1), u = x - 3.5f, j = floorf(v), i = floorf(u);
    return {toned + (int(j) + MARGIN) * stride + int(i) + MARGIN + threadIdx.x % 8, u - i, v - j};
}

// A number of a window's row, between pixels across.
FN float across_at(const Place& place, int stride, int row, int column) {
    const float* const at = place.at + row * stride + column;
    return at[0] + place.across * (at[1] - at[0]);
}

// Mean difference of two toned pictures around the places that a path leads to; -1 where one is not
// in its picture.
FN float misfit(const Toned& by, float y, float x, const Path& path) {
    if (!(is_inside(by.h, by.w, y + path.ay, x + path.ax)
          && is_inside(by.h, by.w, y + path.by, x + path.bx)))
        return -1.0f;
    const Place one = window_at(by.before, by.stride, y + path.ay, x + path.ax);
    const Place other = window_at(by.after, by.stride, y + path.by, x + path.bx);
    float upper = across_at(one, by.stride, 0, 0), upper_after = across_at(other, by.stride, 0, 0),
          total = 0.0f;
    UNROLL for (int j = 1; j <= ROWS; j++) {
        const float lower = across_at(one, by.stride, j, 0),
                    lower_after = across_at(other, by.stride, j, 0);
        const float a = upper + one.down * (lower - upper);
        total += fabsf(a - (upper_after + other.down * (lower_after - upper_after)));
        upper = lower;
        upper_after = lower_after;
    }
    return sum_of_eight(taper(threadIdx.x % 8) * total) / COUNT;
}

// Sums of squares of the slopes, across and down: of the difference of two windows, and of their
// sum.
FN Pair window_detail(const Toned& by, const Place& one, const Place& other) {
    float upper[2], upper_after[2], apart = 0.0f, common = 0.0f;
    UNROLL for (int i = 0; i < 2; i++) {
        upper[i] = across_at(one, by.stride, 0, i);
        upper_after[i] = across_at(other, by.stride, 0, i);
    }
    Pair sums = {0.0f, 0.0f};
    UNROLL for (int j = 0; j < ROWS; j++) {
        float less[2], more[2];
        UNROLL for (int i = 0; i < 2; i++) {
            const float lower = across_at(one, by.stride, j + 1, i),
                        lower_after = across_at(other, by.stride, j + 1, i);
            const float a = upper[i] + one.down * (lower - upper[i]);
            const float b = upper_after[i] + other.down * (lower_after - upper_after[i]);
            less[i] = a - b;
            more[i] = a + b;
            upper[i] = lower;
            upper_after[i] = lower_after;
        }
        const float across = less[1] - less[0], along = more[1] - more[0];
        const float down = j ? less[0] - apart : 0.0f, under = j ? more[0] - common : 0.0f;
        sums.x += across * across + down * down;
        sums.y += along * along + under * under;
        apart = less[0];
        common = more[0];
    }
    return {sum_of_eight(taper(threadIdx.x % 8) * sums.x),
            sum_of_eight(taper(threadIdx.x % 8) * sums.y)};
}

FN bool is_still(const Path& path) {
    return fmaxf(fmaxf(fabsf(path.ax), fabsf(path.ay)), fmaxf(fabsf(path.bx), fabsf(path.by)))
           < STILL;
}

// A toned picture between four pixels.
FN float value_at(const Toned& by, const float* toned, float y, float x) {
    y = fminf(fmaxf(y, -1.0f), float(by.h));
    x = fminf(fmaxf(x, -1.0f), float(by.w));
    const float j = floorf(y), i = floorf(x), down = y - j, across = x - i;
    const float* const at = toned + (int(j) + MARGIN) * by.stride + int(i) + MARGIN;
    const float upper = at[0] + across * (at[1] - at[0]);
    return upper + down * (at[by.stride] + across * (at[by.stride + 1] - at[by.stride]) - upper);
}

FN float difference(const Toned& by, float y, float x, const Path& path) {
    return fabsf(value_at(by, by.before, y + path.ay, x + path.ax)
                 - value_at(by, by.after, y + path.by, x + path.bx));
}

FN float contrast(const Toned& by, float y, float x, const Path& path, const Path& other) {
    return fminf(fabsf(value_at(by, by.before, y + path.ay, x + path.ax)
                       - value_at(by, by.before, y + other.ay, x + other.ax)),
                 fabsf(value_at(by, by.after, y + path.by, x + path.bx)
                       - value_at(by, by.after, y + other.by, x + other.bx)));
}

// Misfit of one of 4x4 cells of the frame after (rows / 4, columns / 4, 1) that the frame before
// shows too, else -1.
extern "C" __global__ void interpolate_misfits(View before, View after, View ends, View seen,
                                               View scale, View found) {
    const int y = blockIdx.y, x = 32 * blockIdx.x + threadIdx.x / 8;
    if (x >= found.size[1]) return;
    const int cell = (4 * y + 2) * seen.size[1] + 4 * x + 2;
    const float size = scale.at[0], middle = 0.5f * (size - 1.0f);
    const Four end = four(ends, cell);
    const Path path = {size * end.x, size * end.y, size * end.z, size * end.w, 1.0f, 1.0f};
    const float fit = misfit(toned_of(before, after), size * (4 * y + 2) + middle,
                             size * (4 * x + 2) + middle, path);
    if (threadIdx.x % 8 == 0) found.at[y * found.size[1] + x] = seen.at[cell] > 0.0f ? fit : -1.0f;
}

// The median of misfits that are 0 or more, by a block: eleven bits by eleven, as positive floats
// have the order of whole numbers. The mean of the middle two if their count is even, 0 without
// any.
extern "C" __global__ void __launch_bounds__(1024) interpolate_noise(View found, View noise) {
    __shared__ int digits[2048], before[32], rank, above;
    __shared__ unsigned prefix;
    __shared__ bool is_twice;
    const int count = found.size[0] * found.size[1], own = 2 * threadIdx.x;
    int all = 0;
    for (int shift = 22; shift >= 0; shift -= 11) {
        digits[own] = digits[own + 1] = 0;
        __syncthreads();
        for (int k = threadIdx.x; k < count; k += blockDim.x) {
            // of a number below 0, the first bit is set
            const unsigned bits = __float_as_uint(found.at[k]);
            if (bits >> 31 == 0 && (shift == 22 || bits >> (shift + 11) == prefix))
                atomicAdd(&digits[bits >> shift & 2047], 1);
        }
        __syncthreads();
        // how many numbers have this digit or a lower one
        int up_to = digits[own] + digits[own + 1];
        for (int step = 1; step < 32; step *= 2) {
            const int lower = __shfl_up_sync(~0u, up_to, step);
            if (threadIdx.x % 32 >= step) up_to += lower;
        }
        if (threadIdx.x % 32 == 31) before[threadIdx.x / 32] = up_to;
        __syncthreads();
        int total = 0;
        for (int k = 0; k < 32; k++) {
            if (k < threadIdx.x / 32) up_to += before[k];
            total += before[k];
        }
        if (shift == 22) all = total;
        const int wanted = shift == 22 ? (all - 1) / 2 : rank,
                  first = up_to - digits[own + 1] - digits[own];
        __syncthreads();
        if (first <= wanted && wanted < up_to) {
            const int digit = wanted < first + digits[own] ? own : own + 1;
            prefix = (shift == 22 ? 0u : prefix << 11) | unsigned(digit);
            rank = wanted - first - (digit == own ? 0 : digits[own]);
            is_twice = rank + 1 < digits[digit];
        }
        __syncthreads();
    }
    const float low = all ? __int_as_float(int(prefix)) : 0.0f;
    if (threadIdx.x == 0) above = __float_as_int(LARGEST_FLOAT);
    __syncthreads();
    for (int k = threadIdx.x; k < count; k += blockDim.x)
        if (found.at[k] > low) atomicMin(&above, __float_as_int(found.at[k]));
    __syncthreads();
    if (threadIdx.x == 0)
        noise.at[0] = all % 2 || is_twice || !all ? low : 0.5f * (low + __int_as_float(above));
}

// Whether around a cell one frame is turned or stretched evenly against the other one, by much.
FN bool is_turning(const View& own, int y, int x, float size) {
    const int rows = own.size[0], columns = own.size[1], cell = y * columns + x;
    if (!(1 <= y && y < rows - 1 && 1 <= x && x < columns - 1)) return false;
    const Four here = four(own, 2 * cell);
    float most = 0.0f, uneven = 0.0f;
    for (int k = 0; k < 2; k++) {
        const int step = k ? columns : 1;
        const Four p = four(own, 2 * (cell - step)), q = four(own, 2 * (cell + step));
        most = fmaxf(most, fmaxf(fabsf(q.z - p.z - q.x + p.x), fabsf(q.w - p.w - q.y + p.y)));
        uneven = fmaxf(
            uneven,
            fmaxf(fmaxf(fabsf(p.x + q.x - 2.0f * here.x), fabsf(p.y + q.y - 2.0f * here.y)),
                  fmaxf(fabsf(p.z + q.z - 2.0f * here.z), fabsf(p.w + q.w - 2.0f * here.w))));
    }
    return 2.0f * TWIST * size < most && uneven < EVEN;
}

// Whether no path of both sides at a cell and at the four beside it differs from its own: known by
// how far they are from those cells' own ones.
FN bool is_alone(const View& own, int y, int x, const Path& mine) {
    const int rows = own.size[0], columns = own.size[1], cell = y * columns + x;
    const int beside[4] = {y > 0 ? cell - columns : cell, y < rows - 1 ? cell + columns : cell,
                           x > 0 ? cell - 1 : cell, x < columns - 1 ? cell + 1 : cell};
    float most = own.at[8 * size_t(cell) + 6];
    UNROLL for (int k = 0; k < 4; k++)
        most = fmaxf(most,
                     most_apart(path_of(own, beside[k]), mine) + own.at[8 * size_t(beside[k]) + 6]);
    return most <= 0.99f * OTHER;
}

// One of ten paths around a cell: those of both sides at it and at the four beside it. NaN without.
struct Tried {
    Path path;
    float depth;
};

FN Tried tried_at(const View& own, const View& sides, const View& depths, int cell, int k,
                  float size) {
    const int columns = own.size[1], y = cell / columns, x = cell - y * columns, step = k % 5,
              side = k / 5;
    const int j = y + (step == 2) - (step == 4), i = x + (step == 1) - (step == 3),
              there = j * columns + i;
    if (!(0 <= j && j < own.size[0] && 0 <= i && i < columns))
        return {{__int_as_float(0x7fc00000)}, FAR};
    const int seen = int(own.at[8 * size_t(there) + 7]);
    const Pair both = pair(depths, there);
    return {
        side_path(four(sides, 2 * size_t(there) + side), float(seen >> side & 1), side == 1, size),
        side ? both.y : both.x};
}

// The path of a cell, found by eight lanes: its own, or another one around it that fits much
// better.
FN Path chosen_at(const Toned& toned, const View& own, const View& sides, const View& depths,
                  int cell, float least, float size) {
    const int columns = own.size[1], y = cell / columns, x = cell - y * columns;
    const float middle = 0.5f * (size - 1.0f), v = size * y + middle, u = size * x + middle;
    const float unseen = UNSEEN + UNSEEN_NOISE * least;
    const Path mine = path_of(own, cell);
    Path taken = mine, tried = mine;
    const bool is_shown = mine.first + mine.last == 2.0f;
    const Pair both = pair(depths, cell);
    const float depth = fminf(both.x, both.y), better = is_still(mine) ? BETTER_STILL : BETTER;
    int others = 0;  // which of the ten lead elsewhere: each lane looks at one or two
    for (int k = threadIdx.x % 8; k < 10; k += 8) {
        const Path path = tried_at(own, sides, depths, cell, k, size).path;
        if (path.ax == path.ax && differ(path, mine, OTHER)) others |= 1 << k;
    }
    for (int mask = 4; mask; mask /= 2)
        others |= __shfl_xor_sync(0xffu << (threadIdx.x & 24), others, mask);
    bool is_seen = false;
    float best = -2.0f;  // not looked at yet: many cells have no other path around them
    for (int k = 0; k < 10; k++) {
        if (!(others >> k & 1)) continue;
        const Tried other = tried_at(own, sides, depths, cell, k, size);
        const Path& path = other.path;
        if (!(differ(path, taken, OTHER) && differ(path, tried, OTHER))) continue;
        tried = path;
        if (is_shown && depth < BEFORE * other.depth) {
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
    return taken;
}

// Cells that keep their own path, and a list of the others, as indices count[0] of them, which
// begins as 0.
extern "C" __global__ void __launch_bounds__(256)
    interpolate_list(View own, View scale, View count, View list, View cells) {
    __shared__ int listed[256], known, first;
    const int rows = own.size[0], columns = own.size[1];
    const int x = 32 * blockIdx.x + threadIdx.x % 32, y = 8 * blockIdx.y + threadIdx.x / 32,
              cell = y * columns + x;
    if (threadIdx.x == 0) known = 0;
    __syncthreads();
    if (y < rows && x < columns) {
        const Path mine = path_of(own, cell);
        // no window that is moved alone can fit what turns
        if (is_alone(own, y, x, mine)
            || (mine.first + mine.last == 2.0f && is_turning(own, y, x, scale.at[0])))
            put_path(cells, cell, mine);
        else
            listed[atomicAdd(&known, 1)] = cell;
    }
    __syncthreads();
    if (threadIdx.x == 0) first = atomicAdd(reinterpret_cast<int*>(count.at), known);
    __syncthreads();
    if (int(threadIdx.x) < known)
        reinterpret_cast<int*>(list.at)[first + threadIdx.x] = listed[threadIdx.x];
}

// The paths of the listed cells.
extern "C" __global__ void __launch_bounds__(256)
    interpolate_choose(View before, View after, View own, View sides, View depths, View noise,
                       View scale, View count, View list, View cells) {
    const Toned toned = toned_of(before, after);
    const int all = *reinterpret_cast<const int*>(count.at), groups = blockDim.x / 8;
    for (int k = groups * blockIdx.y + threadIdx.x / 8; k < all; k += groups * gridDim.y) {
        const int cell = reinterpret_cast<const int*>(list.at)[k];
        const Path path = chosen_at(toned, own, sides, depths, cell, noise.at[0], scale.at[0]);
        if (threadIdx.x % 8 == 0) put_path(cells, cell, path);
    }
}

// Share of what two pictures show around the places of a path that both show (Wiener).
FN float sharpness(const Toned& by, float y, float x, const Path& path, float noise) {
    if (!(is_inside(by.h, by.w, y + path.ay, x + path.ax)
          && is_inside(by.h, by.w, y + path.by, x + path.bx)))
        return 1.0f;
    const Pair sums = window_detail(by, window_at(by.before, by.stride, y + path.ay, x + path.ax),
                                    window_at(by.after, by.stride, y + path.by, x + path.bx));
    const float apart = fminf(sums.x, MOST_NOISE * noise * noise * SLOPES);
    const float share = sums.y > 0.0f ? fmaxf(1.0f - apart / sums.y, 0.0f) : 1.0f;
    return share > MOSTLY && is_still(path) ? 1.0f : share;
}

// The same over 8x6 places whose paths change from place to place as from a cell to the next ones.
FN float turned_sharpness(const Toned& by, float y, float x, const View& cells, int cell,
                          float scale, float noise) {
    const int columns = cells.size[1], i = threadIdx.x % 8;
    const Four p = four(cells, 2 * cell), q = four(cells, 2 * (cell + 1)),
               r = four(cells, 2 * (cell + columns));
    const float size = 1.0f / scale, across = (i - 3.5f) * size, u = x + (i - 3.5f);
    float apart = 0.0f, common = 0.0f, above = 0.0f, above_after = 0.0f;
    for (int j = 0; j <= ROWS; j++) {
        const float v = y + (j - 0.5f * ROWS), down = (j - 0.5f * ROWS) * size;
        const float ax = p.x + across * (q.x - p.x) + down * (r.x - p.x);
        const float ay = p.y + across * (q.y - p.y) + down * (r.y - p.y);
        const float bx = p.z + across * (q.z - p.z) + down * (r.z - p.z);
        const float by_ = p.w + across * (q.w - p.w) + down * (r.w - p.w);
        const float one = value_at(by, by.before, v + ay, u + ax),
                    other = value_at(by, by.after, v + by_, u + bx);
        const float left = left_lane(one), left_after = left_lane(other);
        if (i && j) {
            const float right = one - left, right_after = other - left_after;
            const float under = one - above, under_after = other - above_after;
            apart += (right - right_after) * (right - right_after)
                     + (under - under_after) * (under - under_after);
            common += (right + right_after) * (right + right_after)
                      + (under + under_after) * (under + under_after);
        }
        above = one;
        above_after = other;
    }
    apart = fminf(sum_of_eight(apart), MOST_NOISE * noise * noise * SLOPES);
    common = sum_of_eight(common);
    return common > 0.0f ? fmaxf(1.0f - apart / common, 0.0f) : 1.0f;
}

// Whether from a cell to the one (j, i) on a path's number changes about as much as to the next
// one, or from the last.
FN bool is_line(const View& cells, int y, int x, int j, int i, int c) {
    const int rows = cells.size[0], columns = cells.size[1];
    const float* const at = cells.at + c;
    const float here = at[8 * (y * columns + x)], next = at[8 * ((y + j) * columns + x + i)];
    const float step = next - here,
                last = step - here + at[8 * (max(y - j, 0) * columns + max(x - i, 0))];
    const float coming = at[8 * (min(y + 2 * j, rows - 1) * columns + min(x + 2 * i, columns - 1))]
                         - next - step;
    return fminf(fabsf(last), fabsf(coming)) <= SMOOTH;
}

// 1 for cells that follow one path with those to the right and below, 2 where it changes evenly,
// else 0.
FN int joined_at(const View& cells, int y, int x) {
    const int rows = cells.size[0], columns = cells.size[1], cell = y * columns + x;
    const int j = min(y + 1, rows - 1) - y, i = min(x + 1, columns - 1) - x;
    const Path own = path_of(cells, cell), right = path_of(cells, cell + i),
               low = path_of(cells, cell + j * columns);
    const Path beyond = path_of(cells, cell + j * columns + i);
    if (!(own.first == right.first && own.last == right.last && own.first == low.first
          && own.last == low.last && own.first == beyond.first && own.last == beyond.last))
        return 0;
    if (!(differ(own, right, JOINED) || differ(own, low, JOINED) || differ(own, beyond, JOINED)))
        return 1;
    if (differ(own, right, TURNING) || differ(own, low, TURNING) || differ(own, beyond, TURNING))
        return 0;
    if (!(fabsf(own.ax - right.ax - low.ax + beyond.ax) <= SMOOTH
          && fabsf(own.ay - right.ay - low.ay + beyond.ay) <= SMOOTH
          && fabsf(own.bx - right.bx - low.bx + beyond.bx) <= SMOOTH
          && fabsf(own.by - right.by - low.by + beyond.by) <= SMOOTH))
        return 0;
    for (int c = 0; c < 4; c++)
        if (!(is_line(cells, y, x, 0, i, c) && is_line(cells, y, x, j, 0, c)
              && is_line(cells, y + j, x, 0, i, c) && is_line(cells, y, x + i, j, 0, c)))
            return 0;
    return 2;
}

// How sharp the pictures are at cells, written to their seventh number: once for two by two that
// follow one path; and how they are joined, to the eighth one. A block lists the windows that its
// 32x8 cells need.
extern "C" __global__ void __launch_bounds__(256)
    interpolate_detail(View before, View after, View noise, View scale, View cells) {
    __shared__ int listed[256], count;
    const int rows = cells.size[0], columns = cells.size[1];
    const int x = 32 * blockIdx.x + threadIdx.x % 32, y = 8 * blockIdx.y + threadIdx.x / 32,
              cell = y * columns + x;
    if (threadIdx.x == 0) count = 0;
    __syncthreads();
    if (y < rows && x < columns) {
        const int joined = joined_at(cells, y, x), leader = (y - y % 2) * columns + x - x % 2;
        const Path path = path_of(cells, cell), one = path_of(cells, leader);
        cells.at[8 * size_t(cell) + 7] = float(joined);
        // else its leader writes to it, too
        if (cell == leader || differ(path, one, OTHER)
            || path.first + path.last != one.first + one.last)
            listed[atomicAdd(&count, 1)] = 2 * cell
                                           + (joined == 2 && y < rows - 1 && x < columns - 1);
    }
    __syncthreads();
    const Toned toned = toned_of(before, after);
    const float size = scale.at[0], middle = 0.5f * (size - 1.0f);
    for (int k = threadIdx.x / 8; k < count; k += 32) {
        const int own = listed[k] / 2, j = own / columns, i = own - j * columns,
                  lane = threadIdx.x % 8;
        const bool is_leader = j % 2 == 0 && i % 2 == 0, is_turned = listed[k] % 2;
        const Path path = path_of(cells, own);
        const float at = is_leader && !is_turned ? size - 0.5f : middle;
        const float share = path.first + path.last < 2.0f ? 1.0f
                            : is_turned
                                ? turned_sharpness(toned, size * j + at, size * i + at, cells, own,
                                                   size, noise.at[0])
                                : sharpness(toned, size * j + at, size * i + at, path, noise.at[0]);
        if (lane >= (is_leader ? 4 : 1) || j + lane / 2 >= rows || i + lane % 2 >= columns)
            continue;
        const int other = own + lane / 2 * columns + lane % 2;
        const Path its = path_of(cells, other);
        if (!differ(its, path, OTHER) && its.first + its.last == path.first + path.last)
            cells.at[8 * size_t(other) + 6] = share;
    }
}

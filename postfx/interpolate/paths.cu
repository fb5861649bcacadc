// Paths of cells (rows, columns), as paths.py makes them. Cells are those of the frames' planes of
// motion.

// Motion (rows, columns, 2), in cells, and depth (rows, columns, 1) of cells of scale[0] x scale[0]
// pixels: means of those of the nearest surface: motion (h, w, 2), depth (h, w, 1).
extern "C" __global__ void interpolate_gather(View motion, View depth, View scale, View cells,
                                              View keys, View cell_depth) {
    const int rows = cell_depth.size[0], columns = cell_depth.size[1], h = depth.size[0],
              w = depth.size[1];
    PIXEL(columns, rows);
    const int size = int(scale.at[0]), most = 4 * max(h, w);
    const int top = y * size, low = min(top + size - 1, h - 1), left = x * size,
              right = min(left + size - 1, w - 1);
    const size_t at[4] = {size_t(top) * w + left, size_t(top) * w + right, size_t(low) * w + left,
                          size_t(low) * w + right};
    float z[4], nearest = DEPTH_MISS, u = 0.0f, v = 0.0f, count = 0.0f;
    for (int k = 0; k < 4; k++) {
        z[k] = depth.at[at[k]];
        z[k] = z[k] < DEPTH_MISS ? z[k] : DEPTH_MISS;  // NaN, too
        nearest = fminf(nearest, z[k]);
    }
    nearest = fmaxf(nearest, 1e-6f);
    for (int k = 0; k < 4; k++) {
        const Pair by = pair(motion, at[k]);
        if (fabsf(by.x) <= most && fabsf(by.y) <= most && z[k] <= nearest * (1.0f + ALIKE)) {
            u += by.x;
            v += by.y;
            count += 1.0f;
        }
    }
    const size_t cell = size_t(y) * columns + x;
    const float share = 1.0f / (count * size);  // of none, motion is 0 times infinity, NaN
    pair(cells, cell) = {u * share, v * share};
    cell_depth.at[cell] = nearest;
    reinterpret_cast<unsigned long long*>(keys.at)[cell] = ~0ULL;
}

// What arrives at each cell from the frame after, whose motion is (rows, columns, 2): keys (rows,
// columns, 2) of depth and index, so that the nearest wins, and the first of equal ones.
// `interpolate_gather` forgets those before.
extern "C" __global__ void interpolate_arrive(View motion, View depth, View keys) {
    const int rows = keys.size[0], columns = keys.size[1];
    PIXEL(columns, rows);
    const int cell = y * columns + x;
    const Pair by = pair(motion, cell);
    const float u = x + 0.5f + by.x, v = y + 0.5f + by.y;
    if (!(0.0f <= u && u < columns && 0.0f <= v && v < rows)) return;  // NaN, too
    const unsigned long long front = __float_as_uint(depth.at[cell]);
    atomicMin(reinterpret_cast<unsigned long long*>(keys.at) + int(v) * columns + int(u),
              front << 32 | unsigned(cell));
}

FN Pair led_to(const View& keys, const View& motion, int cell) {
    const unsigned long long key = reinterpret_cast<const unsigned long long*>(keys.at)[cell];
    if (key == ~0ULL) return {LOST, LOST};
    const Pair by = pair(motion, unsigned(key));
    return {-by.x, -by.y};
}

// Whether motion around a place changes from cell to cell by so much that it matters where it is
// taken.
FN bool is_sloping(const View& motion, float v, float u) {
    const int h = motion.size[0], w = motion.size[1];
    if (!(u >= 0.0f && v >= 0.0f && u < float(w - 1) && v < float(h - 1))) return false;
    const int at = int(v) * w + int(u);
    const Pair p = pair(motion, at), q = pair(motion, at + 1), r = pair(motion, at + w),
               s = pair(motion, at + w + 1);
    return fmaxf(fabsf(p.x - s.x), fabsf(p.y - s.y)) > EXACT
           || fmaxf(fabsf(q.x - r.x), fabsf(q.y - r.y)) > EXACT;
}

// Whether motion goes on evenly between the four cells around a place, the motion there, and its
// slopes.
struct Sloped {
    bool is_even;
    float x, y, right, across, down, under;
};

FN Sloped sample_two(const View& motion, float v, float u) {
    const int h = motion.size[0], w = motion.size[1];
    if (!(u >= 0.0f && v >= 0.0f && u < float(w - 1) && v < float(h - 1))) return {};
    const int j = int(v), i = int(u), at = j * w + i;
    const float y = v - j, x = u - i;
    const Pair p = pair(motion, at), q = pair(motion, at + 1), r = pair(motion, at + w),
               s = pair(motion, at + w + 1);
    const float most = fmaxf(
        fmaxf(fmaxf(fabsf(q.x - p.x), fabsf(s.x - r.x)), fmaxf(fabsf(r.x - p.x), fabsf(s.x - q.x))),
        fmaxf(fmaxf(fabsf(q.y - p.y), fabsf(s.y - r.y)),
              fmaxf(fabsf(r.y - p.y), fabsf(s.y - q.y))));
    const float down = r.x - p.x + x * (s.x - r.x - q.x + p.x),
                under = r.y - p.y + x * (s.y - r.y - q.y + p.y);
    // a NaN among them is not uneven motion, but none
    const bool is_even = most <= 1.0f && p.x + q.x + r.x + s.x == p.x + q.x + r.x + s.x;
    return {is_even,
            p.x + x * (q.x - p.x) + y * down,
            p.y + x * (q.y - p.y) + y * under,
            q.x - p.x + y * (s.x - r.x - q.x + p.x),
            q.y - p.y + y * (s.y - r.y - q.y + p.y),
            down,
            under};
}

// Motion of the frame before to the one after (rows, columns, 2): what arrived, cracks of one cell
// filled from the neighbour whose depth (rows, columns, 1) is most alike; LOST elsewhere.
FN bool fills(const View& depth, int y, int x, float own, Pair found, float& best) {
    const float unlike = fabsf(depth.at[y * depth.size[1] + x] / own - 1.0f);
    if (!(found.x < LOST && unlike < best)) return false;
    best = unlike;
    return true;
}

extern "C" __global__ void interpolate_invert(View keys, View motion, View depth, View inverse) {
    const int rows = keys.size[0], columns = keys.size[1];
    PIXEL(columns, rows);
    const int cell = y * columns + x;
    Pair own = led_to(keys, motion, cell);
    if (own.x >= LOST) {
        float best = SIMILAR;
        for (int j = max(0, y - 1); j < min(rows, y + 2); j++) {
            for (int i = max(0, x - 1); i < min(columns, x + 2); i++) {
                const Pair found = led_to(keys, motion, j * columns + i);
                if (fills(depth, j, i, depth.at[cell], found, best)) own = found;
            }
        }
    }
    pair(inverse, cell) = own;
}

// The same once more, and led to the places between cells whose motion leads back, by a step of
// Newton's method.
extern "C" __global__ void interpolate_refine(View inverse, View motion, View depth, View ahead) {
    const int rows = inverse.size[0], columns = inverse.size[1];
    PIXEL(columns, rows);
    const int cell = y * columns + x;
    Pair own = pair(inverse, cell);
    if (own.x >= LOST) {
        float best = SIMILAR;
        for (int j = max(0, y - 1); j < min(rows, y + 2); j++) {
            for (int i = max(0, x - 1); i < min(columns, x + 2); i++) {
                const Pair found = pair(inverse, j * columns + i);
                if (fills(depth, j, i, depth.at[cell], found, best)) own = found;
            }
        }
    }
    if (is_sloping(motion, y + own.y, x + own.x)) {
        const Sloped there = sample_two(motion, y + own.y, x + own.x);
        const float dx = own.x + there.x, dy = own.y + there.y, most = fmaxf(fabsf(dx), fabsf(dy));
        const float a = 1.0f + there.right, d = 1.0f + there.under,
                    area = a * d - there.down * there.across;
        if (there.is_even && EXACT < most && most <= 1.0f && fabsf(area) > 0.2f)
            own = {own.x - (d * dx - there.down * dy) / area,
                   own.y - (a * dy - there.across * dx) / area};
    }
    pair(ahead, cell) = own;
}

// Whether one of the four cells around a place, where a motion led, shows something nearer that
// does not lead back.
FN bool is_touched(const View& back, const View& depth, float v, float u, Pair by, float z) {
    const int h = depth.size[0], w = depth.size[1], j = int(floorf(v)), i = int(floorf(u));
    for (int b = max(j, 0); b < min(j + 2, h); b++) {
        for (int a = max(i, 0); a < min(i + 2, w); a++) {
            const Pair found = pair(back, b * w + a);
            const bool leads_back = fabsf(found.x + by.x) <= SEEN && fabsf(found.y + by.y) <= SEEN;
            if (depth.at[b * w + a] < COVERS * z && !leads_back) return true;
        }
    }
    return false;
}

FN float swing_of(float cosine) {
    const float half = sqrtf(0.5f + 0.5f * fminf(fmaxf(cosine, LEAST_COSINE), 1.0f));
    return 2.0f / ((1.0f + half) * half);
}

// Paths of the frame after: ends (rows, columns, 4), bend (rows, columns, 2), seen (rows, columns,
// 1). facts: whether the motion `came` of the frame before is known, and what jitters of both
// frames add to the ends.
extern "C" __global__ void interpolate_lead_back(View motion, View ahead, View depth_before,
                                                 View depth_after, View came, View facts, View ends,
                                                 View bend, View seen) {
    const int h = seen.size[0], w = seen.size[1];
    PIXEL(w, h);
    const int cell = y * w + x;
    const Pair by = pair(motion, cell);
    const float u = x + by.x + 0.5f, v = y + by.y + 0.5f;
    Pair bent = {0.0f, 0.0f};
    bool is_seen = false;
    if (0.0f <= u && u < w && 0.0f <= v && v < h) {
        const int there = int(v) * w + int(u);
        const Pair back = pair(ahead, there);
        const bool same = fabsf(back.x + by.x) <= SEEN && fabsf(back.y + by.y) <= SEEN;
        is_seen = same
                  && !is_touched(ahead, depth_before, v - 0.5f, u - 0.5f, by, depth_after.at[cell]);
        if (facts.at[0] > 0.0f && same) {
            Pair c = pair(came, there);
            if (is_sloping(came, v - 0.5f, u - 0.5f)) {
                const Sloped found = sample_two(came, v - 0.5f, u - 0.5f);
                if (found.is_even) c = {found.x, found.y};
            }
            // where it is what this motion becomes if all goes round one point, so is the motion
            // ahead
            const Sloped own = sample_two(motion, float(y), float(x));
            const float a = 1.0f + own.right, d = 1.0f + own.under,
                        area = a * d - own.down * own.across;
            float bx = c.x - by.x, by_ = c.y - by.y, ax = 0.0f, ay = 0.0f;
            int count = 1;
            if (own.is_even && area > 0.5f) {
                const Pair p = {a * by.x + own.down * by.y, own.across * by.x + d * by.y};
                const Pair q = {(own.down * by.y - d * by.x) / area,
                                (own.across * by.x - a * by.y) / area};
                if (fmaxf(fabsf(c.x - p.x), fabsf(c.y - p.y))
                    <= ROUNDLY * fmaxf(fabsf(by.x), fabsf(by.y))) {
                    count = 2;
                    bx = p.x - by.x, by_ = p.y - by.y;
                    ax = q.x + by.x - bx, ay = q.y + by.y - by_;
                    bx += q.x + by.x, by_ += q.y + by.y;
                }
            }
            const float size = fabsf(bx) + fabsf(by_), length = by.x * by.x + by.y * by.y;
            const bool is_round = count == 2 && fabsf(ax) + fabsf(ay) <= ROUND * size;
            if (is_round || size <= SPRUNG * (fabsf(by.x) + fabsf(by.y)) * count) {
                float share = 0.5f / count;
                if (count == 2 && length > 1.0f)
                    share *= swing_of(1.0f - (ax * by.x + ay * by.y) / (2.0f * length));
                bent = {share * bx, share * by_};
            }
        }
    }
    const float* const jitter = facts.at + 1;
    four(ends, cell) = {by.x + jitter[0], by.y + jitter[1], jitter[2], jitter[3]};
    pair(bend, cell) = bent;
    seen.at[cell] = is_seen;
}

// Paths of the frame before: to where the frame after shows the point, or straight on.
extern "C" __global__ void interpolate_lead_ahead(View ahead, View motion, View depth_before,
                                                  View depth_after, View came, View facts,
                                                  View bend_after, View ends, View bend,
                                                  View seen) {
    const int h = seen.size[0], w = seen.size[1];
    PIXEL(w, h);
    const int cell = y * w + x;
    Pair by = pair(ahead, cell), bent = {0.0f, 0.0f};
    bool is_seen = false;
    if (by.x < LOST) {
        const int there = clip(int(y + by.y + 0.5f), h) * w + clip(int(x + by.x + 0.5f), w);
        const Pair back = pair(motion, there);
        if (fabsf(back.x + by.x) <= SEEN && fabsf(back.y + by.y) <= SEEN) {  // else a filled crack
            bent = pair(bend_after, there);
            if (is_sloping(bend_after, y + by.y, x + by.x)) {
                const Sloped found = sample_two(bend_after, y + by.y, x + by.x);
                if (found.is_even) bent = {found.x, found.y};
            }
            is_seen = !is_touched(motion, depth_after, y + by.y, x + by.x, by,
                                  depth_before.at[cell]);
        }
    } else {
        const Pair on = pair(came, cell);
        by = facts.at[0] > 0.0f ? Pair{-on.x, -on.y}
                                : Pair{__int_as_float(0x7fc00000), __int_as_float(0x7fc00000)};
    }
    const float* const jitter = facts.at + 1;
    four(ends, cell) = {jitter[0], jitter[1], by.x + jitter[2], by.y + jitter[3]};
    pair(bend, cell) = bent;
    seen.at[cell] = is_seen;
}

// What arrives at each cell at time[0], of both frames' paths, one below the other: least depth (2
// rows, columns, 1), then sums (2 rows, columns, 8) of the nearest surface's paths: to both frames,
// seen, weight. They begin as FAR and 0, as does the count of cells for which a path is chosen.
extern "C" __global__ void interpolate_clear(View nearest, View count, View sums) {
    PIXEL(sums.size[1], sums.size[0]);
    if (x + y == 0) count.at[0] = 0.0f;
    const size_t cell = size_t(y) * sums.size[1] + x;
    nearest.at[cell] = FAR;
    four(sums, 2 * cell) = four(sums, 2 * cell + 1) = {0.0f, 0.0f, 0.0f, 0.0f};
}

// Neighbouring floats added in one transfer where a GPU can do that.
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
FN void add_four(float* to, float x, float y, float z, float w) {
    asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(to), "f"(x), "f"(y), "f"(z),
                 "f"(w)
                 : "memory");
}

FN void add_two(float* to, float x, float y) {
    asm volatile("red.global.add.v2.f32 [%0], {%1, %2};" ::"l"(to), "f"(x), "f"(y) : "memory");
}
#else
FN void add_two(float* to, float x, float y) {
    atomicAdd(to, x);
    atomicAdd(to + 1, y);
}

FN void add_four(float* to, float x, float y, float z, float w) {
    add_two(to, x, y);
    add_two(to + 2, z, w);
}
#endif

// Where a path is at a time, from its cell.
FN Pair way_at(const Four& end, const Pair& bent, float t) {
    const float s = t * (t - 1.0f);
    return {end.x + t * (end.z - end.x) + s * bent.x, end.y + t * (end.w - end.y) + s * bent.y};
}

// One of two tensors of the same size.
FN View one_of(const View& first, const View& second, bool is_second) {
    return {is_second ? second.at : first.at, {first.size[0], first.size[1]}};
}

extern "C" __global__ void interpolate_nearest(View ends_before, View bend_before,
                                               View depth_before, View ends_after, View bend_after,
                                               View depth_after, View time, View nearest) {
    const int h = depth_before.size[0], w = nearest.size[1];
    PIXEL(w, 2 * h);
    const bool is_after = y >= h;
    const int top = is_after ? h : 0, row = y - top, cell = row * w + x;
    const Pair by = way_at(four(one_of(ends_before, ends_after, is_after), cell),
                           pair(one_of(bend_before, bend_after, is_after), cell), time.at[0]);
    const float u = x + 0.5f + by.x, v = row + 0.5f + by.y;
    if (!(0.0f <= u && u < w && 0.0f <= v && v < h)) return;
    // as whole numbers, positive floats have the same order
    atomicMin(reinterpret_cast<int*>(nearest.at) + (top + int(v)) * w + int(u),
              __float_as_int(one_of(depth_before, depth_after, is_after).at[cell]));
}

// Sums of what arrives at a cell.
struct Arriving {
    float ax, ay, bx, by, seen, weight;
};

FN void add_more(Arriving& sum, const Arriving& path, float weight) {
    sum.ax += weight * path.ax;
    sum.ay += weight * path.ay;
    sum.bx += weight * path.bx;
    sum.by += weight * path.by;
    sum.seen += weight * path.seen;
    sum.weight += weight;
}

FN Arriving both_of(const Arriving& one, const Arriving& other) {
    return {one.ax + other.ax, one.ay + other.ay,     one.bx + other.bx,
            one.by + other.by, one.seen + other.seen, one.weight + other.weight};
}

FN void put_down(const View& sums, int cell, const Arriving& sum) {
    if (!(sum.weight > 0.0f)) return;
    add_four(sums.at + 8 * size_t(cell), sum.ax, sum.ay, sum.bx, sum.by);
    add_two(sums.at + 8 * size_t(cell) + 4, sum.seen, sum.weight);
}

// What neighbours bring to one cell is summed up before: a warp makes 32 columns of STEPS_DOWN
// rows, downwards.
const int STEPS_DOWN = 2;

extern "C" __global__ void __launch_bounds__(256)
    interpolate_means(View ends_before, View bend_before, View depth_before, View seen_before,
                      View ends_after, View bend_after, View depth_after, View seen_after,
                      View time, View nearest, View sums) {
    const int h = depth_before.size[0], w = nearest.size[1], lane = threadIdx.x % 32,
              x = 32 * blockIdx.x + lane;
    const int strips = (h + STEPS_DOWN - 1) / STEPS_DOWN, strip = 8 * blockIdx.y + threadIdx.x / 32;
    const bool is_after = strip >= strips;
    const int top = is_after ? h : 0, from = STEPS_DOWN * (is_after ? strip - strips : strip);
    if (from >= h) return;  // a whole warp
    const View ends = one_of(ends_before, ends_after, is_after),
               bends = one_of(bend_before, bend_after, is_after);
    const View depth = one_of(depth_before, depth_after, is_after),
               seen = one_of(seen_before, seen_after, is_after);
    const float t = time.at[0];
    Arriving below = {};
    int place_below = -1;
    UNROLL for (int step = 0; step < STEPS_DOWN; step++) {
        const int y = from + step, cell = y * w + x;
        Arriving path = {};
        float weights[4] = {0.0f, 0.0f, 0.0f, 0.0f};
        int place = -2 * w * h - 2;  // of the cell before; it may lie outside
        if (y < h && x < w) {
            const Four end = four(ends, cell);
            const Pair by = way_at(end, pair(bends, cell), t);
            const float u = x + by.x, v = y + by.y, z = depth.at[cell];
            if (u > -1.0f && v > -1.0f && u < float(w) && v < float(h)) {
                const int i = int(floorf(u)), j = int(floorf(v));
                path = {end.x - by.x, end.y - by.y,  end.z - by.x,
                        end.w - by.y, seen.at[cell], 1.0f};
                place = (top + j) * w + i;
                UNROLL for (int k = 0; k < 4; k++) {
                    const int b = j + k / 2, a = i + k % 2;
                    if (b < 0 || b >= h || a < 0 || a >= w) continue;
                    const float front = nearest.at[(top + b) * w + a];
                    if (fabsf(z - front) <= ALIKE * front)
                        weights[k] = (1.0f - fabsf(u - a)) * (1.0f - fabsf(v - b));
                }
            }
        }
        const int place_left = __shfl_up_sync(~0u, place, 1);
        const Arriving left = {__shfl_up_sync(~0u, path.ax, 1), __shfl_up_sync(~0u, path.ay, 1),
                               __shfl_up_sync(~0u, path.bx, 1), __shfl_up_sync(~0u, path.by, 1),
                               __shfl_up_sync(~0u, path.seen, 1), 1.0f};
        const float upper_left = __shfl_up_sync(~0u, weights[1], 1),
                    lower_left = __shfl_up_sync(~0u, weights[3], 1);
        const int takes = lane > 0 && place_left + 1 == place,
                  is_taken = __shfl_down_sync(~0u, takes, 1);
        Arriving upper = {}, lower = {};
        add_more(upper, path, weights[0]);
        add_more(lower, path, weights[2]);
        if (takes) {
            add_more(upper, left, upper_left);
            add_more(lower, left, lower_left);
        }
        if (lane == 31 || !is_taken) {
            Arriving beside = {}, beyond = {};
            add_more(beside, path, weights[1]);
            add_more(beyond, path, weights[3]);
            put_down(sums, place + 1, beside);
            put_down(sums, place + 1 + w, beyond);
        }
        if (place == place_below)
            upper = both_of(upper, below);
        else
            put_down(sums, place_below, below);
        put_down(sums, place, upper);
        below = lower;
        place_below = place + w;
    }
    put_down(sums, place_below, below);
}

// What arrived at a cell of one side: the mean path to both frames, in cells, its share that is
// seen, and its depth. Where nothing arrived it is that of two neighbours on opposite sides, or NaN
// and FAR.
struct Arrived {
    Four path;
    float seen, depth;
};

FN Arrived mean_of(const View& sums, int cell, float depth) {
    const Four p = four(sums, 2 * size_t(cell)), q = four(sums, 2 * size_t(cell) + 1);
    return {{p.x / q.y, p.y / q.y, p.z / q.y, p.w / q.y}, q.x / q.y, depth};
}

// Of both sides one lies below the other, from a row on.
FN Arrived arrived_at(const View& nearest, const View& sums, int top, int y, int x, int h) {
    const int w = nearest.size[1], cell = (top + y) * w + x;
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
        found = {{0.5f * (p.path.x + q.path.x), 0.5f * (p.path.y + q.path.y),
                  0.5f * (p.path.z + q.path.z), 0.5f * (p.path.w + q.path.w)},
                 0.5f * (p.seen + q.seen),
                 0.5f * (one + other)};
    }
    return found;
}

// The same without jitter.
FN Arrived without_jitter(Arrived found, const View& facts) {
    const float* const shift = facts.at + 5;  // what jitters of both frames take off again
    found.path = {found.path.x - shift[0], found.path.y - shift[1], found.path.z - shift[2],
                  found.path.w - shift[3]};
    return found;
}

// What arrived of both sides: paths (rows, columns, 8) and depths (rows, columns, 2). Of that,
// `own` has at each cell the nearer path, or their mean where they are alike; NaN without. Its
// seventh number is how many pixels the sides' paths differ from it, the eighth which of them, 1
// and 2, the other frame shows, too.
extern "C" __global__ void interpolate_merge(View nearest, View sums, View facts, View scale,
                                             View sides, View depths, View own) {
    PIXEL(own.size[1], own.size[0]);
    const int rows = own.size[0];
    const Arrived before = without_jitter(arrived_at(nearest, sums, 0, y, x, rows), facts);
    const Arrived after = without_jitter(arrived_at(nearest, sums, rows, y, x, rows), facts);
    const size_t cell = size_t(y) * own.size[1] + x;
    four(sides, 2 * cell) = before.path;
    four(sides, 2 * cell + 1) = after.path;
    const float a = before.depth, b = after.depth;
    pair(depths, cell) = {a, b};
    const Path one = side_path(before.path, before.seen >= SURE, false, scale.at[0]);
    const Path other = side_path(after.path, after.seen >= SURE, true, scale.at[0]);
    Path merged = a < b ? one : other;
    if (a < FAR && b < FAR && fabsf(a - b) <= 1.5f * ALIKE * fminf(a, b)) {
        const bool is_any = other.first + one.last > 0.0f;
        merged = {0.5f * (one.ax + other.ax),  0.5f * (one.ay + other.ay),
                  0.5f * (one.bx + other.bx),  0.5f * (one.by + other.by),
                  is_any ? other.first : 1.0f, is_any ? one.last : 1.0f};
    }
    const float apart = fmaxf(a < FAR ? most_apart(one, merged) : 0.0f,
                              b < FAR ? most_apart(other, merged) : 0.0f);
    four(own, 2 * cell) = {merged.ax, merged.ay, merged.bx, merged.by};
    four(own, 2 * cell + 1) = {merged.first, merged.last, apart, one.last + 2.0f * other.first};
}

FN float front_of(const View& depths, int cell) {
    const Pair both = pair(depths, cell);
    return fminf(both.x, both.y);
}

// Cells without a path get that of the farthest of the next ones above, below, to the left and to
// the right.
extern "C" __global__ void interpolate_fill(View depths, View own) {
    const int rows = own.size[0], columns = own.size[1];
    PIXEL(columns, rows);
    const int cell = y * columns + x, steps[4] = {-columns, columns, -1, 1};
    const int counts[4] = {y, rows - 1 - y, x, columns - 1 - x};
    if (front_of(depths, cell) < FAR) return;
    int source = -1;
    float farthest = -1.0f;
    for (int turn = 0; turn < 4; turn++) {
        int at = cell;
        for (int k = 0; k < counts[turn]; k++) {
            at += steps[turn];
            const float depth = front_of(depths, at);
            if (!(depth < FAR)) continue;
            if (depth > farthest) farthest = depth, source = at;
            break;
        }
    }
    put_path(own, cell,
             source < 0 ? Path{0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 1.0f} : path_of(own, source));
}

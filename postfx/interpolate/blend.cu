// The picture that the paths make, as blend.py makes it. Pictures and their depth are held as
// (h, w, 4), cells are (rows, columns, 8).

// A path, and how sharp the pictures are there.
struct Led {
    Path path;
    float sharp;
};

FN Led cell_of(const View& cells, int cell) {
    return {path_of(cells, cell), cells.at[8 * size_t(cell) + 6]};
}

// The pixel before a place, which is held in the picture, and how far after it the place lies.
struct Corner {
    int j, i;
    float down, across;
};

FN Corner corner_of(float y, float x, int h, int w) {
    y = fminf(fmaxf(y, 0.0f), float(h - 1));
    x = fminf(fmaxf(x, 0.0f), float(w - 1));
    const int j = int(y), i = int(x);
    return {j, i, y - j, x - i};
}

// Weights of four taps around a place after the second one: cubics where sharp is 1, B-splines
// where it is 0.
FN Four taps_at(float t, float sharp) {
    const float k = 1.0f - sharp;
    const float squares_soft[4] = {0.5f, -1.0f, 0.5f, 0.0f},
                squares[4] = {1.0f, -2.5f, 2.0f, -0.5f};
    const float cubes_soft[4] = {-1.0f / 6.0f, 0.5f, -0.5f, 1.0f / 6.0f},
                cubes[4] = {-0.5f, 1.5f, -1.5f, 0.5f};
    const float ones_soft[4] = {1.0f / 6.0f, 2.0f / 3.0f, 1.0f / 6.0f, 0.0f},
                ones[4] = {0.0f, 1.0f, 0.0f, 0.0f};
    const float first[4] = {-0.5f, 0.0f, 0.5f, 0.0f};
    float found[4];
    UNROLL for (int i = 0; i < 4; i++)
        found[i] =
            (((k * cubes_soft[i] + sharp * cubes[i]) * t + k * squares_soft[i] + sharp * squares[i])
                 * t
             + first[i])
                * t
            + k * ones_soft[i] + sharp * ones[i];
    return {found[0], found[1], found[2], found[3]};
}

FN Colour plus(const Colour& sum, float weight, const Four& of) {
    return {sum.r + weight * of.x, sum.g + weight * of.y, sum.b + weight * of.z};
}

FN Colour least(const Colour& one, const Four& other) {
    return {fminf(one.r, other.x), fminf(one.g, other.y), fminf(one.b, other.z)};
}

FN Colour most(const Colour& one, const Four& other) {
    return {fmaxf(one.r, other.x), fmaxf(one.g, other.y), fmaxf(one.b, other.z)};
}

// A picture at a place, within the range of the four pixels around it.
FN Colour colour_at(const View& picture, float y, float x, float sharp) {
    const int h = picture.size[0], w = picture.size[1];
    const Corner at = corner_of(y, x, h, w);
    const Four down = taps_at(at.down, sharp), across = taps_at(at.across, sharp);
    const float weights[4] = {down.x, down.y, down.z, down.w};
    const int columns[4] = {max(at.i - 1, 0), at.i, min(at.i + 1, w - 1), min(at.i + 2, w - 1)};
    Colour sum = {0.0f, 0.0f, 0.0f}, low = {LARGEST_FLOAT, LARGEST_FLOAT, LARGEST_FLOAT};
    Colour high = {-LARGEST_FLOAT, -LARGEST_FLOAT, -LARGEST_FLOAT};
    UNROLL for (int b = 0; b < 4; b++) {
        const size_t row = size_t(clip(at.j - 1 + b, h)) * w;
        const Four q = four(picture, row + columns[1]), r = four(picture, row + columns[2]);
        Colour line = plus({0.0f, 0.0f, 0.0f}, across.x, four(picture, row + columns[0]));
        line = plus(plus(plus(line, across.y, q), across.z, r), across.w,
                    four(picture, row + columns[3]));
        sum = {sum.r + weights[b] * line.r, sum.g + weights[b] * line.g,
               sum.b + weights[b] * line.b};
        if (b == 1 || b == 2) {
            low = least(least(low, q), r);
            high = most(most(high, q), r);
        }
    }
    return {fminf(fmaxf(sum.r, low.r), high.r), fminf(fmaxf(sum.g, low.g), high.g),
            fminf(fmaxf(sum.b, low.b), high.b)};
}

// Weights of the two frames for a path of a pixel, 1 together, by whether they show its point.
FN Pair weights_of(const Path& path, int h, int w, int y, int x, float t) {
    const float first = is_inside(h, w, y + path.ay, x + path.ax) ? path.first : 0.0f;
    const float last = is_inside(h, w, y + path.by, x + path.bx) ? path.last : 0.0f;
    const float one = (1.0f - t) * (first + LEAST), other = t * (last + LEAST);
    float share = one / (one + other);
    share = share < LITTLE ? 0.0f : share > 1.0f - LITTLE ? 1.0f : share;
    return {share, 1.0f - share};
}

FN float depth_of(const View& picture, size_t pixel) { return picture.at[4 * pixel + 3]; }

// Depth of the surface that a path shows at a pixel, 0 where it leads to another one, and whether
// both frames show it.
struct Surface {
    float depth;
    bool is_shown;
};

FN Surface surface_of(const View& before, const View& after, const Path& path, int y, int x) {
    const int h = before.size[0], w = before.size[1];
    const Corner a = corner_of(y + 0.5f + path.ay, x + 0.5f + path.ax, h, w);
    const Corner b = corner_of(y + 0.5f + path.by, x + 0.5f + path.bx, h, w);
    const float one = depth_of(before, size_t(a.j) * w + a.i),
                other = depth_of(after, size_t(b.j) * w + b.i);
    if (path.first == 0.0f || path.last == 0.0f) return {path.first == 0.0f ? other : one, false};
    const bool is_one = fabsf(one - other) <= NEARER * fminf(one, other);
    return {is_one ? 0.5f * (one + other) : 0.0f, is_one};
}

// Shares of four cells in a pixel, by its place between them; of cells that follow one path one has
// it all.
FN void share_cells(const View& cells, const int (&places)[4], float across, float down,
                    float (&shares)[4]) {
    Path paths[4];
    UNROLL for (int k = 0; k < 4; k++) {
        shares[k] = (k / 2 ? down : 1.0f - down) * (k % 2 ? across : 1.0f - across);
        paths[k] = path_of(cells, places[k]);
    }
    UNROLL for (int k = 1; k < 4; k++) {
        bool is_given = false;
        UNROLL for (int j = 0; j < k; j++) {
            if (is_given || !(shares[j] > 0.0f) || differ(paths[k], paths[j], OTHER)
                || paths[k].first != paths[j].first || paths[k].last != paths[j].last)
                continue;
            shares[j] += shares[k];
            shares[k] = 0.0f;
            is_given = true;
        }
    }
}

// What a path shows at a pixel in both frames, by their weights.
struct Shown {
    Colour before, after;
    Pair weights;
};

FN Shown shown_by(const Led& led, const View& before, const View& after, int y, int x, float t) {
    const Path& path = led.path;
    Shown found = {{0.0f, 0.0f, 0.0f},
                   {0.0f, 0.0f, 0.0f},
                   weights_of(path, before.size[0], before.size[1], y, x, t)};
    if (found.weights.x > 0.0f)
        found.before = colour_at(before, y + path.ay, x + path.ax, led.sharp);
    if (found.weights.y > 0.0f) found.after = colour_at(after, y + path.by, x + path.bx, led.sharp);
    return found;
}

// Their mean: the nearer frame's alone where light differs that much that it is something else,
// such as a spark.
FN Colour settled(const Shown& by, float dim) {
    const float first = by.before.r + by.before.g + by.before.b,
                last = by.after.r + by.after.g + by.after.b;
    Pair weights = by.weights;
    if (fminf(weights.x, weights.y) > 0.0f
        && fmaxf(first, last) > ELSE * fmaxf(fminf(first, last), dim))
        weights = weights.x >= weights.y ? Pair{1.0f, 0.0f} : Pair{0.0f, 1.0f};
    return {weights.x * by.before.r + weights.y * by.after.r,
            weights.x * by.before.g + weights.y * by.after.g,
            weights.x * by.before.b + weights.y * by.after.b};
}

// A pixel's colour, the path that counts most, and the weight of the frame before.
struct Made {
    Colour colour;
    Path path;
    float led;
};

// The four cells around a pixel, and how far it is from the first ones to the last.
struct Around {
    int places[4];
    float down, across;
};

FN Around around_of(const View& cells, float scale, int y, int x) {
    const int rows = cells.size[0], columns = cells.size[1];
    const float size = 1.0f / scale;
    const Between down = between_cells((y + 0.5f) * size - 0.5f, rows);
    const Between across = between_cells((x + 0.5f) * size - 0.5f, columns);
    return {{down.first * columns + across.first, down.first * columns + across.second,
             down.second * columns + across.first, down.second * columns + across.second},
            down.share,
            across.share};
}

// What is mixed. dim: light that counts as dark.
struct Mixed {
    View cells, before, after;
    float t, dim;
};

// A pixel among cells that follow one path, interpolated between them.
FN Made joined_pixel(const Mixed& of, const Around& around, int y, int x) {
    const float down = around.down, across = around.across;
    const float shares[4] = {(1.0f - down) * (1.0f - across), (1.0f - down) * across,
                             down * (1.0f - across), down * across};
    Led one = {{0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}, 0.0f};
    float sharpest = 0.0f;
    UNROLL for (int k = 0; k < 4; k++) {
        const Four path = four(of.cells, 2 * size_t(around.places[k]));
        const Four rest = four(of.cells, 2 * size_t(around.places[k]) + 1);
        one.path.ax += shares[k] * path.x;
        one.path.ay += shares[k] * path.y;
        one.path.bx += shares[k] * path.z;
        one.path.by += shares[k] * path.w;
        // where they differ, cells are not joined
        if (k == 0) one.path.first = rest.x, one.path.last = rest.y;
        one.sharp += shares[k] * rest.z;
        sharpest = fmaxf(sharpest, rest.z);
    }
    if (sharpest > CRISP) one.sharp = sharpest;
    const Shown found = shown_by(one, of.before, of.after, y, x, of.t);
    return {settled(found, of.dim), one.path, found.weights.x};
}

// Least number of four lanes that work on one pixel; sum and largest one.
FN float of_four(float value, int step) {
    return __shfl_xor_sync(0xfu << (threadIdx.x & 28), value, step);
}

FN float sum_of_four(float value) {
    value += of_four(value, 1);
    return value + of_four(value, 2);
}

FN float largest_of_four(float value) {
    value = fmaxf(value, of_four(value, 1));
    return fmaxf(value, of_four(value, 2));
}

// A pixel of several paths, made by four lanes, each of which has one of the paths; in all of them,
// but for the path, which is that of the lane `best`. A path whose surface lies behind one that
// both frames show there loses most of its share.
FN Made mixed_pixel(const Mixed& of, const Around& around, int y, int x, int& best) {
    const int lane = threadIdx.x % 4;
    float shares[4];
    share_cells(of.cells, around.places, around.across, around.down, shares);
    float share = lane == 0 ? shares[0] : lane == 1 ? shares[1] : lane == 2 ? shares[2] : shares[3];
    const Led one = cell_of(of.cells, lane == 0 ? around.places[0] : lane == 1 ? around.places[1]
                            : lane == 2 ? around.places[2] : around.places[3]);
    const Surface surface = surface_of(of.before, of.after, one.path, y, x);
    const float nearest = -largest_of_four(share > 0.0f && surface.is_shown ? -surface.depth
                                                                            : -LARGEST_FLOAT);
    if (surface.depth > (1.0f + NEARER) * nearest) share *= HIDDEN;
    Colour mean = {0.0f, 0.0f, 0.0f};
    float led = 0.0f;
    if (share > 0.0f) {
        const Shown found = shown_by(one, of.before, of.after, y, x, of.t);
        const Colour &a = found.before, &b = found.after;
        const float light = fabsf(a.r) + fabsf(a.g) + fabsf(a.b) + fabsf(b.r) + fabsf(b.g)
                            + fabsf(b.b);
        const float apart = found.weights.x == 0.0f || found.weights.y == 0.0f ? UNSURE
            : (fabsf(a.r - b.r) + fabsf(a.g - b.g) + fabsf(a.b - b.b)) / (light + TINY);
        share /= ALIKE + apart * apart;
        mean = settled(found, of.dim);
        led = found.weights.x;
    }
    const float whole = sum_of_four(share), largest = largest_of_four(share);
    // the first of equal ones
    best = int(-largest_of_four(share == largest ? -float(lane) : -4.0f));
    return {{sum_of_four(share * mean.r) / whole, sum_of_four(share * mean.g) / whole,
             sum_of_four(share * mean.b) / whole}, one.path, led};
}

// The pixel whose data counts at a pixel: the nearest one in the frame that counts more, and
// whether that is the first.
struct Taken {
    size_t pixel;
    bool is_first;
};

FN Taken taken_at(const Four& path, float led, int h, int w, int y, int x) {
    const bool is_first = led >= 1.0f - led;
    const Corner at = corner_of(y + 0.5f + (is_first ? path.y : path.w),
                                x + 0.5f + (is_first ? path.x : path.z), h, w);
    return {size_t(at.j) * w + at.i, is_first};
}

// Where planes of the picture go: colour (h, w, 3), motion (h, w, 2), depth (h, w, 1), and, for
// planes that follow, the path that counts most (h, w, 4), and the weight of the frame before,
// `led` (h, w, 1).
struct Results {
    View motion, depth, paths, led, colour;
};

FN void put_colour(float* to, const Colour& colour) {
    to[0] = colour.r, to[1] = colour.g, to[2] = colour.b;
}

// All but the colour.
template <bool ALL>
FN void put_planes(const Mixed& of, const Made& made, const View& shares, const Results& to, int y,
                   int x) {
    const int h = to.colour.size[0], w = to.colour.size[1];
    const Path& path = made.path;
    const Four ends = {path.ax, path.ay, path.bx, path.by};
    const size_t pixel = size_t(y) * w + x;
    const Taken taken = taken_at(ends, made.led, h, w, y, x);
    const float by_first = shares.at[0], by_last = shares.at[1];
    pair(to.motion, pixel) = {by_first * path.ax + by_last * path.bx,
                              by_first * path.ay + by_last * path.by};
    to.depth.at[pixel] = (taken.is_first ? of.before.at : of.after.at)[4 * taken.pixel + 3];
    if (!ALL) return;
    four(to.paths, pixel) = ends;
    to.led.at[pixel] = made.led;
}

// The picture; its motion is shares[0] and shares[1] of what leads to both frames. A block makes
// 32x8 pixels: those of one path first, then the others, which it lists.
template <bool ALL>
FN void compose(const Mixed& of, const View& scale, const View& shares, const Results& to) {
    __shared__ int listed[256], count;
    __shared__ float colours[8][96];
    const int h = to.colour.size[0], w = to.colour.size[1], left = 32 * blockIdx.x,
              lane = threadIdx.x % 32;
    const int x = left + lane, y = 8 * blockIdx.y + threadIdx.x / 32;
    float* const row = colours[threadIdx.x / 32];
    if (threadIdx.x == 0) count = 0;
    __syncthreads();
    if (y < h && x < w) {
        const Around around = around_of(of.cells, scale.at[0], y, x);
        if (of.cells.at[8 * size_t(around.places[0]) + 7] > 0.0f) {
            const Made made = joined_pixel(of, around, y, x);
            put_colour(row + 3 * lane, made.colour);
            put_planes<ALL>(of, made, shares, to, y, x);
        } else {
            listed[atomicAdd(&count, 1)] = y * w + x;
        }
    }
    __syncwarp();
    if (y < h)  // neighbouring lanes write neighbouring floats; listed pixels are written once more
        for (int i = lane; i < 3 * min(32, w - left); i += 32)
            to.colour.at[3 * (size_t(y) * w + left) + i] = row[i];
    __syncthreads();
    for (int k = threadIdx.x / 4; k < count; k += 64) {
        const int j = listed[k] / w, i = listed[k] - j * w;
        int best;
        const Made made = mixed_pixel(of, around_of(of.cells, scale.at[0], j, i), j, i, best);
        if (int(threadIdx.x % 4) != best) continue;
        put_colour(to.colour.at + 3 * (size_t(j) * w + i), made.colour);
        put_planes<ALL>(of, made, shares, to, j, i);
    }
}

extern "C" __global__ void __launch_bounds__(256, 4) interpolate_compose(
    View cells, View before, View after, View time, View level, View scale, View shares,
    View motion, View depth, View colour) {
    compose<false>({cells, before, after, time.at[0], DARK * level.at[0]}, scale, shares,
                   {motion, depth, {}, {}, colour});
}

// The same where other planes follow.
extern "C" __global__ void __launch_bounds__(256, 4) interpolate_compose_all(
    View cells, View before, View after, View time, View level, View scale, View shares,
    View motion, View depth, View paths, View led, View colour) {
    compose<true>({cells, before, after, time.at[0], DARK * level.at[0]}, scale, shares,
                  {motion, depth, paths, led, colour});
}

// Data (h, w, m) that is taken from the nearest pixel in the frame that counts more.
extern "C" __global__ void interpolate_take(View before, View after, View paths, View led,
                                            View data) {
    const int h = data.size[0], w = data.size[1], count = data.size[2];
    PIXEL(w, h);
    const size_t pixel = size_t(y) * w + x;
    const Taken taken = taken_at(four(paths, pixel), led.at[pixel], h, w, y, x);
    const float* const from = (taken.is_first ? before : after).at + taken.pixel * count;
    for (int c = 0; c < count; c++) data.at[count * pixel + c] = from[c];
}

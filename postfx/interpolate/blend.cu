// The picture that the paths make, as blend.py makes it. Pictures are held as (h, w, 4), cells are (rows, columns, 8).

__device__ inline bool is_line(const View& cells, int y, int x, int j, int i, int c) {
    const int rows = cells.size[0], columns = cells.size[1];
    const float* const at = cells.at + c;
    const float here = at[8 * (y * columns + x)], next = at[8 * ((y + j) * columns + x + i)];
    const float step = next - here, last = step - here + at[8 * (max(y - j, 0) * columns + max(x - i, 0))];
    const float coming = at[8 * (min(y + 2 * j, rows - 1) * columns + min(x + 2 * i, columns - 1))] - next - step;
    return fminf(fabsf(last), fabsf(coming)) <= SMOOTH;
}

// Mark cells that follow one path with those to the right and below by 1, and by 2 where it changes evenly.
extern "C" __global__ void interpolate_join(View cells) {
    const int rows = cells.size[0], columns = cells.size[1];
    PIXEL(columns, rows);
    const int j = min(y + 1, rows - 1) - y, i = min(x + 1, columns - 1) - x, cell = y * columns + x;
    const float* const at = cells.at + 8 * size_t(cell);
    const float *const right = at + 8 * i, *const low = at + 8 * size_t(j * columns), *const beyond = low + 8 * i;
    bool is_one = true, is_even = true;
    for (int c = 0; c < 6; c++) {
        const float apart = fmaxf(fmaxf(fabsf(right[c] - at[c]), fabsf(low[c] - at[c])), fabsf(beyond[c] - at[c]));
        is_one = is_one && apart <= (c < 4 ? JOINED : 0.0f);
        is_even = is_even && apart <= (c < 4 ? TURNING : 0.0f)
            && fabsf(at[c] - right[c] - low[c] + beyond[c]) <= SMOOTH;
    }
    if (!is_one && is_even)
        for (int c = 0; c < 4 && is_even; c++)
            is_even = is_line(cells, y, x, 0, i, c) && is_line(cells, y, x, j, 0, c)
                && is_line(cells, y + j, x, 0, i, c) && is_line(cells, y, x + i, j, 0, c);
    cells.at[8 * size_t(cell) + 7] = is_one ? 1.0f : is_even ? 2.0f : 0.0f;
}

// The cells before and after a pixel's middle, and how far it is from the first to the second one.
struct Between {
    int first, second;
    float share;
};

__device__ inline Between between_cells(int position, float size, int count) {
    const float at = fminf(fmaxf((position + 0.5f) * size - 0.5f, 0.0f), float(count - 1));
    const int first = int(at);
    return {first, min(first + 1, count - 1), at - first};
}

// A path, and how sharp the pictures are there.
struct Led {
    Path path;
    float sharp;
};

__device__ inline Led cell_of(const View& cells, int cell) {
    return {path_of(cells, cell), cells.at[8 * size_t(cell) + 6]};
}

// The pixel before a place, which is held in the picture, and how far after it the place lies.
struct Corner {
    int j, i;
    float down, across;
};

__device__ inline Corner corner_of(float y, float x, int h, int w) {
    y = fminf(fmaxf(y, 0.0f), float(h - 1));
    x = fminf(fmaxf(x, 0.0f), float(w - 1));
    const int j = int(y), i = int(x);
    return {j, i, y - j, x - i};
}

// Weights of four taps around a place after the second one: cubics where sharp is 1, B-splines where it is 0.
__device__ inline Four taps_at(float t, float sharp) {
    const float k = 1.0f - sharp;
    const float squares_soft[4] = {0.5f, -1.0f, 0.5f, 0.0f}, squares[4] = {1.0f, -2.5f, 2.0f, -0.5f};
    const float cubes_soft[4] = {-1.0f / 6.0f, 0.5f, -0.5f, 1.0f / 6.0f}, cubes[4] = {-0.5f, 1.5f, -1.5f, 0.5f};
    const float ones_soft[4] = {1.0f / 6.0f, 2.0f / 3.0f, 1.0f / 6.0f, 0.0f}, ones[4] = {0.0f, 1.0f, 0.0f, 0.0f};
    const float first[4] = {-0.5f, 0.0f, 0.5f, 0.0f};
    float found[4];
#pragma unroll
    for (int i = 0; i < 4; i++)
        found[i] = (((k * cubes_soft[i] + sharp * cubes[i]) * t + k * squares_soft[i] + sharp * squares[i]) * t
                    + first[i]) * t + k * ones_soft[i] + sharp * ones[i];
    return {found[0], found[1], found[2], found[3]};
}

__device__ inline Colour plus(const Colour& sum, float weight, const Four& of) {
    return {sum.r + weight * of.x, sum.g + weight * of.y, sum.b + weight * of.z};
}

__device__ inline float held_within(float value, float p, float q, float r, float s) {
    return fminf(fmaxf(value, fminf(fminf(p, q), fminf(r, s))), fmaxf(fmaxf(p, q), fmaxf(r, s)));
}

// A picture at a place, within the range of the four pixels around it.
__device__ inline Colour colour_at(const View& picture, float y, float x, float sharp) {
    const int h = picture.size[0], w = picture.size[1];
    const Corner at = corner_of(y, x, h, w);
    const Four down = taps_at(at.down, sharp), across = taps_at(at.across, sharp);
    const float weights[4] = {down.x, down.y, down.z, down.w};
    const int columns[4] = {max(at.i - 1, 0), at.i, min(at.i + 1, w - 1), min(at.i + 2, w - 1)};
    Colour sum = {0.0f, 0.0f, 0.0f};
    Four inner[4];
#pragma unroll
    for (int b = 0; b < 4; b++) {
        const size_t row = size_t(within(at.j - 1 + b, h)) * w;
        const Four q = four(picture, row + columns[1]), r = four(picture, row + columns[2]);
        Colour line = plus({0.0f, 0.0f, 0.0f}, across.x, four(picture, row + columns[0]));
        line = plus(plus(plus(line, across.y, q), across.z, r), across.w, four(picture, row + columns[3]));
        sum = {sum.r + weights[b] * line.r, sum.g + weights[b] * line.g, sum.b + weights[b] * line.b};
        if (b == 1) inner[0] = q, inner[1] = r;
        if (b == 2) inner[2] = q, inner[3] = r;
    }
    return {held_within(sum.r, inner[0].x, inner[1].x, inner[2].x, inner[3].x),
            held_within(sum.g, inner[0].y, inner[1].y, inner[2].y, inner[3].y),
            held_within(sum.b, inner[0].z, inner[1].z, inner[2].z, inner[3].z)};
}

// Weights of the two frames for a path of a pixel, 1 together, by whether they show its point.
__device__ inline Pair weights_of(const Path& path, int h, int w, int y, int x, float t) {
    const float first = is_inside(h, w, y + path.ay, x + path.ax) ? path.first : 0.0f;
    const float last = is_inside(h, w, y + path.by, x + path.bx) ? path.last : 0.0f;
    const float one = (1.0f - t) * (first + LEAST), other = t * (last + LEAST);
    float share = one / (one + other);
    share = share < LITTLE ? 0.0f : share > 1.0f - LITTLE ? 1.0f : share;
    return {share, 1.0f - share};
}

// Depth of the surface that a path shows at a pixel, 0 where it leads to another one, and whether both frames show it.
struct Surface {
    float depth;
    bool is_shown;
};

__device__ inline Surface surface_of(const View& near, const View& far, const Path& path, int y, int x) {
    const int h = near.size[0], w = near.size[1];
    const Corner a = corner_of(y + 0.5f + path.ay, x + 0.5f + path.ax, h, w);
    const Corner b = corner_of(y + 0.5f + path.by, x + 0.5f + path.bx, h, w);
    const float one = near.at[a.j * w + a.i], other = far.at[b.j * w + b.i];
    if (path.first == 0.0f || path.last == 0.0f) return {path.first == 0.0f ? other : one, false};
    const bool is_one = fabsf(one - other) <= NEARER * fminf(one, other);
    return {is_one ? 0.5f * (one + other) : 0.0f, is_one};
}

// Shares of four cells in a pixel, by its place between them; of cells that follow one path one has it all, and a path
// whose surface lies behind one that both frames show there loses most of its own.
__device__ inline void share_cells(const View& cells, const View& near, const View& far, const int (&places)[4],
                                   float across, float down, int y, int x, float (&shares)[4]) {
    Path paths[4];
    Surface surfaces[4];
    float nearest = LARGEST_FLOAT;
#pragma unroll
    for (int k = 0; k < 4; k++) {
        shares[k] = (k / 2 ? down : 1.0f - down) * (k % 2 ? across : 1.0f - across);
        paths[k] = path_of(cells, places[k]);
    }
#pragma unroll
    for (int k = 1; k < 4; k++) {
        bool is_given = false;
#pragma unroll
        for (int j = 0; j < k; j++) {
            if (is_given || !(shares[j] > 0.0f) || differ(paths[k], paths[j], OTHER)
                || paths[k].first != paths[j].first || paths[k].last != paths[j].last)
                continue;
            shares[j] += shares[k];
            shares[k] = 0.0f;
            is_given = true;
        }
    }
#pragma unroll
    for (int k = 0; k < 4; k++) {
        surfaces[k] = surface_of(near, far, paths[k], y, x);
        if (shares[k] > 0.0f && surfaces[k].is_shown) nearest = fminf(nearest, surfaces[k].depth);
    }
#pragma unroll
    for (int k = 0; k < 4; k++)
        if (surfaces[k].depth > (1.0f + NEARER) * nearest) shares[k] *= HIDDEN;
}

// What a path shows at a pixel in both frames, by their weights.
struct Shown {
    Colour before, after;
    Pair weights;
};

__device__ inline Shown shown_by(const Led& led, const View& before, const View& after, int y, int x, float t) {
    const Path& path = led.path;
    Shown found = {{0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, weights_of(path, before.size[0], before.size[1], y, x, t)};
    if (found.weights.x > 0.0f) found.before = colour_at(before, y + path.ay, x + path.ax, led.sharp);
    if (found.weights.y > 0.0f) found.after = colour_at(after, y + path.by, x + path.bx, led.sharp);
    return found;
}

// Their mean: the nearer frame's alone where light differs that much that it is something else, such as a spark.
__device__ inline Colour settled(const Shown& by, float dim) {
    const float first = by.before.r + by.before.g + by.before.b, last = by.after.r + by.after.g + by.after.b;
    Pair weights = by.weights;
    if (fminf(weights.x, weights.y) > 0.0f && fmaxf(first, last) > ELSE * fmaxf(fminf(first, last), dim))
        weights = weights.x >= weights.y ? Pair{1.0f, 0.0f} : Pair{0.0f, 1.0f};
    return {weights.x * by.before.r + weights.y * by.after.r, weights.x * by.before.g + weights.y * by.after.g,
            weights.x * by.before.b + weights.y * by.after.b};
}

// A pixel's colour, the path that counts most, and the weight of the frame before.
struct Made {
    Colour colour;
    Path path;
    float led;
};

// near, far: depth (h, w, 1) of both frames. scale: pixels of a cell. dim: light that counts as dark.
__device__ inline Made made_at(const View& cells, const View& before, const View& after, const View& near,
                               const View& far, float t, float scale, float dim, int y, int x) {
    const int rows = cells.size[0], columns = cells.size[1];
    const float size = 1.0f / scale;
    const Between down = between_cells(y, size, rows), across = between_cells(x, size, columns);
    const int places[4] = {down.first * columns + across.first, down.first * columns + across.second,
                           down.second * columns + across.first, down.second * columns + across.second};
    if (cells.at[8 * size_t(places[0]) + 7] > 0.0f) {
        const float p = (1.0f - down.share) * (1.0f - across.share), q = (1.0f - down.share) * across.share;
        const float r = down.share * (1.0f - across.share), s = down.share * across.share;
        const Led a = cell_of(cells, places[0]), b = cell_of(cells, places[1]), c = cell_of(cells, places[2]);
        const Led d = cell_of(cells, places[3]);
        const float sharpest = fmaxf(fmaxf(a.sharp, b.sharp), fmaxf(c.sharp, d.sharp));
        // those whose first and last differ are not joined
        const Led one = {{p * a.path.ax + q * b.path.ax + r * c.path.ax + s * d.path.ax,
                          p * a.path.ay + q * b.path.ay + r * c.path.ay + s * d.path.ay,
                          p * a.path.bx + q * b.path.bx + r * c.path.bx + s * d.path.bx,
                          p * a.path.by + q * b.path.by + r * c.path.by + s * d.path.by, a.path.first, a.path.last},
                         sharpest > CRISP ? sharpest : p * a.sharp + q * b.sharp + r * c.sharp + s * d.sharp};
        const Shown found = shown_by(one, before, after, y, x, t);
        return {settled(found, dim), one.path, found.weights.x};
    }
    Made made = {};
    float shares[4], whole = 0.0f, best = 0.0f;
    share_cells(cells, near, far, places, across.share, down.share, y, x, shares);
    for (int k = 0; k < 4; k++) {
        if (shares[k] == 0.0f) continue;
        const Led one = cell_of(cells, places[k]);
        const Shown found = shown_by(one, before, after, y, x, t);
        const Colour &a = found.before, &b = found.after, mean = settled(found, dim);
        const float light = fabsf(a.r) + fabsf(a.g) + fabsf(a.b) + fabsf(b.r) + fabsf(b.g) + fabsf(b.b);
        const float apart = found.weights.x == 0.0f || found.weights.y == 0.0f ? UNSURE
            : (fabsf(a.r - b.r) + fabsf(a.g - b.g) + fabsf(a.b - b.b)) / (light + TINY);
        const float share = shares[k] / (ALIKE + apart * apart);
        made.colour = {made.colour.r + share * mean.r, made.colour.g + share * mean.g, made.colour.b + share * mean.b};
        whole += share;
        if (share > best) {
            best = share;
            made.path = one.path;
            made.led = found.weights.x;
        }
    }
    made.colour = {made.colour.r / whole, made.colour.g / whole, made.colour.b / whole};
    return made;
}

// The pixel whose data counts at a pixel: the nearest one in the frame that counts more, and whether that is the first.
struct Taken {
    size_t pixel;
    bool is_first;
};

__device__ inline Taken taken_at(const Four& path, float led, int h, int w, int y, int x) {
    const bool is_first = led >= 1.0f - led;
    const Corner at = corner_of(y + 0.5f + (is_first ? path.y : path.w), x + 0.5f + (is_first ? path.x : path.z), h, w);
    return {size_t(at.j) * w + at.i, is_first};
}

// The picture (h, w, 3), its motion (h, w, 2), shares[0] and shares[1] of what leads to both frames, and depth
// (h, w, 1). near, far: depth of both frames.
__device__ inline Made put_pixel(const View& cells, const View& before, const View& after, const View& near,
                                 const View& far, const View& time, const View& level, const View& scale,
                                 const View& shares, const View& motion, const View& depth, const View& colour, int y,
                                 int x) {
    const int h = colour.size[0], w = colour.size[1];
    const Made made = made_at(cells, before, after, near, far, time.at[0], scale.at[0], DARK * level.at[0], y, x);
    const Path& path = made.path;
    const size_t pixel = size_t(y) * w + x;
    const Taken taken = taken_at({path.ax, path.ay, path.bx, path.by}, made.led, h, w, y, x);
    float* const to = colour.at + 3 * pixel;
    to[0] = made.colour.r, to[1] = made.colour.g, to[2] = made.colour.b;
    const float by_first = shares.at[0], by_last = shares.at[1];
    pair(motion, pixel) = {by_first * path.ax + by_last * path.bx, by_first * path.ay + by_last * path.by};
    depth.at[pixel] = (taken.is_first ? near : far).at[taken.pixel];
    return made;
}

extern "C" __global__ void interpolate_compose(View cells, View before, View after, View near, View far, View time,
                                               View level, View scale, View shares, View motion, View depth,
                                               View colour) {
    PIXEL(colour.size[1], colour.size[0]);
    put_pixel(cells, before, after, near, far, time, level, scale, shares, motion, depth, colour, y, x);
}

// The same where other planes follow: the path that counts most (h, w, 4), and the weight of the frame before, `led`
// (h, w, 1).
extern "C" __global__ void interpolate_compose_all(View cells, View before, View after, View near, View far, View time,
                                                   View level, View scale, View shares, View motion, View depth,
                                                   View paths, View led, View colour) {
    PIXEL(colour.size[1], colour.size[0]);
    const Made made = put_pixel(cells, before, after, near, far, time, level, scale, shares, motion, depth, colour, y,
                                x);
    const size_t pixel = size_t(y) * colour.size[1] + x;
    four(paths, pixel) = {made.path.ax, made.path.ay, made.path.bx, made.path.by};
    led.at[pixel] = made.led;
}

// Data (h, w, m) that is taken from the nearest pixel in the frame that counts more.
extern "C" __global__ void interpolate_take(View before, View after, View paths, View led, View data) {
    const int h = data.size[0], w = data.size[1], count = data.size[2];
    PIXEL(w, h);
    const size_t pixel = size_t(y) * w + x;
    const Taken taken = taken_at(four(paths, pixel), led.at[pixel], h, w, y, x);
    const float* const from = (taken.is_first ? before : after).at + taken.pixel * count;
    for (int c = 0; c < count; c++) data.at[count * pixel + c] = from[c];
}

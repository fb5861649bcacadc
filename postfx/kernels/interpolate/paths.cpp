// Rows of paths: motion of cells, paths from it, and what arrives at each cell at a time.
#include "paths.h"

constexpr float DEPTH_MISS = 1e10f;  // depth of what hits nothing
constexpr float NEAREST = 1e-6f;  // the smallest depth

// Motion and depth of a cell of four pixels, which may be the same: the mean of those of the
// nearest surface, and NaN of none. Without branches, for several cells at once.
template <class F> struct Cell {
    F x, y, depth;
};
template <class F> struct Pixels {
    F depth, x, y;
};
template <class F>
FN Cell<F> gathered(const Pixels<F> (&pixels)[4], float scale, float most) {
    const F zero = F(0.0f), one = F(1.0f), miss = F(DEPTH_MISS);
    F depth[4];
    for (int k = 0; k < 4; k++) depth[k] = smaller<F>(pixels[k].depth, miss);
    const F nearest = larger<F>(smaller<F>(smaller<F>(depth[0], depth[1]),
                                           smaller<F>(depth[2], depth[3])), F(NEAREST));
    const F beyond = nearest * (1.0f + ALIKE);
    F x = zero, y = zero, count = zero;
    for (int k = 0; k < 4; k++) {
        const F wide = size_of<F>(pixels[k].x) <= most ? one : zero;
        const F near = size_of<F>(pixels[k].y) <= most ? wide : zero;
        const F counts = depth[k] <= beyond ? near : zero;
        x += counts > 0.0f ? pixels[k].x : zero;
        y += counts > 0.0f ? pixels[k].y : zero;
        count += counts;
    }
    return {x / (count * scale), y / (count * scale), nearest};
}

// Motion, in cells, and depth of cells of one pixel or 2x2. Either plane may have one row, which
// stands for all. numbers: pixels of a cell, and the longest motion, beyond which it becomes NaN;
// depth lies between 0 and a miss.
static void gather_row(Long row, Field motion, Field depth, Places numbers, NewField cell_motion,
                       NewField cell_depth) {
    const Long scale = Long(numbers.at[0]), w = depth.size[1], columns = cell_depth.size[1];
    const Long h = larger<Long>(motion.size[0], depth.size[0]);
    const float size = numbers.at[0], most = numbers.at[1];
    const Long top = row * scale, low = smaller<Long>(top + scale - 1, h - 1);
    const bool deep = depth.size[0] > 1, moving = motion.size[0] > 1;
    const float* far[2] = {depth(deep ? top : 0), depth(deep ? low : 0)};
    const float* moved[2] = {motion(moving ? top : 0), motion(moving ? low : 0)};
    float *cells = cell_motion(row), *depths = cell_depth(row);
    const Long pairs = scale == 2 ? w / 2 : 0;
    across(0, pairs, EACH(F, Long x) {
        Pixels<F> pixels[4];
        UNROLL for (int k = 0; k < 4; k++) {
            const float* at = moved[k / 2] + 4 * x + k % 2 * 2;
            pixels[k] = {pick<F, 2>(far[k / 2] + 2 * x + k % 2), pick<F, 4>(at),
                         pick<F, 4>(at + 1)};
        }
        const Cell<F> cell = gathered<F>(pixels, size, most);
        store<F>(depths + x, cell.depth);
        store_pairs<F>(cells + 2 * x, cell.x, cell.y);
    });
    for (Long x = pairs; x < columns; x++) {
        Pixels<float> pixels[4];
        for (int k = 0; k < 4; k++) {
            const float* at = moved[k / 2] + 2 * scale * x;
            pixels[k] = {far[k / 2][scale * x], at[0], at[1]};
        }
        const Cell<float> cell = gathered<float>(pixels, size, most);
        depths[x] = cell.depth;
        cells[2 * x] = cell.x;
        cells[2 * x + 1] = cell.y;
    }
}
EXPORT(gather_cells, gather_row)

// What stands for depth where there is none: 1 plus the difference of a grey picture to another one
// where its motion leads, or 2. A path that fits both pictures is in front of one that does not.
static void rank_row(Long y, Plane one, Plane other, Field motion, NewField rank) {
    const Long h = one.size[0], w = one.size[1];
    for (Long x = 0; x < w; x++) {
        const double u = double(x) + 0.5 + motion(y, x)[0];
        const double v = double(y) + 0.5 + motion(y, x)[1];
        const bool inside = u >= 0.0 && u < double(w) && v >= 0.0 && v < double(h);
        const float off = inside ? one(y)[x] - other(Long(v))[Long(u)] : 1.0f;
        *rank(y, x) = 1.0f + size_of<float>(off);
    }
}
EXPORT(rank_paths, rank_row)

// Leads motion that was inverted for whole pixels to the places between them whose motion leads
// back: one step of Newton's method, where motion goes on evenly.
static void refine_row(Long y, Field motion, NewField inverse) {
    for (Long x = 0; x < inverse.size[1]; x++) {
        float* own = inverse(y, x);
        const double v = double(y) + own[1], u = double(x) + own[0];
        if (!is_sloping(motion, v, u)) continue;
        const Sampled there = sample_two(motion, v, u);
        const float dx = own[0] + there.x, dy = own[1] + there.y, off = farther(dx, dy);
        if (!(there.is_even && EXACT < off && off <= 1.0f)) continue;
        const float a = 1.0f + there.right, d = 1.0f + there.under;
        const float area = a * d - there.down * there.across;
        if (!(size_of<float>(area) > LEAST_AREA)) continue;
        own[0] -= (d * dx - there.down * dy) / area;
        own[1] -= (a * dy - there.across * dx) / area;
    }
}
EXPORT(refine_inverse, refine_row)

// What is known of both frames: motion of the one after and what that is turned round; their
// depth; and motion of the frame before, which may be empty.
struct Between {
    Field motion, ahead;
    Both<Field> depth;
    Field came;
    typedef Arrays<Field, Field, Both<Field>, Field> Members;
};
// The paths of a frame: their ends, their bend, and whether the other frame shows the point.
struct Paths {
    NewField ends, bend;
    NewPlane seen;
    typedef Arrays<NewField, NewField, NewPlane> Members;
};

// What the frames beside tell of a point of the frame after, which was at a place: its motion in
// the frame before, and that to one further ahead.
FN Sides sides_of(const Between& of, const Field& goes, const Led& led, bool is_same, Long y,
                  Long x) {
    Sides sides = {0, -LOST, -LOST, LOST, LOST};
    if (of.came.size[0] && is_same) {
        const float* came = of.came(Long(led.v + 0.5), Long(led.u + 0.5));
        sides = {1, came[0], came[1], LOST, LOST};
        if (is_sloping(of.came, led.v, led.u)) {
            const Sampled between = sample_two(of.came, led.v, led.u);
            if (between.is_even) sides = {1, between.x, between.y, LOST, LOST};
        }
    }
    if (goes.size[0] && goes(y, x)[0] < LOST) {
        sides.on_x = goes(y, x)[0];
        sides.on_y = goes(y, x)[1];
        sides.count++;
    }
    return sides.count == 1 ? go_round(of.motion, y, x, sides) : sides;
}

// Paths of the frame after: by its motion; bent by what the frames beside tell of the same points.
static void back_rows(Long first, Long last, Between of, Field goes, Paths paths) {
    const Long h = paths.seen.size[0], w = paths.seen.size[1];
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < w; x++) {
            const float mx = of.motion(y, x)[0], my = of.motion(y, x)[1];
            store<Four>(paths.ends(y, x), Four{mx, my, 0.0f, 0.0f});
            paths.seen(y)[x] = 0.0f;
            const double u = double(x) + mx + 0.5, v = double(y) + my + 0.5;
            const bool inside = u >= 0.0 && u < double(w) && v >= 0.0 && v < double(h);
            if (!inside) continue;
            const float* ahead = of.ahead(Long(v), Long(u));
            const bool is_same = size_of<float>(ahead[0] + mx) <= SEEN
                              && size_of<float>(ahead[1] + my) <= SEEN;
            const Led led = {v - 0.5, u - 0.5, mx, my, *of.depth.after(y, x)};
            if (is_same && !is_touched(of.ahead, of.depth.before, led)) paths.seen(y)[x] = 1.0f;
            const WideTwo bend = bend_of(mx, my, sides_of(of, goes, led, is_same, y, x));
            store<Two>(paths.bend(y, x), __builtin_convertvector(bend, Two));
        }
    }
}
EXPORT(lead_back, back_rows)

// Paths of the frame before: to where the frame after shows the point, or straight on.
static void ahead_row(Long y, Between of, Field bend_after, Paths paths) {
    const Long h = paths.seen.size[0], w = paths.seen.size[1];
    for (Long x = 0; x < w; x++) {
        float fx = of.ahead(y, x)[0], fy = of.ahead(y, x)[1];
        paths.seen(y)[x] = 0.0f;
        if (!(fx < LOST)) {
            const float none = __builtin_nanf("");
            fx = of.came.size[0] ? -of.came(y, x)[0] : none;
            fy = of.came.size[0] ? -of.came(y, x)[1] : none;
            store<Four>(paths.ends(y, x), Four{0.0f, 0.0f, fx, fy});
            continue;
        }
        store<Four>(paths.ends(y, x), Four{0.0f, 0.0f, fx, fy});
        const double u = double(x) + fx, v = double(y) + fy;
        const Long i = Long(within_double(u + 0.5, double(w - 1)));
        const Long j = Long(within_double(v + 0.5, double(h - 1)));
        const float* back = of.motion(j, i);
        const bool leads_back = size_of<float>(back[0] + fx) <= SEEN
                             && size_of<float>(back[1] + fy) <= SEEN;
        if (!leads_back) continue;  // a filled crack
        Two bend = load<Two>(bend_after(j, i));
        if (is_sloping(bend_after, v, u)) {
            const Sampled between = sample_two(bend_after, v, u);
            if (between.is_even) bend = Two{between.x, between.y};
        }
        store<Two>(paths.bend(y, x), bend);
        const Led led = {v, u, fx, fy, *of.depth.before(y, x)};
        if (!is_touched(of.motion, of.depth.after, led)) paths.seen(y)[x] = 1.0f;
    }
}
EXPORT(lead_ahead, ahead_row)

// Paths at a time, from 0 to 1, and how much of their bend counts there.
struct Moment {
    float time, bend;
};
FN Two place_at(const float* ends, const float* bend, const Moment& at) {
    const Two start = load<Two>(ends), end = load<Two>(ends + 2);
    return start + at.time * (end - start) + at.bend * load<Two>(bend);
}

// Least depth of the paths that are nearest to each pixel; FAR where there is none.
static void nearest_row(Long y, Field ends, Field bend, Field depth, Given<Moment> at,
                        NewPlane nearest) {
    const Long h = nearest.size[0], w = nearest.size[1];
    for (Long x = 0; x < w; x++) {
        const float *own = ends(y, x), *bent = bend(y, x);
        const float right = at->time * (own[2] - own[0]), down = at->time * (own[3] - own[1]);
        const double u = double(x) + 0.5 + own[0] + right + at->bend * bent[0];
        const double v = double(y) + 0.5 + own[1] + down + at->bend * bent[1];
        const bool inside = u >= 0.0 && u < double(w) && v >= 0.0 && v < double(h);
        if (!inside) continue;
        float* found = nearest(Long(v)) + Long(u);
        *found = smaller<float>(*depth(y, x), *found);
    }
}
EXPORT(splat_nearest, nearest_row)

// Sums of the nearest surface's paths around each pixel: to both frames, seen, weight, and twice
// nothing.
static void mean_row(Long y, Field ends, Field bend, Field depth, Plane seen, Given<Moment> at,
                     Plane nearest, NewField found) {
    const Long h = nearest.size[0], w = nearest.size[1];
    for (Long x = 0; x < w; x++) {
        const float* own = ends(y, x);
        const Two moved = place_at(own, bend(y, x), *at);
        const double right = double(x) + moved[0], below = double(y) + moved[1];
        const bool inside = right > -1.0 && below > -1.0 && right < double(w) && below < double(h);
        if (!inside) continue;
        const Long i = floor_to_whole(right), j = floor_to_whole(below);
        const float z = *depth(y, x);
        const Eight path = {own[0] - moved[0], own[1] - moved[1], own[2] - moved[0],
                            own[3] - moved[1], seen(y)[x], 1.0f, 0.0f, 0.0f};
        const double u = right - double(i), v = below - double(j);
        const double weights[4] = {(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v};
        for (Long corner = 0; corner < 4; corner++) {
            const Long b = j + corner / 2, a = i + corner % 2;
            if (b < 0 || b >= h || a < 0 || a >= w || !(weights[corner] > 0.0)) continue;
            const float front = nearest(b)[a];
            if (!(size_of<float>(z - front) <= ALIKE * front)) continue;
            float* sum = found(b, a);
            store<Eight>(sum, added<Eight>(load<Eight>(sum), path, float(weights[corner])));
        }
    }
}
EXPORT(splat_means, mean_row)

// Means of the sums; pixels where nothing arrived get those of two neighbours on opposite sides.
static void crack_rows(Long, Long, Plane nearest, NewField found, NewPlane depth) {
    constexpr Long STEPS[4][2] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}};
    const Long h = nearest.size[0], w = nearest.size[1];
    for (Long y = 0; y < h; y++) {
        for (Long x = 0; x < w; x++) {
            depth(y)[x] = nearest(y)[x];
            if (!(nearest(y)[x] < FAR)) continue;
            float* sum = found(y, x);
            const float weight = sum[5];
            const Eight weights = {weight, weight, weight, weight, weight, 1.0f, 1.0f, 1.0f};
            store<Eight>(sum, load<Eight>(sum) / weights);
        }
    }
    for (Long y = 0; y < h; y++) {
        for (Long x = 0; x < w; x++) {
            if (nearest(y)[x] < FAR) continue;
            float best = FAR;
            for (const auto& step : STEPS) {
                const Long j = step[0], i = step[1], wide = i < 0 ? -i : i;
                if (!(j <= y && y < h - j && wide <= x && x < w - wide)) continue;
                const float one = nearest(y - j)[x - i], other = nearest(y + j)[x + i];
                const bool is_one = one < FAR && size_of<float>(one - other) <= ALIKE * one;
                if (!(is_one && one < best)) continue;
                best = one;
                const float *before = found(y - j, x - i), *after = found(y + j, x + i);
                for (int c = 0; c < 5; c++) found(y, x)[c] = 0.5f * (before[c] + after[c]);
                depth(y)[x] = 0.5f * (one + other);
            }
            if (best == FAR) found(y, x)[0] = __builtin_nanf("");
        }
    }
}
EXPORT(close_cracks, crack_rows)

// Gives cells without a path that of the farthest of the next ones to the left, to the right, above
// and below: what is uncovered is background. Without any, the cell stands still.
struct Hole {
    Long y, x, row, column;  // row and column of where it gets its path from; -1 of nowhere
};
static Status hole_rows(Long, Long, Plane depth, NewField field) {
    const Long h = depth.size[0], w = depth.size[1];
    Long count = 0;
    for (Long i = 0; i < h * w; i++) count += field.at[8 * i] != field.at[8 * i];
    const Room<Hole> holes(count);
    const Room<Long> above(w);
    if (!holes || !above) return NO_MEMORY;
    for (Long k = 0; k < count; k++) holes.at[k] = {0, 0, -1, -1};
    for (int turn = 0; turn < 4; turn++) {  // down, up; each row to the right, to the left
        const bool is_back = turn % 2 == 1;
        Long k = is_back ? count : 0;
        for (Long x = 0; x < w; x++) above.at[x] = -1;
        for (Long line = 0; line < h; line++) {
            const Long y = is_back ? h - 1 - line : line;
            Long beside = -1;
            for (Long column = 0; column < w; column++) {
                const Long x = is_back ? w - 1 - column : column;
                const float path = *field(y, x);
                if (path == path) {
                    above.at[x] = y;
                    beside = x;
                    continue;
                }
                if (is_back) k--;
                Hole& hole = holes.at[k];
                const Long j = turn < 2 ? above.at[x] : y, i = turn < 2 ? x : beside;
                const bool is_known = j >= 0 && i >= 0;
                if (is_known && (hole.row < 0 || depth(j)[i] > depth(hole.row)[hole.column])) {
                    hole.row = j;
                    hole.column = i;
                }
                hole.y = y;
                hole.x = x;
                if (!is_back) k++;
            }
        }
    }
    const Eight still = {0.0f, 0.0f, 0.0f, 0.0f, 1.0f, 1.0f, 1.0f, 1.0f};
    for (Long k = 0; k < count; k++) {
        const Hole& hole = holes.at[k];
        const bool is_known = hole.row >= 0;
        const Eight path = is_known ? load<Eight>(field(hole.row, hole.column)) : still;
        store<Eight>(field(hole.y, hole.x), path);
    }
    return DONE;
}
EXPORT(fill_holes, hole_rows)

// Rows of the course of light: of still surfaces through four frames, and of sparks.
#include "between.h"

constexpr float ALIKE = 0.04f;  // relative difference in depth of what is one surface
constexpr float STILL = 0.01f;  // pixels below which a path stands still
constexpr float STEADY = 8.0f;  // times as bright light may become in four frames to be the same
// share of it by which a pixel may differ from the mean of both frames
constexpr float MEAN = 0.1f;
constexpr float SPARK = 60.0f;  // times as bright as the other frame and what is around it
constexpr float SHOWN = 32.0f;  // the same from when a spark's light is summed
constexpr int DARKER = 5;  // of eight directions in which it must be dark around a spark
constexpr byte BESIDE = 1, BRIGHT = 2, SPARKS = 3;  // marks of cells
constexpr Long REACH = 2;  // cells beside a spark that are marked

// Light through four frames.

typedef View<const byte, 2> Marks;
struct Colours {
    Field earlier, before, after, later;
    typedef Arrays<Field, Field, Field, Field> Members;
};
struct Moves {
    Field came, own, goes;
    typedef Arrays<Field, Field, Field> Members;
};
struct Depths {
    Field earlier, before, after, later;
    typedef Arrays<Field, Field, Field, Field> Members;
};
// How much each frame counts, and the time between the middle two.
struct Curve {
    float shares[4], time;
};
FN float longest(const float* moved) {
    return larger<float>(size_of<float>(moved[1]), size_of<float>(moved[0]));
}
FN float least_of_four(float a, float b, float c, float d) {
    return smaller<float>(smaller<float>(d, c), smaller<float>(b, a));
}
FN float most_of_four(float a, float b, float c, float d) {
    return larger<float>(larger<float>(d, c), larger<float>(b, a));
}

// Leads light on in pixels that show one surface, stand still and are the mean of both frames: by
// Lagrange's cubic, within what these show.
static void curve_row(Long y, Colours colours, Moves moves, Depths depths, Given<Curve> curve,
                      NewField picture) {
    const float* shares = curve->shares;
    for (Long x = 0; x < picture.size[1]; x++) {
        const float way = larger<float>(longest(moves.own(y, x)), longest(moves.came(y, x)));
        if (!(larger<float>(longest(moves.goes(y, x)), way) < STILL)) continue;
        const float i = *depths.earlier(y, x), j = *depths.before(y, x);
        const float k = *depths.after(y, x), l = *depths.later(y, x);
        const float off = most_of_four(i, j, k, l) - least_of_four(i, j, k, l);
        if (!(off <= ALIKE * j)) continue;  // something was in front
        const float *earlier = colours.earlier(y, x), *before = colours.before(y, x);
        const float *after = colours.after(y, x), *later = colours.later(y, x);
        float* to = picture(y, x);
        float p = 0.0f, q = 0.0f, r = 0.0f, s = 0.0f, apart = 0.0f;
        for (int c = 0; c < 3; c++) {
            p += earlier[c];
            q += before[c];
            r += after[c];
            s += later[c];
            apart += size_of<float>(to[c] - before[c] - curve->time * (after[c] - before[c]));
        }
        const float low = least_of_four(p, q, r, s), high = most_of_four(p, q, r, s);
        if (!(high <= STEADY * low && apart <= MEAN * low)) continue;
        for (int c = 0; c < 3; c++) {
            const float one = before[c], other = after[c];
            const float light = shares[0] * earlier[c] + shares[1] * one + shares[2] * other
                              + shares[3] * later[c];
            const float held = larger<float>(smaller<float>(other, one), light);
            to[c] = smaller<float>(larger<float>(other, one), held);
        }
    }
}
EXPORT(curve_light, curve_row)

// Sparks: isolated, bright, and gone from where a path leads in the other frame.

// Light of the brightest pixel of each cell of so many pixels along a side, one or two, summed over
// channels.
static Status brightest_rows(Long first, Long last, Field picture, Places scales, NewPlane bright) {
    const Long h = picture.size[0], w = picture.size[1], scale = Long(*scales.at);
    const Room<float> room(2 * (w + 1));
    if (!room) return NO_MEMORY;
    float* lines[2] = {room.at, room.at + w + 1};
    for (Long row = first; row < last; row++) {
        for (Long line = 0; line < scale; line++) {
            const float* from = picture(smaller<Long>(row * scale + line, h - 1));
            float* to = scale == 1 ? bright(row) : lines[line];
            across(0, w, EACH(F, Long x) {
                store<F>(to + x, pick<F, 3>(from + 3 * x) + pick<F, 3>(from + 3 * x + 1)
                                     + pick<F, 3>(from + 3 * x + 2));
            });
            if (scale > 1) to[w] = to[w - 1];
        }
        if (scale == 1) continue;
        const float *upper = lines[0], *lower = lines[1];
        across(0, bright.size[1], EACH(F, Long x) {
            const F above = larger<F>(pick<F, 2>(upper + 2 * x), pick<F, 2>(upper + 2 * x + 1));
            const F below = larger<F>(pick<F, 2>(lower + 2 * x), pick<F, 2>(lower + 2 * x + 1));
            store<F>(bright(row) + x, larger<F>(above, below));
        });
    }
    return DONE;
}
EXPORT(brightest_cells, brightest_rows)

// Whether in enough of eight directions around a cell there is less light than `most`.
struct Reach {
    Long straight, slant;  // cells
};
struct Cross {
    Long up, low, left, right;
    FN_MEMBER Cross(const Plane& bright, Long y, Long x, Long reach)
        : up(larger<Long>(y - reach, 0)), low(smaller<Long>(y + reach, bright.size[0] - 1)),
          left(larger<Long>(x - reach, 0)), right(smaller<Long>(x + reach, bright.size[1] - 1)) {}
};
FN bool is_isolated(const Plane& bright, Long y, Long x, const Reach& reach, float most) {
    const Cross far(bright, y, x, reach.straight);
    const float* row = bright(y);
    const int straight = int(bright(far.up)[x] >= most) + int(bright(far.low)[x] >= most)
                       + int(row[far.left] >= most) + int(row[far.right] >= most);
    if (straight > 8 - DARKER) return false;
    const Cross near(bright, y, x, reach.slant);
    const float *upper = bright(near.up), *lower = bright(near.low);
    const int slant = int(upper[near.left] >= most) + int(upper[near.right] >= most)
                    + int(lower[near.left] >= most) + int(lower[near.right] >= most);
    return straight + slant <= 8 - DARKER;
}
// Marks isolated bright cells. numbers: light that counts as dark, and how far away what is around
// is looked for.
static void mark_row(Long y, Plane bright, Places numbers, View<byte, 2> found) {
    const float dim = numbers.at[0];
    const Long straight = Long(numbers.at[1]);
    const Reach reach = {straight, (7 * straight + 5) / 10};
    for (Long x = 0; x < bright.size[1]; x++) {
        const float light = bright(y)[x];
        if (!(light > SHOWN * dim && is_isolated(bright, y, x, reach, light / SHOWN))) continue;
        found(y)[x] = BRIGHT;
        if (light > SPARK * dim && is_isolated(bright, y, x, reach, light / SPARK)) {
            found(y)[x] = SPARKS;
        }
    }
}
EXPORT(mark_sparks, mark_row)

// Whether a row has a mark of at least this.
FN bool has_marks(const byte* row, Long count, byte least) {
    int found = 0;
    for (Long x = 0; x < count; x++) found |= row[x] >= least;
    return found != 0;
}

// Marks what lies beside bright cells.
static void grow_rows(Long, Long, View<byte, 2> found) {
    const Long rows = found.size[0], columns = found.size[1];
    for (Long y = 0; y < rows; y++) {
        if (!has_marks(found(y), columns, BRIGHT)) continue;
        for (Long x = 0; x < columns; x++) {
            if (found(y)[x] < BRIGHT) continue;
            for (Long j = larger<Long>(y - REACH, 0); j < smaller<Long>(y + REACH + 1, rows); j++) {
                for (Long i = larger<Long>(x - REACH, 0);
                     i < smaller<Long>(x + REACH + 1, columns); i++) {
                    found(j)[i] = larger<byte>(found(j)[i], BESIDE);
                }
            }
        }
    }
}
EXPORT(grow_marks, grow_rows)

// Pictures and marks of both frames. numbers: pixels of a cell, light that counts as dark, and the
// time.
struct Look {
    float scale, dim, time;
};
struct Sparks {
    Both<Field> pictures;
    Both<Marks> marks;
    Given<Look> look;
    typedef Arrays<Both<Field>, Both<Marks>, Given<Look>> Members;

    FN_MEMBER Long scale() const { return Long(look->scale); }
    FN_MEMBER float size() const { return float(1.0 / double(look->scale)); }  // cells of a pixel
    FN_MEMBER static float light(const float* pixel) { return pixel[0] + pixel[1] + pixel[2]; }

    // The mark of the cell at a place; 0 outside.
    FN_MEMBER byte mark(const Marks& marks, float y, float x) const {
        const float v = (y + 0.5f) * size(), u = (x + 0.5f) * size();
        const bool inside = v >= 0.0f && u >= 0.0f && v < float(marks.size[0])
                         && u < float(marks.size[1]);
        return inside ? marks(Long(v))[Long(u)] : byte(0);
    }
    FN_MEMBER byte mark_before(Long y, Long x, const float* path) const {
        return mark(marks.before, float(double(y) + path[1]), float(double(x) + path[0]));
    }
    FN_MEMBER byte mark_after(Long y, Long x, const float* path) const {
        return mark(marks.after, float(double(y) + path[3]), float(double(x) + path[2]));
    }
    // The higher mark of the cells to which a path leads from the middle of one.
    FN_MEMBER byte mark_along(float y, float x, const float* path) const {
        return larger<byte>(mark(marks.before, y + path[1], x + path[0]),
                            mark(marks.after, y + path[3], x + path[2]));
    }
    // Light of the pixels of both frames to which a path leads; 0 where it leads out of one.
    struct Lights {
        float before, after;
    };
    FN_MEMBER Lights along(Long y, Long x, const float* path) const {
        const Long h = pictures.before.size[0], w = pictures.before.size[1];
        const double v = double(y) + path[1] + 0.5, u = double(x) + path[0] + 0.5;
        const double n = double(y) + path[3] + 0.5, m = double(x) + path[2] + 0.5;
        const bool inside = v >= 0.0 && v < double(h) && u >= 0.0 && u < double(w) && n >= 0.0
                         && n < double(h) && m >= 0.0 && m < double(w);
        if (!inside) return {0.0f, 0.0f};
        return {light(pictures.before(Long(v), Long(u))), light(pictures.after(Long(n), Long(m)))};
    }
};

// Takes cells, within a pixel of which only the frame that is farther in time shows a spark, from
// the nearer one alone: also a spark's edge, which a mean would leave as a ring. near: the mark of
// the cells to which the path leads; else 1 where the cell's own path, by planes, leads to marked
// ones.
static void settle_row(Long row, Sparks of, Field own, NewField cells, View<byte, 2> near) {
    const Long h = of.pictures.before.size[0], w = of.pictures.before.size[1], scale = of.scale();
    const float middle = float(0.5 * double(scale - 1)), dim = of.look->dim;
    const bool is_first = of.look->time <= 0.5f;  // whether the frame before is the nearer one
    for (Long column = 0; column < cells.size[1]; column++) {
        float* path = cells(row, column);
        const Long y = scale * row, x = scale * column;
        const float v = float(y) + middle, u = float(x) + middle;
        byte& mark = near(row)[column];
        mark = of.mark_along(v, u, path);
        if (mark == 0) {
            const float* plain = own(row, column);
            const bool is_plain = plain[0] == path[0] && plain[1] == path[1]
                               && plain[2] == path[2] && plain[3] == path[3];
            if (!is_plain) mark = smaller<byte>(of.mark_along(v, u, plain), BESIDE);
            continue;
        }
        if (path[4] + path[5] < 2.0f) continue;
        bool here = false, there = false;
        for (Long j = larger<Long>(y - 1, 0); j < smaller<Long>(y + scale + 1, h); j++) {
            for (Long i = larger<Long>(x - 1, 0); i < smaller<Long>(x + scale + 1, w); i++) {
                const Sparks::Lights lights = of.along(j, i, path);
                if (lights.before > SPARK * larger<float>(dim, lights.after)) {
                    here = here || of.mark_before(j, i, path) == SPARKS;
                } else if (lights.after > SPARK * larger<float>(dim, lights.before)) {
                    there = there || of.mark_after(j, i, path) == SPARKS;
                }
            }
        }
        if (is_first ? there > here : here > there) {
            path[4] = is_first ? 1.0f : 0.0f;
            path[5] = is_first ? 0.0f : 1.0f;
        }
    }
}
EXPORT(settle_sparks, settle_row)

// Work on the pixels of cells that have at least a mark.
template <class Work>
FN void each_marked(const Sparks& of, const Field& own, const Marks& near, byte least,
                    const Work& work) {
    const Long h = of.pictures.before.size[0], w = of.pictures.before.size[1], scale = of.scale();
    for (Long row = 0; row < own.size[0]; row++) {
        if (!has_marks(near(row), own.size[1], least)) continue;
        for (Long column = 0; column < own.size[1]; column++) {
            const byte mark = near(row)[column];
            if (mark < least) continue;
            const float* path = own(row, column);
            for (Long j = scale * row; j < smaller<Long>(scale * row + scale, h); j++) {
                for (Long i = scale * column; i < smaller<Long>(scale * column + scale, w); i++) {
                    work(path, mark, j, i);
                }
            }
        }
    }
}

// Light of sparks: of both frames by time, and of the picture.
static void sum_rows(Long, Long, Sparks of, Field own, Field picture, Marks near,
                     View<double, 1> sums) {
    const float dim = of.look->dim, time = of.look->time;
    double shown = sums.at[0], made = sums.at[1];
    each_marked(of, own, near, BESIDE, PIXELS(const float* path, byte mark, Long j, Long i) {
        if (path[4] + path[5] < 2.0f) return;
        const Sparks::Lights lights = of.along(j, i, path);
        const float p = lights.before, q = lights.after, dark = smaller<float>(q, p);
        const float light = Sparks::light(picture(j, i)), least = SHOWN * larger<float>(dim, dark);
        if (p > least && of.mark_before(j, i, path) >= BRIGHT) shown += (1.0f - time) * (p - dark);
        if (q > least && of.mark_after(j, i, path) >= BRIGHT) shown += time * (q - dark);
        if (light > least && mark >= BRIGHT) made += light - dark;
    });
    sums.at[0] = shown;
    sums.at[1] = made;
}
EXPORT(sum_sparks, sum_rows)

// Scales what the sparks of a picture add to the darker of both frames.
static void scale_rows(Long, Long, Sparks of, Field own, Places factors, Marks near,
                       NewField picture) {
    const double more = double(*factors.at) - 1.0;
    each_marked(of, own, near, BRIGHT, PIXELS(const float* path, byte, Long j, Long i) {
        const Sparks::Lights lights = of.along(j, i, path);
        const float dark = smaller<float>(lights.after, lights.before);
        float* to = picture(j, i);
        const float light = Sparks::light(to);
        if (!(light > SHOWN * larger<float>(of.look->dim, dark))) return;
        const double share = 1.0 + more * (light - dark) / light;
        for (int c = 0; c < 3; c++) to[c] = float(to[c] * share);
    });
}
EXPORT(scale_sparks, scale_rows)

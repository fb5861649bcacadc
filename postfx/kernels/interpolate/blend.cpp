// Rows of the picture that the paths make, of planes of both frames.
#include "cubic.h"

constexpr float LEAST = 1e-4f;  // weight of a frame that does not show a point
constexpr float LITTLE = 1e-3f;  // weight below which a frame does not count
// difference, squared, from which a path counts less beside others
constexpr float ALIKE = 0.0025f;
constexpr float UNSURE = 0.2f;  // stands for the difference where only one frame shows a point
constexpr float TINY = 1e-6f;  // light below which nothing counts
constexpr float NEARER = 0.1f;  // relative difference in depth of two surfaces
constexpr float HIDDEN = 0.2f;  // what is left of the share of a path that is hidden by another
constexpr float CRISP = 0.97f;  // share of detail from which a cell keeps all of it
constexpr float ELSE = 100.0f;  // times as bright as in the other frame is what only one shows
constexpr float OTHER = 0.3f;  // pixels by which paths must differ to be others
constexpr float JOINED = 0.6f;  // pixels by which cells' paths may differ with others between them
constexpr float TURNING = 3.0f;  // the same where paths change evenly from cell to cell
constexpr float SMOOTH = 0.25f;  // pixels by which that change may change

// A cell: a path in four numbers, whether both frames show the point, the share of its detail that
// they show, and whether it is joined with the next ones.
enum { FIRST = 4, LAST = 5, SHARP = 6, JOIN = 7, NUMBERS = 8 };

// Weights of the two frames, 1 together.
struct Shares {
    float before, after;
};
// By whether they show a point.
FN Shares shares_of(float first, float last, float time) {
    const float one = (1.0f - time) * (first + LEAST), other = time * (last + LEAST);
    float share = one / (one + other);
    if (share > 1.0f - LITTLE) share = 1.0f;
    if (share < LITTLE) share = 0.0f;
    return {share, 1.0f - share};
}
// All for the nearer one where light differs that much that it is something else, such as a spark,
// which a mean would show twice. dim: light that counts as dark.
FN Shares settled(Shares shares, float first, float last, float dim) {
    if (!(smaller<float>(shares.after, shares.before) > 0.0f)) return shares;
    const float least = larger<float>(dim, smaller<float>(last, first));
    if (!(larger<float>(last, first) > ELSE * least)) return shares;
    const float nearer = shares.before >= shares.after ? 1.0f : 0.0f;
    return {nearer, 1.0f - nearer};
}
FN Shares weights_of(const Both<Known>& known, const float* path, Long y, Long x, float time) {
    const bool before = is_within(known.before, double(y) + path[1], double(x) + path[0]);
    const bool after = is_within(known.after, double(y) + path[3], double(x) + path[2]);
    return shares_of(before ? path[FIRST] : 0.0f, after ? path[LAST] : 0.0f, time);
}

// Cells that follow one path.

// Whether from a cell to a next one the path changes about as much as to the one after, or from the
// last.
FN bool is_line(const Field& cells, Long y, Long x, Long j, Long i, Long c) {
    const float *here = cells(y, x), *next = cells(y + j, x + i);
    const float* before = cells(larger<Long>(y - j, 0), larger<Long>(x - i, 0));
    const float* beyond = cells(smaller<Long>(y + 2 * j, cells.size[0] - 1),
                                smaller<Long>(x + 2 * i, cells.size[1] - 1));
    const float step = next[c] - here[c], last = step - here[c] + before[c];
    const float coming = beyond[c] - next[c] - step;
    return smaller<float>(size_of<float>(coming), size_of<float>(last)) <= SMOOTH;
}
FN bool shows_same(const float* one, const float* other) {
    return one[FIRST] == other[FIRST] && one[LAST] == other[LAST];
}
FN Four apart(const float* one, const float* other) {
    return magnitude(load<Four>(other) - load<Four>(one));
}

// Marks cells that follow one path with those to the right and below by 1, and by 2 where it
// changes evenly, as on what turns.
static void join_row(Long y, NewField cells) {
    const Long rows = cells.size[0], columns = cells.size[1];
    const Field known = {cells.at, {rows, columns, NUMBERS}};
    const Long j = smaller<Long>(y + 1, rows - 1) - y;
    for (Long x = 0; x < columns; x++) {
        const Long i = smaller<Long>(x + 1, columns - 1) - x;
        float* here = cells(y, x);
        const float *right = cells(y, x + i), *low = cells(y + j, x);
        const float* across = cells(y + j, x + i);
        const bool is_one = shows_same(here, right) && shows_same(here, low)
                         && shows_same(here, across);
        const Four beside = most_of<Four>(apart(here, right), apart(here, low));
        const float most = largest_of(most_of<Four>(beside, apart(here, across)));
        if (is_one && most <= JOINED) {
            here[JOIN] = 1.0f;
            continue;
        }
        bool is_even = is_one && most <= TURNING;
        for (Long c = 0; c < 4 && is_even; c++) {
            is_even = size_of<float>(here[c] - right[c] - low[c] + across[c]) <= SMOOTH;
        }
        for (Long c = 0; c < 4 && is_even; c++) {
            is_even = is_line(known, y, x, 0, i, c) && is_line(known, y, x, j, 0, c)
                   && is_line(known, y + j, x, 0, i, c) && is_line(known, y, x + i, j, 0, c);
        }
        here[JOIN] = is_even ? 2.0f : 0.0f;
    }
}
EXPORT(join_cells, join_row)

// The cells before and after a pixel's middle, and how far it is from the first to the second one.
struct Cells {
    Long first, second;
    float share;
};
FN Cells between_cells(Long position, float size, Long count) {
    const double place = (double(position) + 0.5) * size - 0.5;
    const double at = smaller<double>(double(count - 1), larger<double>(0.0, place));
    const Long first = Long(at);
    return {first, smaller<Long>(first + 1, count - 1), float(at - double(first))};
}

// What is mixed. numbers: time, pixels of a cell, light that counts as dark, whether anything is
// not known, and how much of both ends of a path motion is.
struct Mix {
    float time, scale, dim, masked, by_first, by_last;
};
struct Planes {
    Field cells;
    Both<Field> pictures;
    Both<Known> known;
    Both<Field> depth, light, data;
    Given<Mix> numbers;
    typedef Arrays<Field, Both<Field>, Both<Known>, Both<Field>, Both<Field>, Both<Field>,
                   Given<Mix>> Members;
};
struct Mixed {
    NewField colour, light, data, motion;
    typedef Arrays<NewField, NewField, NewField, NewField> Members;
};

// A path that one pixel follows beside others, and what it shows: colours of both frames, 0 of one
// without weight; depth of its surface, 0 where it leads to another one; and that again if both
// frames show the surface, else infinity.
struct Listed {
    float path[NUMBERS];
    Long x;
    Ends ends;
    Weights weights;
    Shares shares;
    Colour before, after;
    float depth, front;
};

// One row of pixels.
struct Row {
    const Planes& of;
    Long h, w, y;
    float size, time, dim;
    Room<Cells> places;
    Room<float> room;
    Room<Shares> shares;
    Room<Ends> ends;
    Room<Weights> weights;
    Room<Listed> listed;
    float *paths, *upper, *lower, *mixture;
    Long top_known, low_known;
    Cells down;

    Row(const Planes& of)
        : of(of), h(of.pictures.before.size[0]), w(of.pictures.before.size[1]), y(0),
          size(float(1.0 / double(of.numbers->scale))), time(of.numbers->time),
          dim(of.numbers->dim), places(w), room(28 * w), shares(w), ends(w), weights(w),
          listed(4 * w), top_known(-1), low_known(-1), down{} {
        if (!*this) return;
        paths = room.at;
        upper = paths + NUMBERS * w;
        lower = upper + NUMBERS * w;
        mixture = lower + NUMBERS * w;
        for (Long i = 0; i < NUMBERS * w; i++) paths[i] = 0.0f;
        for (Long x = 0; x < w; x++) places.at[x] = between_cells(x, size, of.cells.size[1]);
    }
    explicit operator bool() const {
        return bool(places) && bool(room) && bool(shares) && bool(ends) && bool(weights)
            && bool(listed);
    }

    // A row of cells between which the pixels lie; of the shares of detail of both the larger one.
    void widen(Long row, float* wide) const {
        const float* cells = of.cells(row);
        for (Long x = 0; x < w; x++) {
            const Cells& at = places.at[x];
            const float *one = cells + NUMBERS * at.first, *other = cells + NUMBERS * at.second;
            float* to = wide + NUMBERS * x;
            store<Eight>(to, mixed<Eight>(load<Eight>(one), load<Eight>(other), at.share));
            to[JOIN] = larger<float>(other[SHARP], one[SHARP]);
        }
    }
    void find_cells() {
        down = between_cells(y, size, of.cells.size[0]);
        if (down.first != top_known) {
            if (down.first == low_known) {
                float* const kept = upper;
                upper = lower;
                lower = kept;
                low_known = -1;
            } else {
                widen(down.first, upper);
            }
            top_known = down.first;
        }
        if (down.second != low_known) {
            widen(down.second, lower);
            low_known = down.second;
        }
    }
    // Paths of pixels between two rows of cells. The last number is 0 where four cells are not
    // joined, and the others are left.
    void find_paths() const {
        const float* cells = of.cells(down.first);
        for (Long x = 0; x < w; x++) {
            const float joined = cells[NUMBERS * places.at[x].first + JOIN];
            float* path = paths + NUMBERS * x;
            if (joined > 0.0f) {
                const float *above = upper + NUMBERS * x, *below = lower + NUMBERS * x;
                store<Eight>(path, mixed<Eight>(load<Eight>(above), load<Eight>(below),
                                                down.share));
                const float most = larger<float>(below[JOIN], above[JOIN]);
                if (most > CRISP) path[SHARP] = most;
            }
            path[JOIN] = joined;
        }
    }
    void aim_all() const {
        const Four last = {float(w - 1), float(h - 1), float(w - 1), float(h - 1)};
        for (Long x = 0; x < w; x++) {
            aim(paths + NUMBERS * x, float(y), float(x), last, ends.at[x], weights.at[x]);
        }
    }

    // Colours of both frames at a path's ends.
    FN_MEMBER void sample(const Ends& at, const Weights& by, Colour& before, Colour& after) const {
        before = weigh_taps(of.pictures.before(at.before[1] - 1, at.before[0] - 1), 3 * w,
                            by.down_before, by.across_before);
        after = weigh_taps(of.pictures.after(at.after[1] - 1, at.after[0] - 1), 3 * w,
                           by.down_after, by.across_after);
    }
    FN_MEMBER Colour mean_of(const Shares& by, const Colour& before, const Colour& after) const {
        return {by.before * before.r + by.after * after.r,
                by.before * before.g + by.after * after.g,
                by.before * before.b + by.after * after.b};
    }

    // Colours of pixels where cells are joined and no edge is near; NaN elsewhere.
    void sample_joined(float* row) const {
        const Shares even = shares_of(1.0f, 1.0f, time);
        const bool masked = of.numbers->masked > 0.0f;
        for (Long x = 0; x < w; x++) {
            const float* path = paths + NUMBERS * x;
            if (masked) shares.at[x] = weights_of(of.known, path, y, x, time);
            row[3 * x] = __builtin_nanf("");
            const Ends& at = ends.at[x];
            if (path[JOIN] == 0.0f || !has_taps(at, h, w)) continue;
            if (!masked) {
                const bool both = smaller<float>(path[LAST], path[FIRST]) == 1.0f;
                shares.at[x] = both ? even : shares_of(path[FIRST], path[LAST], time);
            }
            Colour before, after;
            sample(at, weights.at[x], before, after);
            const Shares by = settled(shares.at[x], before.sum(), after.sum(), dim);
            const Colour found = mean_of(by, before, after);
            row[3 * x] = found.r;
            row[3 * x + 1] = found.g;
            row[3 * x + 2] = found.b;
        }
    }

    // Whether two cells follow one path.
    static FN_MEMBER bool are_alike(const float* one, const float* other) {
        return shows_same(one, other) && largest_of(apart(one, other)) <= OTHER;
    }
    // Which of four cells has all of another one's share, as they follow one path; itself of none.
    struct Alike {
        bool of[4][4];
    };
    static FN_MEMBER Alike alike_of(const float* (&cells)[4]) {
        Alike found = {};
        for (int k = 1; k < 4; k++) {
            for (int j = 0; j < k; j++) found.of[k][j] = are_alike(cells[k], cells[j]);
        }
        return found;
    }
    // Lists the paths of those pixels that are NaN: one between joined cells, or those of the four
    // cells around, whose shares of the pixel by its place between them are written to the mixture.
    Long list(const float* row) const {
        Long count = 0, left = -1;
        const float* cells[4] = {};
        Alike alike = {};
        const auto add = PIXELS(const float* path, Long x) {
            store<Eight>(listed.at[count].path, load<Eight>(path));
            listed.at[count++].x = x;
        };
        for (Long x = 0; x < w; x++) {
            if (row[3 * x] == row[3 * x]) continue;
            if (paths[NUMBERS * x + JOIN] > 0.0f) {
                add(paths + NUMBERS * x, x);
                continue;
            }
            const Cells& at = places.at[x];
            if (at.first != left) {
                left = at.first;
                cells[0] = of.cells(down.first, at.first);
                cells[1] = of.cells(down.first, at.second);
                cells[2] = of.cells(down.second, at.first);
                cells[3] = of.cells(down.second, at.second);
                alike = alike_of(cells);
            }
            const float low = down.share, share = at.share;
            float by[4] = {(1.0f - low) * (1.0f - share), (1.0f - low) * share,
                           low * (1.0f - share), low * share};
            for (int k = 1; k < 4; k++) {
                for (int j = 0; j < k; j++) {
                    if (!(by[j] > 0.0f && alike.of[k][j])) continue;
                    by[j] += by[k];
                    by[k] = 0.0f;
                    break;
                }
            }
            for (int k = 0; k < 4; k++) {
                mixture[4 * x + k] = by[k];
                if (by[k] > 0.0f) add(cells[k], x);
            }
        }
        return count;
    }

    // Depth of the surface that a path shows.
    FN_MEMBER void find_depth(Listed& one) const {
        const Ends& at = one.ends;
        const float before = *of.depth.before(at.near_before[1], at.near_before[0]);
        const float after = *of.depth.after(at.near_after[1], at.near_after[0]);
        const float infinite = __builtin_inff();
        if (one.path[FIRST] == 0.0f || one.path[LAST] == 0.0f) {
            one.depth = one.path[FIRST] == 0.0f ? after : before;
            one.front = infinite;
            return;
        }
        const bool is_one =
            size_of<float>(before - after) <= NEARER * smaller<float>(after, before);
        one.depth = 0.5f * (before + after) * float(is_one);
        one.front = is_one ? one.depth : infinite;
    }
    void sample_listed(Long count) const {
        const Four last = {float(w - 1), float(h - 1), float(w - 1), float(h - 1)};
        for (Long n = 0; n < count; n++) {
            Listed& one = listed.at[n];
            aim(one.path, float(y), float(one.x), last, one.ends, one.weights);
        }
        for (Long n = 0; n < count; n++) {
            Listed& one = listed.at[n];
            const float* path = one.path;
            one.shares = weights_of(of.known, path, y, one.x, time);
            const bool before = one.shares.before > 0.0f, after = one.shares.after > 0.0f;
            one.before = one.after = {0.0f, 0.0f, 0.0f};
            if (before && after && has_taps(one.ends, h, w)) {
                sample(one.ends, one.weights, one.before, one.after);
            } else {
                const double v = double(y), u = double(one.x);
                if (before) {
                    one.before = colour_at(of.pictures.before, v + path[1], u + path[0],
                                           path[SHARP]);
                }
                if (after) {
                    one.after = colour_at(of.pictures.after, v + path[3], u + path[2], path[SHARP]);
                }
            }
            if (of.depth.before.size[0]) find_depth(one);
        }
    }

    // Colours of those pixels that are NaN, by what their listed paths show. Shares in the mixture
    // become those of what is shown, and the path of a pixel the one that counts most. A path whose
    // surface lies behind one that both frames show there by another path keeps a part of its
    // share.
    void mix(float* row) const {
        const Listed* next = listed.at;
        for (Long x = 0; x < w; x++) {
            if (row[3 * x] == row[3 * x]) continue;
            if (paths[NUMBERS * x + JOIN] > 0.0f) {
                shares.at[x] = next->shares;
                const Shares by = settled(next->shares, next->before.sum(), next->after.sum(), dim);
                put(row + 3 * x, mean_of(by, next->before, next->after));
                next++;
                continue;
            }
            next = mix_pixel(row + 3 * x, mixture + 4 * x, x, next);
        }
    }
    static FN_MEMBER void put(float* to, const Colour& colour) {
        to[0] = colour.r;
        to[1] = colour.g;
        to[2] = colour.b;
    }
    FN_MEMBER const Listed* mix_pixel(float* to, float* by, Long x, const Listed* next) const {
        const bool has_depth = of.depth.before.size[0] > 0;
        const float infinite = __builtin_inff();
        float nearest = infinite, whole = 0.0f, best = 0.0f;
        const Listed *taken = next, *end = next;
        for (int k = 0; k < 4; k++) {
            if (!(by[k] > 0.0f)) continue;
            if (has_depth) nearest = smaller<float>(end->front, nearest);
            end++;
        }
        const float behind = has_depth ? (1.0f + NEARER) * nearest : infinite;
        Colour sum = {0.0f, 0.0f, 0.0f};
        for (int k = 0; k < 4; k++) {
            if (by[k] == 0.0f) continue;
            const Colour &a = next->before, &b = next->after;
            float share = has_depth && next->depth > behind ? by[k] * HIDDEN : by[k];
            const float light = size_of<float>(a.r) + size_of<float>(a.g) + size_of<float>(a.b)
                              + size_of<float>(b.r) + size_of<float>(b.g) + size_of<float>(b.b);
            const float off = size_of<float>(a.r - b.r) + size_of<float>(a.g - b.g)
                            + size_of<float>(a.b - b.b);
            const bool is_sure = next->shares.before != 0.0f && next->shares.after != 0.0f;
            const float apart = is_sure ? off / (light + TINY) : UNSURE;
            share /= ALIKE + apart * apart;
            by[k] = share;
            if (share > best) {
                best = share;
                taken = next;
            }
            const Shares both = settled(next->shares, a.sum(), b.sum(), dim);
            const Colour shown = mean_of(both, a, b);
            sum = {sum.r + share * shown.r, sum.g + share * shown.g, sum.b + share * shown.b};
            whole += share;
            next++;
        }
        put(to, {sum.r / whole, sum.g / whole, sum.b / whole});
        shares.at[x] = taken->shares;
        __builtin_memcpy(paths + NUMBERS * x, taken->path, JOIN * sizeof(float));
        ends.at[x] = taken->ends;
        for (int k = 0; k < 4; k++) by[k] /= whole;
        return next;
    }

    // Other light of pixels, of the same mixture as their colours.
    void mix_light(float* row) const {
        const Long channels = of.light.before.size[2];
        for (Long i = 0; i < w * channels; i++) row[i] = 0.0f;
        for (Long x = 0; x < w; x++) {
            float* to = row + channels * x;
            if (paths[NUMBERS * x + JOIN] > 0.0f) {
                add_path(paths + NUMBERS * x, x, shares.at[x].before, shares.at[x].after, to);
                continue;
            }
            const Cells& at = places.at[x];
            for (int k = 0; k < 4; k++) {
                const float* path = of.cells(k > 1 ? down.second : down.first,
                                             k % 2 ? at.second : at.first);
                const Shares by = weights_of(of.known, path, y, x, time);
                const float share = mixture[4 * x + k];
                add_path(path, x, share * by.before, share * by.after, to);
            }
        }
    }
    // Adds what a path shows at a pixel, by weights of the two frames, to its channels.
    void add_path(const float* path, Long x, float one, float other, float* to) const {
        const Corner before = corner_of(double(y) + path[1], double(x) + path[0], h, w);
        const Corner after = corner_of(double(y) + path[3], double(x) + path[2], h, w);
        const auto add = PIXELS(const Field& plane, const Corner& at, float weight) {
            if (!(weight > 0.0f)) return;
            const Four down_by = weights_at<Four>(Four(at.down), path[SHARP]);
            const Four across_by = weights_at<Four>(Four(at.across), path[SHARP]);
            for (Long c = 0; c < plane.size[2]; c++) {
                to[c] += weight * cubic_one(plane, at, down_by, across_by, c);
            }
        };
        add(of.light.before, before, one);
        add(of.light.after, after, other);
    }

    // Data of pixels: that of the nearest pixel in the frame that counts more.
    void take_data(float* row) const {
        const Long channels = of.data.before.size[2];
        for (Long x = 0; x < w; x++) {
            const Ends& at = ends.at[x];
            const float* from = shares.at[x].before >= shares.at[x].after
                ? of.data.before(at.near_before[1], at.near_before[0])
                : of.data.after(at.near_after[1], at.near_after[0]);
            for (Long c = 0; c < channels; c++) row[channels * x + c] = from[c];
        }
    }
    void put_motion(float* row) const {
        const float one = of.numbers->by_first, other = of.numbers->by_last;
        for (Long x = 0; x < w; x++) {
            const float* path = paths + NUMBERS * x;
            row[2 * x] = one * path[0] + other * path[2];
            row[2 * x + 1] = one * path[1] + other * path[3];
        }
    }
};

// The planes between: light is mixed, data is that of the nearest pixel in the frame that counts
// more, and motion what leads to both frames, as much of it as is asked for.
static Status compose_rows(Long first, Long last, Planes of, Mixed to) {
    Row row(of);
    if (!row) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        row.y = y;
        float* colour = to.colour(y);
        row.find_cells();
        row.find_paths();
        row.aim_all();
        row.sample_joined(colour);
        const Long count = row.list(colour);
        if (count) {
            row.sample_listed(count);
            row.mix(colour);
        }
        if (to.light.size[2]) row.mix_light(to.light(y));
        if (to.data.size[2]) row.take_data(to.data(y));
        if (to.motion.size[0]) row.put_motion(to.motion(y));
    }
    return DONE;
}
EXPORT(compose, compose_rows)

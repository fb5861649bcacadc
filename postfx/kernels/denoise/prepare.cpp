// Rows of what the network and its filters read.
#include "prepare.h"
#include "tints.h"
#include "window.h"

// Harmonic mean depth of all hits, 1 without any. Sixteen sums are kept at every level, so that all
// give the same bits.
constexpr int SUMS = 16;
typedef float Depths __attribute__((ext_vector_type(SUMS)));
typedef double Sums __attribute__((ext_vector_type(SUMS)));

FN void add_depths(Depths z, Sums& hits, Sums& near) {
    const Depths one = 1.0f, zero = 0.0f, least = NEAREST;
    Depths hit = z > zero ? one : zero;
    hit = z < FARTHEST ? hit : zero;
    hits += __builtin_convertvector(hit, Sums);
    near += __builtin_convertvector(hit > zero ? one / (z > least ? z : least) : zero, Sums);
}
static void scale_rows(Long, Long, Picture depth, View<float, 1> scale) {
    const Long count = depth.size[0] * depth.size[1];
    Sums hits = 0.0, near = 0.0;
    for (Long i = 0; i + SUMS <= count; i += SUMS) {
        Depths z;
        __builtin_memcpy(&z, depth.at + i, sizeof z);
        add_depths(z, hits, near);
    }
    Depths rest = 0.0f;
    for (Long i = 0; i < count % SUMS; i++) rest[i] = depth.at[count / SUMS * SUMS + i];
    add_depths(rest, hits, near);
    double all_hits = 0.0, all_near = 0.0;
    for (int i = 0; i < SUMS; i++) {
        all_hits += hits[i];
        all_near += near[i];
    }
    *scale.at = all_hits > 0.0 ? float(all_hits / all_near) : 1.0f;
}
EXPORT(denoise_scale, scale_rows)

// Motion of the nearest of 3x3 pixels that is clearly nearer, the first of equals; else the pixel's
// own.
static Status dilate_rows(Long first, Long last, Picture motion, Picture depth, Places rows,
                          Places columns, NewPicture moved) {
    const Long h = depth.size[0], w = depth.size[1], left = Long(columns.at[0]),
               width = moved.size[1];
    const Long count = smaller<Long>(width, w - left), line = count + 2;
    const Long before = left > 0 ? 1 : 0, after = left + count < w ? 1 : 0;
    const Room<float> lines(3 * line);
    const Room<int> found(count);
    if (!lines || !found) return NO_MEMORY;
    // pixels beyond the picture are never nearer
    for (Long i = 0; i < 3 * line; i++) lines.at[i] = __builtin_inff();
    for (Long row = first; row < last; row++) {
        const Long y = Long(rows.at[row]);
        for (int j = 0; j < 3; j++) {
            float* to = lines.at + j * line;
            const bool inside = y + j > 0 && y + j <= h;
            for (Long x = 1 - before; x < 1 + count + after; x++) {
                to[x] = inside ? depth.at[(y + j - 1) * w + left + x - 1] : __builtin_inff();
            }
        }
        across(0, count, EACH(F, Long x) {
            typedef typename Of<F>::Int I;
            F near = load<F>(lines.at + line + 1 + x) * CLEARLY;
            I at = I(0);
            UNROLL for (int k = 0; k < 9; k++) {
                const F here = load<F>(lines.at + k / 3 * line + k % 3 + x);
                at = here < near ? I((k / 3 - 1) * int(w) + k % 3 - 1) : at;
                near = here < near ? here : near;
            }
            store_int<F>(found.at + x, at);
        });
        const float* from = motion(y, left);
        float* out = moved(row);
        for (Long x = 0; x < count; x++)
            __builtin_memcpy(out + 2 * x, from + 2 * (x + found.at[x]), 2 * sizeof(float));
        across_once(0, 2 * count, EACH(F, Long i) {
            store<F>(out + i, possible_motion<F>(load<F>(out + i)));
        });
        for (Long i = 2 * count; i < 2 * width; i++) out[i] = out[i - 2];
    }
    return DONE;
}
EXPORT(denoise_dilate, dilate_rows)

// Mean reflectance of the frame's cells from the one before the part's first row and column on; the
// frame's first and last cells repeat beyond it.
static Status mean_rows(Long first, Long last, Picture diffuse, Picture specular, Places rows,
                        Places columns, NewPicture means) {
    const Long h = diffuse.size[0], w = diffuse.size[1], cells = means.size[1];
    const Long top = Long(rows.at[0]) / TRUST_CELL - 1, left = Long(columns.at[0]) / TRUST_CELL - 1;
    const Long down = (h - 1) / TRUST_CELL + 1, across_it = (w - 1) / TRUST_CELL + 1;
    const Long begin = clip(left, across_it) * TRUST_CELL;
    const Long end = smaller<Long>((clip(left + cells - 1, across_it) + 1) * TRUST_CELL, w);
    const Room<float> room(3 * (end - begin));
    if (!room) return NO_MEMORY;
    float* const sums[3] = {room.at, room.at + (end - begin), room.at + 2 * (end - begin)};
    for (Long row = first; row < last; row++) {
        const Long upper = clip(top + row, down) * TRUST_CELL,
                   lower = smaller<Long>(upper + TRUST_CELL, h);
        for (Long i = 0; i < 3 * (end - begin); i++) room.at[i] = 0.0f;
        for (Long y = upper; y < lower; y++) {
            const float *some = diffuse(y, begin), *others = specular(y, begin);
            across_once(0, end - begin, EACH(F, Long x) {
                const Tint<F> found = tint_at<F>(some, others, x);
                store<F>(sums[0] + x, load<F>(sums[0] + x) + found.red);
                store<F>(sums[1] + x, load<F>(sums[1] + x) + found.green);
                store<F>(sums[2] + x, load<F>(sums[2] + x) + found.blue);
            });
        }
        for (Long column = 0; column < cells; column++) {
            const Long start = clip(left + column, across_it) * TRUST_CELL,
                       stop = smaller<Long>(start + TRUST_CELL, w);
            const float share = 1.0f / float((lower - upper) * (stop - start));
            for (int c = 0; c < 3; c++) {
                float total = 0.0f;
                for (Long x = start - begin; x < stop - begin; x++) total += sums[c][x];
                means(row, column)[c] = total * share;
            }
        }
    }
    return DONE;
}
EXPORT(denoise_means, mean_rows)

// Where a pixel of a side lies among the frame's cells: the two whose centres are around it, from a
// first one on, and how far it is from the one before it.
struct Between {
    int before, after;
    float share;
};
FN Between cells_around(Long at, Long size, Long first) {
    const Long last = (size - 1) / TRUST_CELL;
    const float place = within<float>((float(at) + 0.5f) / TRUST_CELL - 0.5f, 0.0f, float(last));
    const Long before = Long(place);
    return {int(before - first), int(smaller<Long>(before + 1, last) - first),
            place - float(before)};
}

// Mean reflectance around each pixel of a row, for planes that are doubted.
struct Surroundings {
    Long cells, count;
    Room<float> line, share;
    Room<int> before, after;

    Surroundings(Long cells, Long count, Long left, Long w)
        : cells(cells), count(count), line(3 * cells), share(count), before(count), after(count) {
        for (Long x = 0; x < count && *this; x++) {
            const Between at = cells_around(left + x, w, left / TRUST_CELL - 1);
            before.at[x] = at.before;
            after.at[x] = at.after;
            share.at[x] = at.share;
        }
    }
    explicit operator bool() const {
        return bool(line) && bool(share) && bool(before) && bool(after);
    }

    // The means at a row of the frame, between two rows of cells.
    FN_MEMBER void find(const Picture& means, Long y, Long h, Long top) const {
        const Between at = cells_around(y, h, top / TRUST_CELL - 1);
        const float *upper = means(at.before), *lower = means(at.after);
        for (Long i = 0; i < cells; i++) {
            for (int c = 0; c < 3; c++) {
                line.at[c * cells + i] = upper[3 * i + c]
                                         + (lower[3 * i + c] - upper[3 * i + c]) * at.share;
            }
        }
    }
    template <class F> FN_MEMBER F mean(int c, Long x) const {
        const F left = gather<F>(line.at + c * cells, before.at + x);
        const F right = gather<F>(line.at + c * cells, after.at + x);
        return left + (right - left) * load<F>(share.at + x);
    }
};

// What is not known beyond the frame.
FN void clear(float* row, Long from, Long to) {
    for (Long i = from; i < to; i++) row[i] = 0.0f;
}

// Running mean of colour without reflectance; the level has it and its importance, planar. A state
// of zeros is unknown. It is so at the part's edges within the frame, because all pixels of the
// last output that are read around a known one must be known, too. Of the fine head, the last
// channels are enough.
static Status accumulate_rows(Long first, Long last, Picture colour, Picture diffuse,
                              Picture specular, Picture means, Picture depth, Picture past,
                              View<const float, 4> fine, Given<Params> params, Given<Window> window,
                              NewPicture state, NewPicture next_depth, NewPicture level,
                              NewPicture factor) {
    const Long h = colour.size[0], w = colour.size[1], th = past.size[0], tw = past.size[1];
    const Long top = Long(window->top), left = Long(window->left), skipped = FINE - fine.size[1];
    const Long rows = smaller<Long>(th, h - top), columns = smaller<Long>(tw, w - left);
    const bool under = top + th < h, beside = left + tw < w, doubts = means.size[0] > 1;
    const Surroundings around(means.size[1], doubts ? columns : 0, left, w);
    if (!around) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        const Long held = y < rows ? columns : 0;
        for (int c = 0; c < 4; c++) clear(level(c, y), held, level.size[2]);
        if (y < th) {
            clear(state(y), STATE * held, STATE * tw);
            clear(next_depth(y), held, tw);
            clear(factor(y), 3 * held, 3 * tw);
        }
        if (held == 0) continue;
        const Long v = top + y;
        if (doubts) around.find(means, v, h, top);
        const float *rgb = colour(v, left), *some = diffuse(v, left), *others = specular(v, left),
                    *before = past(y);
        const float* z = depth(v, left);
        float *kept = state(y), *by = factor(y), *far = next_depth(y);
        const auto head = [&](int channel) { return fine(0, channel - skipped, y); };
        across(0, held, EACH(F, Long x) {
            const Tint<F> tint = tint_at<F>(some, others, x);
            F reflectance[3] = {tint.red, tint.green, tint.blue};
            if (doubts) {
                const F trust = load<F>(head(PLANE_TRUST) + x);
                // not those above, which stay in registers
                F held[3] = {tint.red, tint.green, tint.blue};
                AS_IT_IS for (int c = 0; c < 3; c++) {
                    held[c] = doubted<F>(held[c], around.mean<F>(c, x), trust);
                }
                UNROLL for (int c = 0; c < 3; c++) reflectance[c] = held[c];
            }
            store_triples<F>(by + 3 * x, reflectance[0], reflectance[1], reflectance[2]);
            F own[3], earlier[4], hidden[HIDDEN];
            for (int c = 0; c < 3; c++) own[c] = pick<F, 3>(rgb + 3 * x + c);
            for (int c = 0; c < 4; c++) earlier[c] = pick<F, 4>(before + 4 * x + c);
            for (int i = 0; i < HIDDEN; i++) hidden[i] = load<F>(head(MEMORY + i) + x);
            const Light<F> light = light_of<F>(own, reflectance, params->exposure);
            const Accumulated<F> found = accumulate<F>(light, earlier, load<F>(head(DISTRUST) + x),
                                                       load<F>(head(IMPORTANCE) + x), hidden);
            for (int c = 0; c < 3; c++) store<F>(level(c, y) + x, found.level[c]);
            store<F>(level(3, y) + x, found.importance);
            store<F>(far + x, load<F>(z + x));
            store_state<F>(kept + STATE * x, found.state);
        });
        if ((y == 0 && top > 0) || (y == th - 1 && under)) {
            clear(state(y), 0, STATE * tw);
        } else {
            if (left > 0) clear(state(y), 0, STATE);
            if (beside) clear(state(y), STATE * (tw - 1), STATE * tw);
        }
    }
    return DONE;
}
EXPORT(denoise_accumulate, accumulate_rows)

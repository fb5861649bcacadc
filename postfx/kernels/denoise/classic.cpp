// Rows of the classical filter.
#include "classic.h"
#include "recall.h"
#include "tints.h"
#include "upsample_rows.h"

// Accumulation.

// 1 / depth of a row, with a number more on either side.
FN void fill_near(const float* depth, Long count, float* near) {
    across(0, count, EACH(F, Long x) {
        store<F>(near + 1 + x, nearness_of<F>(load<F>(depth + x)));
    });
    repeat_edges(near, count);
}

// A state of zeros is unknown, and so it is at the part's edges within the frame.
static Status gather_rows(Long first, Long last, Picture colour, Picture diffuse, Picture specular,
                          Picture normal, Picture depth, Picture moved, Picture state,
                          Picture last_depth, Given<Params> params, Given<Window> window,
                          Picture keep, NewPicture next_state, NewPicture next_depth,
                          NewPicture light, NewPicture surface, NewPicture factor) {
    const Long h = colour.size[0], w = colour.size[1], th = moved.size[0], tw = moved.size[1];
    const Long top = Long(window->top), left = Long(window->left);
    const Long rows = smaller<Long>(th, h - top), columns = smaller<Long>(tw, w - left);
    const bool under = top + th < h, beside = left + tw < w;
    const Recall from = {moved, state, last_depth, keep, *params, *window};
    const RecallRooms rooms(columns);
    const Room<float> room((4 + HIDDEN) * columns + 3 * (w + 2));
    if (!rooms || !room) return NO_MEMORY;
    float *past = room.at, *hidden = past + 4 * columns, *near = hidden + HIDDEN * columns;
    for (Long y = first; y < last; y++) {
        const Long held = y < rows ? columns : 0, v = top + y;
        for (int c = 0; c < 4; c++) fill(light(c, y), held, tw, 0.0f);
        for (int c = 0; c < 6; c++) fill(surface(c, y), held, tw, 0.0f);
        fill(factor(y), 3 * held, 3 * tw, 0.0f);
        fill(next_state(y), STATE * held, STATE * tw, 0.0f);
        fill(next_depth(y), held, tw, 0.0f);
        if (held == 0) continue;
        locate_row(from, y, rooms);
        recall_row(from, rooms, past, hidden, columns);
        float* lines[3];
        for (int j = 0; j < 3; j++) {
            lines[j] = near + j * (w + 2);
            fill_near(depth(clip(v + j - 1, h)), w, lines[j]);
            lines[j] += left;
        }
        const float *rgb = colour(v, left), *some = diffuse(v, left), *others = specular(v, left);
        const float *facing = normal(v, left), *far = depth(v, left);
        float *by = factor(y), *kept = next_state(y);
        across(0, held, EACH(F, Long x) {
            const Tint<F> tint = tint_at<F>(some, others, x);
            const F reflectance[3] = {tint.red, tint.green, tint.blue};
            store_triples<F>(by + 3 * x, tint.red, tint.green, tint.blue);
            F own[3];
            Past<F> before;
            for (int c = 0; c < 3; c++) own[c] = pick<F, 3>(rgb + 3 * x + c);
            for (int c = 0; c < 3; c++) before.colour[c] = pick<F, 4>(past + 4 * x + c);
            before.count = pick<F, 4>(past + 4 * x + 3);
            before.mean = load<F>(hidden + x);
            before.square = load<F>(hidden + columns + x);
            before.valid = load<F>(rooms.valid() + x);
            before.depth = load<F>(rooms.before() + x);
            const F z = load<F>(far + x);
            const Light<F> lit = light_of<F>(own, reflectance, params->exposure);
            const Gathered<F> found = gathered<F>(lit, before, z, params->gain);
            for (int c = 0; c < 4; c++) store<F>(light(c, y) + x, found.light[c]);
            store<F>(next_depth(y) + x, z);
            for (int c = 0; c < 3; c++) {
                const F value = known<F>(pick<F, 3>(facing + 3 * x + c));
                store<F>(surface(c, y) + x, within<F>(value, -1.0f, 1.0f));
            }
            const F here = load<F>(lines[1] + 1 + x);
            store<F>(surface(3, y) + x, here);
            store<F>(surface(4, y) + x,
                     slope<F>(load<F>(lines[1] + x), here, load<F>(lines[1] + 2 + x)));
            store<F>(surface(5, y) + x,
                     slope<F>(load<F>(lines[0] + 1 + x), here, load<F>(lines[2] + 1 + x)));
            store_state<F>(kept + STATE * x, found.state);
        });
        if ((y == 0 && top > 0) || (y == th - 1 && under)) {
            fill(kept, 0, STATE * tw, 0.0f);
        } else {
            if (left > 0) fill(kept, 0, STATE, 0.0f);
            if (beside) fill(kept, STATE * (tw - 1), STATE * tw, 0.0f);
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_classic_gather, gather_rows)

// The a-trous filter: taps of 1/4, 1/8 and 1/16; those beyond the picture do not count.

// A row of light and of the surface.
struct Lines {
    const float *light[4], *normal[3], *near;
};
FN Lines lines_of(const Picture& light, const Picture& surface, Long y) {
    return {{light(0, y), light(1, y), light(2, y), light(3, y)},
            {surface(0, y), surface(1, y), surface(2, y)}, surface(3, y)};
}

struct Atrous {
    Lines rows[3];   // those of the taps
    bool held[3];    // whether they are in the picture
    const float *right, *down, *spread;
    Long w, reach;

    // Numbers of a row; in blocks at its edges, 0 beyond it.
    template <class F, bool EDGE> FN_MEMBER F get(const float* row, Long x) const {
        if constexpr (!EDGE) {
            return load<F>(row + x);
        } else if constexpr (Of<F>::COUNT == 1) {
            return x >= 0 && x < w ? row[x] : 0.0f;
        } else {
            F found = F(0.0f);
            for (int i = 0; i < Of<F>::COUNT; i++) {
                if (x + i >= 0 && x + i < w) found[i] = row[x + i];
            }
            return found;
        }
    }
    template <class F, bool EDGE> FN_MEMBER Surface<F> surface_at(const Lines& from, Long x,
                                                                  const F (&rgb)[3]) const {
        Surface<F> found;
        for (int c = 0; c < 3; c++) found.normal[c] = get<F, EDGE>(from.normal[c], x);
        found.near = get<F, EDGE>(from.near, x);
        found.lum = luminance<F>(rgb[0], rgb[1], rgb[2]);
        return found;
    }
    template <class F, bool EDGE> FN_MEMBER void pixel(Long x, float* const (&out)[4]) const {
        F rgb[3], sums[4], total = F(0.25f);
        for (int c = 0; c < 3; c++) {
            rgb[c] = load<F>(rows[1].light[c] + x);
            sums[c] = 0.25f * rgb[c];
        }
        sums[3] = 0.0625f * load<F>(rows[1].light[3] + x);
        const Surface<F> own = surface_at<F, false>(rows[1], x, rgb);
        const F across = load<F>(right + x), along = load<F>(down + x), sharp = load<F>(spread + x);
        for (int j = 0; j < 3; j++) {
            if (!held[j]) continue;
            const F upward = along * float((j - 1) * reach);
            for (int i = 0; i < 3; i++) {
                if (i == 1 && j == 1) continue;
                const Lines& from = rows[j];
                const Long u = x + (i - 1) * reach;
                F other[3];
                for (int c = 0; c < 3; c++) other[c] = get<F, EDGE>(from.light[c], u);
                const Surface<F> there = surface_at<F, EDGE>(from, u, other);
                const F way = across * float((i - 1) * reach) + upward;
                const float share = i == 1 || j == 1 ? 0.125f : 0.0625f;
                F weight = share * likeness<F>(own, there, way, sharp);
                if constexpr (EDGE) {
                    const F place = ramp<F>(float(u), 1.0f);
                    weight = place >= 0.0f ? weight : F(0.0f);
                    weight = place < float(w) ? weight : F(0.0f);
                }
                total += weight;
                for (int c = 0; c < 3; c++) sums[c] += weight * other[c];
                sums[3] += weight * weight * get<F, EDGE>(from.light[3], u);
            }
        }
        const F share = 1.0f / total;
        for (int c = 0; c < 3; c++) store<F>(out[c] + x, sums[c] * share);
        store<F>(out[3] + x, sums[3] * share * share);
    }
};

// 1 / (4 standard deviations of luminance), from the variance of 3x3 pixels; `line` has a number
// more on either side.
FN void fill_spread(const float* above, const float* here, const float* below, Long w, float* line,
                    float* spread) {
    across(0, w, EACH(F, Long x) {
        const F outer = load<F>(above + x) + load<F>(below + x);
        store<F>(line + 1 + x, 0.25f * outer + 0.5f * load<F>(here + x));
    });
    repeat_edges(line, w);
    across(0, w, EACH(F, Long x) {
        const F outer = load<F>(line + x) + load<F>(line + 2 + x);
        const F found = 0.25f * outer + 0.5f * load<F>(line + 1 + x);
        store<F>(spread + x, 1.0f / (LUMINANCE * root_of(found) + 1e-4f));
    });
}

static Status atrous_rows(Long first, Long last, Picture light, Picture surface, Given<float> step,
                          Given<Window> window, NewPicture smooth) {
    const Long h = smaller<Long>(light.size[1], Long(window->height) - Long(window->top));
    const Long w = smaller<Long>(light.size[2], Long(window->width) - Long(window->left));
    const Long reach = Long(*step);
    const Room<float> room(2 * w + 2);
    if (!room) return NO_MEMORY;
    float *spread = room.at, *line = spread + w;
    // Blocks without a tap beyond the row.
    const Long begin = smaller<Long>(reach, w), end = larger<Long>(w - reach, begin);
    for (Long y = first; y < last; y++) {
        float* const out[4] = {smooth(0, y), smooth(1, y), smooth(2, y), smooth(3, y)};
        for (float* row : out) fill(row, y < h ? w : 0, smooth.size[2], 0.0f);
        if (y >= h) continue;
        fill_spread(light(3, larger<Long>(y - 1, 0)), light(3, y),
                    light(3, smaller<Long>(y + 1, h - 1)), w, line, spread);
        Atrous filter = {{}, {}, surface(4, y), surface(5, y), spread, w, reach};
        for (int j = 0; j < 3; j++) {
            const Long v = y + (j - 1) * reach;
            filter.held[j] = v >= 0 && v < h;
            if (filter.held[j]) filter.rows[j] = lines_of(light, surface, v);
        }
        const auto edge = EACH(F, Long x) { filter.pixel<F, true>(x, out); };
        const bool wide = end - begin >= WIDE;
        if (wide) {
            across(begin, end, EACH(F, Long x) {
                filter.pixel<F, false>(x, out);
            });
        }
        const Long spans[2][2] = {{0, wide ? begin : w}, {wide ? end : w, w}};
        for (const auto& span : spans) {
            for (Long x = span[0]; x < span[1];) {
                // A whole block where the row has room for one, over pixels that are made already.
                if (w >= WIDE) edge(Wide(), x + WIDE <= w ? x : w - WIDE);
                else edge(float(), x);
                x += w >= WIDE ? WIDE : 1;
            }
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_atrous, atrous_rows)

// Light at the output's pixels, by a Gaussian around each.

// A row of light with its reflectance, the first and last pixel once more on either side.
FN void shade(const Picture& light, const Picture& factor, Long y, Long count, float* rows,
              Long apart) {
    const float* by = factor(y);
    across(0, count, EACH(F, Long x) {
        for (int c = 0; c < 3; c++) {
            store<F>(rows + c * apart + 1 + x,
                     load<F>(light(c, y) + x) * pick<F, 3>(by + 3 * x + c));
        }
    });
    for (int c = 0; c < 3; c++) repeat_edges(rows + c * apart, count);
}

static Status resolve_rows(Long first, Long last, Picture light, Picture factor,
                           Given<Params> params, Given<Window> window, NewPicture output,
                           NewPicture history) {
    const Long width = output.size[1];
    const Long h = smaller<Long>(light.size[1], Long(window->height) - Long(window->top));
    const Long w = smaller<Long>(light.size[2], Long(window->width) - Long(window->left));
    const Long apart = w + 2;
    const Room<float> room(3 * width + 12 * apart);
    const Room<int> index(width);
    if (!room || !index) return NO_MEMORY;
    float *near = room.at, *rows = near + 3 * width, *columns = rows + 9 * apart;
    bool twice = width % 2 == 0;
    for (Long x = 0; x < width; x++) {
        const Place at = column_of(*window, x, w);
        const Distances found = distances_of(params->jitter_x - at.offset);
        const float total = TINY + found.near[0] + found.near[1] + found.near[2];
        for (int i = 0; i < 3; i++) near[i * width + x] = found.near[i] / total;
        index.at[x] = int(at.index);
        twice = twice && at.index == x / 2;
    }
    Long kept = -1;
    const float darken = 1.0f / params->exposure;
    for (Long y = first; y < last; y++) {
        const Place at = row_of(*window, y, h);
        for (int j = 0; j < 3 && kept != at.index; j++) {
            shade(light, factor, clip(at.index + j - 1, h), w, rows + 3 * j * apart, apart);
        }
        kept = at.index;
        const Distances down = distances_of(params->jitter_y - at.offset);
        const float total = TINY + down.near[0] + down.near[1] + down.near[2];
        across(0, 3 * apart, EACH(F, Long i) {
            F sum = F(0.0f);
            for (int j = 0; j < 3; j++) {
                sum += load<F>(rows + 3 * j * apart + i) * (down.near[j] / total);
            }
            store<F>(columns + i, sum);
        });
        float *out = output(y), *logs = history(y);
        const auto pixels = EACH(F, Long x, const auto& sample) {
            F encoded[3], found[3];
            for (int c = 0; c < 3; c++) {
                F sum = F(0.0f);
                for (int i = 0; i < 3; i++) {
                    sum += sample(columns + c * apart + i) * load<F>(near + i * width + x);
                }
                const F log = log_encode<F>(sum);
                encoded[c] = log <= MOST_LOG ? log : F(0.0f);
                found[c] = expm1_of<F>(encoded[c]) * darken;
            }
            store_triples<F>(logs + 3 * x, encoded[0], encoded[1], encoded[2]);
            store_triples<F>(out + 3 * x, found[0], found[1], found[2]);
        };
        if (twice) {
            across(0, width, EACH(F, Long x) {
                pixels(F(), x, PIXELS(const float* row) {
                    if constexpr (Of<F>::COUNT == 1) return row[x / 2];
                    else return each_twice<F>(row + x / 2);
                });
            });
        } else {
            across(0, width, EACH(F, Long x) {
                pixels(F(), x, PIXELS(const float* row) { return gather<F>(row, index.at + x); });
            });
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_resolve, resolve_rows)

// Rows of the pyramid. Levels hold one plane, a picture of three, or several pictures: the weights
// of a row are read once for each of them.
#include "fine_codes.h"
#include "pyramid.h"

typedef View<const float, 3> Planes;
typedef View<float, 3> NewPlanes;

// Pooling: cells begin at given rows and columns of the finer level; pixels beyond it have no
// weight.

FN bool is_beyond(const Planes& planes, Long y, Long x) {
    return y < 0 || y >= planes.size[1] || x < 0 || x >= planes.size[2];
}

template <class F, bool EDGE>
FN F finer_pixel(const Planes& planes, Long k, Long y, Long x) {
    if (EDGE && is_beyond(planes, y, x)) return F(0.0f);
    return pick<F, 2>(planes(k, y) + x);
}

template <class F, bool EDGE> FN F finer_weight(const Planes& weights, Long y, Long x) {
    if (EDGE && is_beyond(weights, y, x)) return F(0.0f);
    return larger<F>(F(LEAST_IMPORTANCE), pick<F, 2>(weights(0, y) + x));  // NaN stays
}

template <class F, bool EDGE>
FN void pool_cell(const Planes& finer, const Planes& weights, Long v, Long u, NewPlanes& level,
                  NewPlanes& importance, Long y, Long x) {
    const Cell<F> cell = cell_of<F>(
        finer_weight<F, EDGE>(weights, v, u), finer_weight<F, EDGE>(weights, v, u + 1),
        finer_weight<F, EDGE>(weights, v + 1, u), finer_weight<F, EDGE>(weights, v + 1, u + 1));
    for (Long k = 0; k < level.size[0]; k++) {
        store<F>(level(k, y) + x,
                 pooled<F>(cell, finer_pixel<F, EDGE>(finer, k, v, u),
                           finer_pixel<F, EDGE>(finer, k, v, u + 1),
                           finer_pixel<F, EDGE>(finer, k, v + 1, u),
                           finer_pixel<F, EDGE>(finer, k, v + 1, u + 1)));
    }
    store<F>(importance(0, y) + x, cell.importance);
}

static void pool_row(Long y, Planes finer, Planes finer_importance, Places finer_rows,
                     Places finer_columns, NewPlanes level, NewPlanes importance) {
    const Long h = finer.size[1], w = finer.size[2], width = level.size[2];
    const Long left = Long(finer_columns.at[0]);
    const Long begin = left < 0 ? 1 : 0;
    const Long end = smaller<Long>(width, (w - left) / 2);
    const Long row = Long(finer_rows.at[y]);
    const bool whole = row >= 0 && row + 1 < h && begin < end;
    const auto edge = [&](Long x) {
        pool_cell<float, true>(finer, finer_importance, row, left + 2 * x, level, importance, y, x);
    };
    if (whole) {
        across(begin, end, EACH(F, Long x) {
            pool_cell<F, false>(finer, finer_importance, row, left + 2 * x, level,
                                importance, y, x);
        });
    }
    for (Long x = 0; x < (whole ? begin : width); x++) edge(x);
    for (Long x = end; whole && x < width; x++) edge(x);
}
EXPORT(denoise_pool, pool_row)

// All rows of a level; for each row and column, the row and column of the coarser level that it
// lies in is given. Of the fine head, the last channels are enough.
static void mix_rows(Long first, Long last, Planes coarse, Planes level, View<const float, 4> heads,
                     Places coarse_rows, Places coarse_columns, NewPlanes mixed) {
    const Long channels = heads.size[1], w = mixed.size[2];
    const Long share = channels == KERNEL + 1 ? KERNEL : MIX - (FINE - channels);
    const Long second = coarse_columns.size[0] > 1 && coarse_columns.at[1] > 0;
    for (Long y = first; y < last; y++) {
        const float* shares = heads(0, share, y);
        for (Long k = 0; k < mixed.size[0]; k++) {
            const float* below = coarse(k, Long(coarse_rows.at[y]));
            const float* own = level(k, y);
            float* out = mixed(k, y);
            const auto pixels = EACH(F, Long x) {
                store<F>(out + x, mixed_pixel<F>(each_twice<F>(below + (x + second) / 2),
                                                 load<F>(own + x), load<F>(shares + x)));
            };
            // vectors begin with a cell
            const Long even = w > second ? w - (w - second) % WIDE : w;
            for (Long x = 0; x < second; x++) pixels(float(), x);
            for (Long x = second; x < even; x += WIDE) pixels(Wide(), x);
            for (Long x = even; x < w; x++) pixels(float(), x);
        }
    }
}
EXPORT(denoise_mix, mix_rows)

// A normalised 5x5 kernel of its own for every pixel: taps beyond the picture do not count.
constexpr int SIDE = 5;
constexpr int REACH = 2;
struct Filter {
    const float* planes;
    const float* weights;  // of a row; the next tap's lie a step behind
    Long plane, line, step;
    Long bottom, right;
};

// Sums over taps, of which each row's lie in the picture.
template <class F, int CHANNELS> struct Filtered {
    F total = F(TINY), sums[CHANNELS] = {};

    FN_MEMBER void add(const Filter& filter, Long y, Long x, Long row, Long column) {
        const float* planes = filter.planes + (y + row - REACH) * filter.line + x + column - REACH;
        const F weight = load<F>(filter.weights + (row * SIDE + column) * filter.step + x);
        total += weight;
        UNROLL for (int c = 0; c < CHANNELS; c++) {
            sums[c] += weight * load<F>(planes + c * filter.plane);
        }
    }
    FN_MEMBER void store_at(float* out, Long plane) const {
        UNROLL for (int c = 0; c < CHANNELS; c++) store<F>(out + c * plane, sums[c] / total);
    }
};
// All of them, and those of the rows and columns that the picture has.
template <class F, int CHANNELS>
FN Filtered<F, CHANNELS> filter_inside(const Filter& filter, Long y, Long x) {
    Filtered<F, CHANNELS> found;
    UNROLL for (int tap = 0; tap < KERNEL; tap++) found.add(filter, y, x, tap / SIDE, tap % SIDE);
    return found;
}
template <class F, int CHANNELS>
FN Filtered<F, CHANNELS> filter_edge(const Filter& filter, Long y, Long x) {
    const Long top = larger<Long>(REACH - y, 0);
    const Long bottom = smaller<Long>(filter.bottom - y + REACH, SIDE);
    const Long width = Of<F>::COUNT;  // a vector is not beside the left or the right edge
    const Long left = width > 1 ? 0 : larger<Long>(REACH - x, 0);
    const Long right = width > 1 ? SIDE : smaller<Long>(filter.right - x + REACH, SIDE);
    Filtered<F, CHANNELS> found;
    AS_IT_IS for (Long row = top; row < bottom; row++) {
        AS_IT_IS for (Long i = left; i < right; i++) found.add(filter, y, x, row, i);
    }
    return found;
}

// Filtering a row, whose weights may lie anywhere.

template <int CHANNELS> ONCE void filter_planes(Filter filter, Long y, float* out) {
    const Long left = smaller<Long>(REACH, filter.right);
    const Long right = larger<Long>(left, filter.right - REACH);
    const bool wide = right - left >= WIDE, inside = y >= REACH && y < filter.bottom - REACH;
    AS_IT_IS for (Long n = left; wide && n < right; n += WIDE) {
        const Long x = n <= right - WIDE ? n : right - WIDE;
        if (inside) filter_inside<Wide, CHANNELS>(filter, y, x).store_at(out + x, filter.plane);
        else filter_edge<Wide, CHANNELS>(filter, y, x).store_at(out + x, filter.plane);
    }
    AS_IT_IS for (Long x = 0; x < filter.right; x++) {
        if (wide && x == left) x = right;
        filter_edge<float, CHANNELS>(filter, y, x).store_at(out + x, filter.plane);
    }
}

FN void filter_planes(const Planes& mixed, const float* weights, Long step, Long y,
                      const View<const float, 1>& area, const NewPlanes& filtered) {
    const Long plane = mixed.size[1] * mixed.size[2], w = mixed.size[2];
    const Long bottom = Long(area.at[0]), right = y < bottom ? Long(area.at[1]) : 0;
    const bool one = mixed.size[0] == 1;
    for (Long k = 0; k < mixed.size[0]; k += 3) {
        const Filter filter = {mixed(k), weights, plane, w, step, bottom, right};
        if (right > 0 && one) filter_planes<1>(filter, y, filtered(k, y));
        if (right > 0 && !one) filter_planes<3>(filter, y, filtered(k, y));
        for (int c = 0; c < (one ? 1 : 3); c++) {
            for (Long x = right; x < w; x++) filtered(k + c, y)[x] = 0;
        }
    }
}

static void filter_row(Long y, Planes mixed, View<const float, 4> heads, Places area,
                       NewPlanes filtered) {
    const Long step = heads.size[2] * heads.size[3];
    filter_planes(mixed, heads(0, 0, y), step, y, area, filtered);
}
EXPORT(denoise_filter, filter_row)

// The same at the finest level, whose weights are made of codes, two rows at a time.
static Status filter_codes_rows(Long first, Long last, Planes mixed, Codes codes, Factors factors,
                                Scaling scaling, Places area, NewPlanes filtered) {
    const Long w = 2 * codes.size[2];
    const Room<int> turned(room_for(codes));
    const Room<float> weights(KERNEL * 2 * w);
    if (!turned || !weights) return NO_MEMORY;
    Long pair = -1;
    for (Long y = first; y < last; y++) {
        if (pair != y / 2) {
            pair = y / 2;
            open_fine_row(codes, pair, factors, scaling, 0, KERNEL, turned.at, weights.at, 2 * w);
        }
        filter_planes(mixed, weights.at + y % 2 * w, 2 * w, y, area, filtered);
    }
    return DONE;
}
EXPORT(denoise_filter_codes, filter_codes_rows)

// Filtered colour times reflectance: a border of repeated pixels lies around it, and rows and
// columns of the part that lie beyond the frame repeat its last ones.

ONCE void remodulate_row(Long row, const Planes& filtered, const float* factor, Long y, Long held,
                         Long w, Long plane, const NewPlanes& radiance) {
    for (int c = 0; c < 3; c++) {
        const float* from = filtered(c, y);
        float* out = radiance(plane + c, row) + 1;
        across(0, held, EACH(F, Long x) {
            const F light = load<F>(from + x);
            store<F>(out + x, factor ? light * pick<F, 3>(factor + 3 * x + c) : light);
        });
        fill(out, held, w + 1, out[held - 1]);
        out[-1] = out[0];
    }
}
// BOTH: filtered colour, then the same times reflectance.
template <bool BOTH>
static void remodulate(Long row, Planes filtered, Picture factor, Places part_rows,
                       Places part_columns, NewPlanes radiance) {
    const Long h = part_rows.size[0], w = part_columns.size[0];
    const Long y = Long(part_rows.at[clip(row - 1, h)]) - Long(part_rows.at[0]);
    const Long held = Long(part_columns.at[w - 1]) - Long(part_columns.at[0]) + 1;
    if (BOTH) remodulate_row(row, filtered, nullptr, y, held, w, 0, radiance);
    remodulate_row(row, filtered, factor(y), y, held, w, BOTH ? 3 : 0, radiance);
}
EXPORT(denoise_remodulate, remodulate<false>)
EXPORT(denoise_remodulate_both, remodulate<true>)

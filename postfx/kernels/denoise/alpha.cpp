// Rows of alpha. Where it is 0 or 1 all around nothing is worked on, so rows are made in spans of
// cells.
#include "alpha.h"
#include "history.h"
#include "upsample_rows.h"

typedef View<const float, 2> Cells;

template <class F> FN F one_where_moved(const float* moved) {
    const F zero = F(0.0f), one = F(1.0f);
    const F across = size_of<F>(pick<F, 2>(moved)), down = size_of<F>(pick<F, 2>(moved + 1));
    return across >= LEAST_MOTION ? one : down >= LEAST_MOTION ? one : zero;
}

// Mean of the four samples of render pixels, in two rows from the first pixel on.
template <class F> FN F mean_of_samples(const float* upper, const float* lower) {
    return 0.25f
         * (pick<F, 2>(upper) + pick<F, 2>(upper + 1) + pick<F, 2>(lower) + pick<F, 2>(lower + 1));
}

// Over 3x3 pixels of three rows, each from its first pixel on.
template <class F>
FN Sums<F> sums_around(const float* above, const float* here, const float* below) {
    F total[3], squares = F(0.0f), steps = F(0.0f);
    UNROLL for (int i = 0; i < 3; i++) {
        const F a = load<F>(above + i), b = load<F>(here + i), c = load<F>(below + i);
        total[i] = a + b + c;
        squares += a * a + b * b + c * c;
        steps += c - a;
    }
    return {total[0] + total[1] + total[2], squares, total[2] - total[0], steps};
}

// Spans of pixels along a row of some width whose cells of NEAR_CELL pixels are near; the last cell
// goes on to its end.
template <class Near, class Work>
FN void each_span(Long cells, Long width, const Near& near, const Work& work) {
    for (Long k = 0; k < cells; k++) {
        if (!near(k)) continue;
        const Long first = NEAR_CELL * k;
        while (k < cells && near(k)) k++;
        work(first, k == cells ? width : smaller<Long>(NEAR_CELL * k, width));
    }
}

// Those of the row y of render pixels, and of all that rows above, at and below it read.
FN const float* cells_of(const Cells& near, Long y) {
    return near(smaller<Long>(larger<Long>(y, 0) / NEAR_CELL, near.size[0] - 1));
}
template <class Work> FN void each_span_at(const Cells& near, Long y, float least,
                                                    Long width, const Work& work) {
    const float* cells = cells_of(near, y);
    each_span(near.size[1], width, PIXELS(Long k) { return cells[k] >= least; }, work);
}
template <class Work>
FN void each_span_around(const Cells& near, Long y, Long width, const Work& work) {
    const float *above = cells_of(near, y - 1), *here = cells_of(near, y),
                *below = cells_of(near, y + 1);
    each_span(near.size[1], width, PIXELS(Long k) {
        return above[k] >= 1.0f || here[k] >= 1.0f || below[k] >= 1.0f;
    }, work);
}

// Means of samples.

// What samples of a row were before, by quarter-pixels, what the frame's alpha adds to their means,
// and the variance of these, -1 where they are not known.
struct Predicted {
    float *own, *off, *variance, *quarters;
    Long width;

    Predicted(float* at, Long width)
        : own(at), off(at + width), variance(at + 2 * width), quarters(at + 3 * width),
          width(width) {}
    FN_MEMBER float* quarter(int i) const { return quarters + i * width; }
};

// Where a row's samples were: the first of 5x5, its place if they and three numbers more lie in the
// picture, else -1; the pixel whose doubt counts, -1 where there is none; and weights.
struct Former {
    const float *samples, *doubt;
    Long h, w, height, width;
    float* weights;
    int *top, *left, *start, *pixel;

    FN_MEMBER void find(const float* moved, Long y, Long x0, Long x1) const {
        across(x0, x1, EACH(F, Long x) {
            const F by_x = pick<F, 2>(moved + 2 * x), by_y = pick<F, 2>(moved + 2 * x + 1);
            const F at_x = ramp<F>(float(x), 1.0f) + by_x, at_y = float(y) + by_y;
            F held = F(1.0f);
            held = at_x >= -0.5f ? held : F(0.0f);
            held = at_x <= float(w) - 0.5f ? held : F(0.0f);
            held = at_y >= -0.5f ? held : F(0.0f);
            held = at_y <= float(h) - 0.5f ? held : F(0.0f);
            const F near_x = within<F>(floor_of(at_x + 0.5f), 0.0f, float(w - 1));
            const F near_y = within<F>(floor_of(at_y + 0.5f), 0.0f, float(h - 1));
            const typename Of<F>::Int found = whole(near_y) * int(w) + whole(near_x);
            store_int<F>(pixel + x, whole(held) == 1 ? found : typename Of<F>::Int(-1));
            const F twice_x = held > 0.0f ? by_x + by_x : F(0.0f),
                    twice_y = held > 0.0f ? by_y + by_y : F(0.0f);
            const F far_x = floor_of(twice_x), far_y = floor_of(twice_y);
            F columns[CUBIC], rows[CUBIC];
            cubic<F>(twice_x - far_x, columns);
            cubic<F>(twice_y - far_y, rows);
            for (int i = 0; i < CUBIC; i++) {
                store<F>(weights + i * w + x, columns[i]);
                store<F>(weights + (CUBIC + i) * w + x, rows[i]);
            }
            const F first = ramp<F>(float(2 * x - 1), 2.0f) + far_x,
                    upper = far_y + float(2 * y - 1);
            F inside = held;
            inside = first >= 0.0f ? inside : F(0.0f);
            inside = first <= float(width - 8) ? inside : F(0.0f);
            inside = upper >= 0.0f ? inside : F(0.0f);
            inside = upper <= float(height - 5) ? inside : F(0.0f);
            store_int<F>(top + x, whole(upper));
            store_int<F>(left + x, whole(first));
            const typename Of<F>::Int place = whole(upper) * int(width) + whole(first);
            store_int<F>(start + x, whole(inside) == 1 ? place : typename Of<F>::Int(-1));
        });
    }

    // The four quarter-pixels of a pixel.
    FN_MEMBER void sample(Long x, const Predicted& found) const {
        float columns[CUBIC], rows[CUBIC];
        for (int i = 0; i < CUBIC; i++) {
            columns[i] = weights[i * w + x];
            rows[i] = weights[(CUBIC + i) * w + x];
        }
        float four[4];
        if (start[x] >= 0) {
            const float* at = samples + start[x];
            const Eight second = load<Eight>(at + width), third = load<Eight>(at + 2 * width);
            const Eight fourth = load<Eight>(at + 3 * width);
            const Eight upper = load<Eight>(at) * rows[0] + second * rows[1] + third * rows[2]
                              + fourth * rows[3];
            const Eight lower = second * rows[0] + third * rows[1] + fourth * rows[2]
                              + load<Eight>(at + 4 * width) * rows[3];
            const Four one = __builtin_shufflevector(upper, lower, 0, 1, 8, 9) * columns[0]
                           + __builtin_shufflevector(upper, lower, 1, 2, 9, 10) * columns[1]
                           + __builtin_shufflevector(upper, lower, 2, 3, 10, 11) * columns[2]
                           + __builtin_shufflevector(upper, lower, 3, 4, 11, 12) * columns[3];
            __builtin_memcpy(four, &one, sizeof four);
        } else {
            for (int i = 0; i < 4; i++)
                four[i] = at_edge(top[x] + i / 2, left[x] + i % 2, rows, columns);
        }
        for (int i = 0; i < 4; i++) found.quarter(i)[x] = four[i];
    }
    // One of them near the picture's edge, which is repeated.
    FN_MEMBER float at_edge(Long y, Long x, const float* rows, const float* columns) const {
        float total = 0.0f;
        for (int j = 0; j < CUBIC; j++) {
            const float* row = samples + clip(y + j, height) * width;
            float line = 0.0f;
            for (int i = 0; i < CUBIC; i++) line += row[clip(x + i, width)] * columns[i];
            total += line * rows[j];
        }
        return total;
    }

    FN_MEMBER void predict(const float* moved, Long y, Long x0, Long x1, const Rates& rates,
                           const Predicted& found) const {
        find(moved, y, x0, x1);
        for (Long x = x0; x < x1; x++) {
            found.variance[x] = pixel[x] >= 0 ? doubt[pixel[x]] : -1.0f;
            if (found.variance[x] >= 0.0f) sample(x, found);
        }
        across_once(x0, x1, EACH(F, Long x) {
            const F variance = load<F>(found.variance + x), zero = F(0.0f);
            const F sum = load<F>(found.quarter(0) + x) + load<F>(found.quarter(1) + x)
                        + load<F>(found.quarter(2) + x) + load<F>(found.quarter(3) + x);
            const F off = load<F>(found.own + x) - sum * 0.25f;
            const F drift = one_where_moved<F>(moved + 2 * x) * rates.drift;
            store<F>(found.off + x, variance >= 0.0f ? off : zero);
            store<F>(found.variance + x, variance >= 0.0f ? variance + drift : F(-1.0f));
        });
    }
};

// Sums of 3x3 numbers along rows of a width, edge repeated: of rows' sums, with a number more on
// either side.
FN void sum_rows(const float* above, const float* here, const float* below, Long width,
                           float* sums) {
    across(0, width, EACH(F, Long x) {
        store<F>(sums + 1 + x, load<F>(above + x) + load<F>(here + x) + load<F>(below + x));
    });
    repeat_edges(sums, width);
}
template <class F> FN F sum_of_three(const float* sums, Long x) {
    return load<F>(sums + x) + load<F>(sums + x + 1) + load<F>(sums + x + 2);
}

static Status gather_rows(Long first, Long last, Picture alpha, Picture moved, Picture samples,
                          Picture doubt, Cells near, Given<Rates> rates, NewPicture next_samples,
                          NewPicture next_doubt) {
    const Long h = alpha.size[0], w = alpha.size[1];
    const Room<float> room(3 * 7 * w + 2 * CUBIC * w + 2 * (w + 2));
    const Room<int> places(4 * w);
    if (!room || !places) return NO_MEMORY;
    float *weights = room.at + 21 * w, *apart = weights + 2 * CUBIC * w, *level = apart + w + 2;
    const Former former = {samples.at, doubt.at, h, w, samples.size[0], samples.size[1], weights,
                           places.at, places.at + w, places.at + 2 * w, places.at + 3 * w};
    const auto kept = [&](Long y) { return Predicted(room.at + (y + 3) % 3 * 7 * w, w); };
    for (Long y = first - 1; y <= last; y++) {
        const Predicted found = kept(y);
        const Long row = clip(y, h);
        across(0, w, EACH(F, Long x) {
            store<F>(found.own + x, within<F>(load<F>(alpha(row) + x), 0.0f, 1.0f));
            store<F>(found.off + x, F(0.0f));
            store<F>(found.variance + x, F(-1.0f));
        });
        each_span_at(near, row, 1.0f, w, PIXELS(Long x0, Long x1) {
            if (rates->keep > 0.0f) former.predict(moved(row), row, x0, x1, *rates, found);
        });
        if (y <= first) continue;
        const Long at = y - 1;
        const Predicted here = kept(at);
        float *upper = next_samples(2 * at), *lower = next_samples(2 * at + 1),
              *next = next_doubt(at);
        across(0, w, EACH(F, Long x) {
            const F own = load<F>(here.own + x);
            store_pairs<F>(upper + 2 * x, own, own);
            store_pairs<F>(lower + 2 * x, own, own);
            store<F>(next + x, F(rates->variance));
        });
        bool summed = false;
        each_span_at(near, at, 1.0f, w, PIXELS(Long x0, Long x1) {
            if (!summed) {
                sum_rows(kept(at - 1).off, here.off, found.off, w, apart);
                sum_rows(kept(at - 1).own, here.own, found.own, w, level);
            }
            summed = true;
            across(x0, x1, EACH(F, Long x) {
                const Update<F> to =
                    updated<F>(load<F>(here.off + x), load<F>(here.variance + x),
                               sum_of_three<F>(apart, x), sum_of_three<F>(level, x), *rates);
                const F own = load<F>(here.own + x);
                F four[4];
                for (int i = 0; i < 4; i++) {
                    const F value = within<F>(load<F>(here.quarter(i) + x) + to.step, 0.0f, 1.0f);
                    four[i] = to.anew > 0.0f ? own : value;
                }
                store_pairs<F>(upper + 2 * x, four[0], four[1]);
                store_pairs<F>(lower + 2 * x, four[2], four[3]);
                store<F>(next + x, to.anew > 0.0f ? F(rates->variance) : to.doubt);
            });
        });
    }
    return DONE;
}
EXPORT_ALONE(denoise_gather, gather_rows)

// Means of the output's pixels in render pixels.

template <int CHANNELS> struct Shrunk {
    const float* picture;
    Long height, width, h, w;
    Room<float> line;  // sums of columns as pixels, and planar
    Room<int> first;   // the columns where render pixels begin, and the width

    Shrunk(const Picture& picture, Long h, Long w)
        : picture(picture.at), height(picture.size[0]), width(picture.size[1]), h(h), w(w),
          line(2 * CHANNELS * width), first(w + 1) {
        for (Long x = 0; x <= w && *this; x++) first.at[x] = int(first_within(x, w, width));
    }
    explicit operator bool() const { return bool(line) && bool(first); }

    // The first of `out` pixels whose centre lies in pixel `at` of `size`.
    static Long first_within(Long at, Long size, Long out) {
        return (2 * out * at + size - 1) / (2 * size);
    }

    // Of a span of a row and a pixel beside it, edge repeated: CHANNELS rows that are apart, from
    // the pixel before the first one on.
    FN_MEMBER void find(Long at, Long x0, Long x1, float* means, Long apart) const {
        const Long begin = larger<Long>(x0 - 1, 0), end = smaller<Long>(x1 + 1, w);
        const Long top = first_within(at, h, height), bottom = first_within(at + 1, h, height);
        const Long left = first.at[begin], right = first.at[end];
        const float* from = picture + top * width * CHANNELS;
        across(CHANNELS * left, CHANNELS * right, EACH(F, Long i) {
            F sum = load<F>(from + i);
            for (Long row = 1; row < bottom - top; row++)
                sum += load<F>(from + row * width * CHANNELS + i);
            store<F>(line.at + i, sum);
        });
        float* planar = line.at;
        if constexpr (CHANNELS > 1) {
            planar += CHANNELS * width;
            across(left, right, EACH(F, Long x) {
                for (int c = 0; c < CHANNELS; c++)
                    store<F>(planar + c * width + x, pick<F, 3>(line.at + 3 * x + c));
            });
        }
        for (int c = 0; c < CHANNELS; c++) {
            const float* sums = planar + c * width;
            float* out = means + c * apart;
            if (width == 2 * w) {
                const float share = 0.5f / float(bottom - top);
                across(begin, end, EACH(F, Long x) {
                    store<F>(out + 1 + x,
                             (pick<F, 2>(sums + 2 * x) + pick<F, 2>(sums + 2 * x + 1)) * share);
                });
            } else {
                for (Long x = begin; x < end; x++) {
                    float total = 0.0f;
                    for (Long i = first.at[x]; i < first.at[x + 1]; i++) total += sums[i];
                    out[1 + x] = total / float((bottom - top) * (first.at[x + 1] - first.at[x]));
                }
            }
            repeat_edges(out, w);
        }
    }
};

// Red, green, blue and alpha in 3x3 pixels: rows of the four that are apart.
struct Around {
    const float* rows[3];
    Long apart;

    template <class F> FN_MEMBER F get(int channel, int tap) const {
        return load<F>(rows[tap / 3] + channel * apart + tap % 3);
    }
};

static Status fit_rows(Long first, Long last, Picture picture, Picture next_samples, Cells near,
                       NewPicture fit) {
    const Long h = fit.size[1], w = fit.size[2], apart = w + 2;
    const Shrunk<3> shrunk(picture, h, w);
    const Room<float> room(3 * 4 * apart);
    if (!shrunk || !room) return NO_MEMORY;
    for (Long i = 0; i < 3 * 4 * apart; i++) room.at[i] = 0.0f;
    const auto kept = [&](Long y) { return room.at + (y + 3) % 3 * 4 * apart; };
    for (Long y = first - 1; y <= last; y++) {
        const Long at = clip(y, h);
        float *row = kept(y), *alpha = row + 3 * apart;
        const float *upper = next_samples(2 * at), *lower = next_samples(2 * at + 1);
        each_span_around(near, y, w, PIXELS(Long x0, Long x1) {
            shrunk.find(at, x0, x1, row, apart);
            across(larger<Long>(x0 - 1, 0), smaller<Long>(x1 + 1, w), EACH(F, Long x) {
                store<F>(alpha + 1 + x, mean_of_samples<F>(upper + 2 * x, lower + 2 * x));
            });
        });
        repeat_edges(alpha, w);
        if (y <= first) continue;
        const Long to = y - 1;
        for (int c = 0; c < 4; c++) {
            for (Long x = 0; x < w; x++) fit(c, to)[x] = 0.0f;
        }
        each_span_at(near, to, 1.0f, w, PIXELS(Long x0, Long x1) {
            across(x0, x1, EACH(F, Long x) {
                const Around around = {{kept(to - 1) + x, kept(to) + x, kept(to + 1) + x}, apart};
                const Fit<F> found = fitted<F>(around);
                for (int c = 0; c < 3; c++) store<F>(fit(c, to) + x, found.by[c]);
                store<F>(fit(3, to) + x, found.rest);
            });
        });
    }
    return DONE;
}
EXPORT_ALONE(denoise_fit, fit_rows)

// Correction.

// The two of `size` pixels between whose centres one of `out` has its own, and the second one's
// share.
struct Beside {
    Long first, second;
    float share;
};
FN Beside beside(Long position, Long size, Long out) {
    const Place at = centre_of(position, size, out);
    const bool before = at.offset < 0.0f;
    const Long first = before ? at.index - 1 : at.index;
    return {larger<Long>(first, 0), smaller<Long>(first + 1, size - 1),
            before ? at.offset + 1.0f : at.offset};
}

// What is known of a row of render pixels, each a row with a number more on either side.
enum { STRUCTURE, LACK, WEIGHED, INNER, FACTORS, ROW_PLANES = FACTORS + 4 };

// Numbers of a row of render pixels, at the output's: of the pixel that holds it, or between it and
// those beside it; and of a row of samples. Rows of pixels have a number more on either side.
struct Twice {
    template <class F> FN_MEMBER F own(const float* row, Long x) const {
        return each_twice<F>(row + 1 + x / 2);
    }
    template <class F> FN_MEMBER F mixed(const float* row, Long x) const {
        const F here = own<F>(row, x);
        F other;
        if constexpr (Of<F>::COUNT == 1) other = row[x % 2 ? x / 2 + 2 : x / 2];
        else other = in_turn(row + x / 2, Lanes());
        return between<F>(here, other, F(0.25f));
    }
    template <class F> FN_MEMBER F sample(const float* row, Long x) const {
        return load<F>(row + x);
    }

    // Of pixels beside one another in turn: the one before, and the one after.
    template <int... I> FN_MEMBER Wide in_turn(const float* row, List<int, I...>) const {
        const Half before = load<Half>(row), after = load<Half>(row + 2);
        return TWO_OF(before, after, I / 2 + I % 2 * (WIDE / 2));
    }
};
struct Anyhow {
    const int *owner, *left, *right, *sample_left, *sample_right;
    const float *share, *sample_share;

    template <class F> FN_MEMBER F own(const float* row, Long x) const {
        return gather<F>(row + 1, owner + x);
    }
    template <class F> FN_MEMBER F mixed(const float* row, Long x) const {
        return between<F>(gather<F>(row + 1, left + x), gather<F>(row + 1, right + x),
                          load<F>(share + x));
    }
    template <class F> FN_MEMBER F sample(const float* row, Long x) const {
        const F first = gather<F>(row, sample_left + x), second = gather<F>(row, sample_right + x);
        return between<F>(first, second, load<F>(sample_share + x));
    }
};

// Rows that one row of the output is made of: those of filtered alpha, with a number more on either
// side; of the pixel that holds it; mixed for its place; the samples at its place and the means of
// samples; and its colours.
struct Sources {
    const float *above, *here, *below, *own, *mixed, *samples, *means, *colours;
    Long apart;
};

// A span of a row of corrected alpha: filtered, sharper, nearer to the mean of samples and to alpha
// by colours. Where nothing moves samples know nothing of a pixel's inside.
template <class At> FN void correct_span(const Sources& from, const At& at,
                                                  const Gain& gain, Long first, Long last,
                                                  float* out) {
    across(first, last, EACH(F, Long x) {
        const auto own = PIXELS(int plane) {
            return at.template own<F>(from.own + plane * from.apart, x);
        };
        const auto mixed = PIXELS(int plane) {
            return at.template mixed<F>(from.mixed + plane * from.apart, x);
        };
        const F value = load<F>(from.here + 1 + x), structure = own(STRUCTURE);
        F around[3][3];
        for (int i = 0; i < 3; i++) {
            around[0][i] = load<F>(from.above + i + x);
            around[1][i] = load<F>(from.here + i + x);
            around[2][i] = load<F>(from.below + i + x);
        }
        const F soft = softened<F>(around);
        const F inner = own(INNER) * (at.template sample<F>(from.samples, x) - value - own(LACK));
        const F sharp = gain.sharper * structure * (value - soft);
        const F found = within<F>(value + mixed(WEIGHED) + inner + sharp, 0.0f, 1.0f);
        const float* colours = from.colours + 3 * x;
        const F shades = mixed(FACTORS) * pick<F, 3>(colours)
                       + mixed(FACTORS + 1) * pick<F, 3>(colours + 1)
                       + mixed(FACTORS + 2) * pick<F, 3>(colours + 2) + mixed(FACTORS + 3);
        const F by_colour = within<F>(shades * (1 / 9.0f), 0.0f, 1.0f);
        store<F>(out + x, found + gain.fitted * structure * (by_colour - found));
    });
}
template <class At>
FN void keep_span(const Sources& from, const At& at, Long first, Long last, float* out) {
    across(first, last, EACH(F, Long x) {
        store<F>(out + x, at.template own<F>(from.means, x));
    });
}

// Places of the output's columns, and what is known of render rows.
struct Corrector {
    Picture enlarged, picture, fit, samples, doubt, moved;
    Cells near;
    Gain gain;
    Long h, w, height, width, apart;
    Shrunk<1> shrunk;
    Room<float> room;
    Room<int> places;
    float *lines, *means, *known, *blend, *inside, *own_means, *shares;

    Corrector(const Picture& enlarged, const Picture& picture, const Picture& fit,
              const Picture& samples, const Picture& doubt, const Picture& moved, const Cells& near,
              const Gain& gain, Long height, Long width)
        : enlarged(enlarged), picture(picture), fit(fit), samples(samples), doubt(doubt),
          moved(moved), near(near), gain(gain), h(doubt.size[0]), w(doubt.size[1]), height(height),
          width(width), apart(w + 2), shrunk(enlarged, h, w),
          room(3 * (width + 2) + (4 + 3 * ROW_PLANES + 1) * apart + 2 * w + 2 * width),
          places(5 * width) {
        if (!*this) return;
        lines = room.at;
        means = lines + 3 * (width + 2);
        known = means + 4 * apart;
        blend = known + 2 * ROW_PLANES * apart;
        own_means = blend + ROW_PLANES * apart;
        inside = own_means + apart;
        shares = inside + 2 * w;
        for (float* at = room.at; at < shares; at++) *at = 0.0f;
        for (Long x = 0; x < width; x++) {
            const Beside pixels = beside(x, w, width), quarters = beside(x, 2 * w, width);
            const Long found[5] = {centre_of(x, w, width).index, pixels.first, pixels.second,
                                   quarters.first, quarters.second};
            for (int i = 0; i < 5; i++) places.at[i * width + x] = int(found[i]);
            shares[x] = pixels.share;
            shares[width + x] = quarters.share;
        }
    }
    explicit operator bool() const { return bool(shrunk) && bool(room) && bool(places); }

    Anyhow columns() const {
        return {places.at,
                places.at + width,
                places.at + 2 * width,
                places.at + 3 * width,
                places.at + 4 * width,
                shares,
                shares + width};
    }
    float* line(Long row) const { return lines + (row + 3) % 3 * (width + 2); }
    float* mean(Long row) const { return means + row % 4 * apart; }
    float* planes(Long row) const { return known + row % 2 * ROW_PLANES * apart; }

    FN_MEMBER void put_line(Long row) const {
        float* to = line(row);
        __builtin_memcpy(to + 1, enlarged(clip(row, height)), sizeof(float) * width);
        repeat_edges(to, width);
    }
    FN_MEMBER void put_means(Long row) const {
        each_span_around(
            near, row, w, PIXELS(Long x0, Long x1) { shrunk.find(row, x0, x1, mean(row), apart); });
    }
    // What filtered alpha lacks in a row of render pixels, and sums of the fits of 3x3 pixels.
    FN_MEMBER void put_planes(Long at) const {
        const Long above = larger<Long>(at - 1, 0), below = smaller<Long>(at + 1, h - 1);
        const auto to = [&](int plane) { return planes(at) + plane * apart + 1; };
        const float *upper = samples(2 * at), *lower = samples(2 * at + 1), *doubts = doubt(at),
                    *by = moved(at);
        each_span_at(near, at, 1.0f, w, PIXELS(Long x0, Long x1) {
            across(x0, x1, EACH(F, Long x) {
                const F own = mean_of_samples<F>(upper + 2 * x, lower + 2 * x);
                const Sums<F> around = sums_around<F>(mean(above) + x, mean(at) + x,
                                                      mean(below) + x);
                const Lacking<F> found = lacking<F>(around, load<F>(mean(at) + 1 + x), own,
                                                    load<F>(doubts + x), gain);
                store<F>(to(STRUCTURE) + x, found.structure);
                store<F>(to(LACK) + x, found.lack);
                store<F>(to(WEIGHED) + x, found.weight * found.lack);
                store<F>(to(INNER) + x,
                         one_where_moved<F>(by + 2 * x) > 0.0f ? found.weight : F(0.0f));
            });
        });
        for (int k = 0; k < 4; k++) {
            sum_rows(fit(k, above), fit(k, at), fit(k, below), w, own_means);
            across(0, w, EACH(F, Long x) {
                store<F>(to(FACTORS + k) + x, sum_of_three<F>(own_means, x));
            });
        }
        for (int plane = 0; plane < ROW_PLANES; plane++) repeat_edges(to(plane) - 1, w);
    }
    FN_MEMBER void put_own_means(Long row) const {
        const float *upper = samples(2 * row), *lower = samples(2 * row + 1);
        across(0, w, EACH(F, Long x) {
            store<F>(own_means + 1 + x, mean_of_samples<F>(upper + 2 * x, lower + 2 * x));
        });
    }
    // Planes between two rows of render pixels, and the samples between two of their own, as far as
    // a span reads them.
    FN_MEMBER void mix(const Beside& rows, const Beside& quarters, Long x0, Long x1) const {
        for (int plane = WEIGHED; plane < ROW_PLANES; plane++) {
            if (plane == INNER) continue;
            const float* upper = planes(rows.first) + plane * apart;
            const float* lower = planes(rows.second) + plane * apart;
            mix_row(upper, lower, rows.share, x0, x1 + 2, blend + plane * apart);
        }
        mix_row(samples(quarters.first), samples(quarters.second), quarters.share,
                2 * larger<Long>(x0 - 1, 0), 2 * smaller<Long>(x1 + 1, w), inside);
    }
    FN_MEMBER void mix_row(const float* upper, const float* lower, float share, Long first,
                           Long last, float* out) const {
        across(first, last, EACH(F, Long x) {
            store<F>(out + x, between<F>(load<F>(upper + x), load<F>(lower + x), F(share)));
        });
    }
};

static Status correct_rows(Long first, Long last, Picture enlarged, Picture picture, Picture fit,
                           Picture next_samples, Picture next_doubt, Picture moved, Cells near,
                           Given<Gain> gain, NewPicture corrected) {
    const Long height = corrected.size[0], width = corrected.size[1];
    const Corrector by(enlarged, picture, fit, next_samples, next_doubt, moved, near, *gain, height,
                       width);
    if (!by) return NO_MEMORY;
    const Long h = by.h, w = by.w;
    const bool twice = height == 2 * h && width == 2 * w;
    const Anyhow columns = by.columns();
    Long lines[3] = {-2, -2, -2}, means[4] = {-1, -1, -1, -1}, planes[2] = {-1, -1}, kept = -1;
    const auto once = PIXELS(Long* rows, Long count, Long row, const auto& make) {
        if (rows[(row + count) % count] == row) return;
        rows[(row + count) % count] = row;
        make(row);
    };
    for (Long y = first; y < last; y++) {
        const Long owning = centre_of(y, h, height).index;
        const Beside rows = beside(y, h, height), quarters = beside(y, 2 * h, height);
        const float* cells = cells_of(near, owning);
        bool any = false;
        for (Long k = 0; k < near.size[1]; k++) any = any || cells[k] >= 2.0f;
        float* out = corrected(y);
        // Means of samples stand in a room that planes are made in.
        const Long both[2] = {rows.first, rows.second};
        for (const Long at : both) {
            if (!any || planes[at % 2] == at) continue;
            planes[at % 2] = at;
            kept = -1;
            for (Long row = larger<Long>(at - 1, 0); row <= at + 1 && row < h; row++) {
                once(means, 4, row, PIXELS(Long one) { by.put_means(one); });
            }
            by.put_planes(at);
        }
        for (Long row = y - 1; any && row <= y + 1; row++) {
            once(lines, 3, row, PIXELS(Long one) { by.put_line(one); });
        }
        if (kept != owning) by.put_own_means(owning);
        kept = owning;
        const Sources from = {by.line(y - 1),    by.line(y), by.line(y + 1),
                              by.planes(owning), by.blend,   by.inside,
                              by.own_means,      picture(y), by.apart};
        Long done = 0;
        if (any) {
            each_span_at(near, owning, 2.0f, w, PIXELS(Long x0, Long x1) {
                const Long begin = by.shrunk.first.at[x0], end = by.shrunk.first.at[x1];
                by.mix(rows, quarters, x0, x1);
                if (twice) {
                    keep_span(from, Twice(), done, begin, out);
                    correct_span(from, Twice(), *gain, begin, end, out);
                } else {
                    keep_span(from, columns, done, begin, out);
                    correct_span(from, columns, *gain, begin, end, out);
                }
                done = end;
            });
        }
        if (twice) keep_span(from, Twice(), done, width, out);
        else keep_span(from, columns, done, width, out);
    }
    return DONE;
}
EXPORT_ALONE(denoise_correct, correct_rows)

// Filtering: the means of samples as the finest level, and the filtered level at output size.

static void level_row(Long y, Picture next_samples, Places rows, Places columns, Places, Places,
                      NewPicture level) {
    const Long w = columns.size[0], left = Long(columns.at[0]), width = level.size[2];
    const Long held = Long(columns.at[w - 1]) - left + 1;
    float* out = level(0, y);
    if (y >= rows.size[0]) {
        for (Long x = 0; x < width; x++) out[x] = 0.0f;
        return;
    }
    const float *upper = next_samples(2 * Long(rows.at[y]), 2 * left);
    const float *lower = next_samples(2 * Long(rows.at[y]) + 1, 2 * left);
    across(0, held, EACH(F, Long x) {
        store<F>(out + x, mean_of_samples<F>(upper + 2 * x, lower + 2 * x));
    });
    for (Long x = held; x < w; x++) out[x] = out[held - 1];
    for (Long x = w; x < width; x++) out[x] = 0.0f;
}
EXPORT_ALONE(denoise_alpha_level, level_row)

// By the picture's weights of 3x3 pixels; where nothing is near, that of the pixel itself.
static Status enlarge_rows(Long first, Long last, Picture filtered, FineHead fine, Places part_rows,
                           Places part_columns, Given<Params> params, Given<Window> window,
                           Cells near, Places out_rows, Places, NewPicture enlarged) {
    const Long h = part_rows.size[0], w = part_columns.size[0], width = enlarged.size[1];
    const Long top = Long(window->top), left = Long(window->left);
    const bool doubles = window->doubles() && width == 2 * w;
    const Rooms rooms(width, w);
    const Room<float> lines(3 * (w + 2));
    if (!rooms || !lines) return NO_MEMORY;
    const Samples given = {{}, {}, {}, *params, *window, {}};
    fill_columns(given, rooms);
    const Columns columns = {rooms.index.at, rooms.lean(), rooms.near(), rooms.wide(), width};
    Long held = -1;
    for (Long n = first; n < last; n++) {
        const Place at = row_of(*window, n, h);
        const Distances down = distances_of(params->jitter_y - at.offset);
        const float* own = filtered(0, at.index);
        float* out = enlarged(n);
        for (Long j = 0; j < 3 && held != at.index; j++) {
            float* line = lines.at + j * (w + 2);
            __builtin_memcpy(line + 1, filtered(0, clip(at.index + j - 1, h)), sizeof(float) * w);
            repeat_edges(line, w);
        }
        held = at.index;
        across(0, width, EACH(F, Long x) {
            store<F>(out + x, within<F>(gather<F>(own, rooms.index.at + x), 0.0f, 1.0f));
        });
        Row row = {};
        row.head = head_of(fine, at.index);
        row.radiance = lines.at;
        row.line = w + 2;
        const int lower = int(Long(out_rows.at[n]) % 2);
        const Sides sides = sides_of(down, *params);
        Long done = 0;
        each_span_at(near, top + at.index, 1.0f, left + w, PIXELS(Long from, Long to) {
            const Long x0 = larger<Long>(from - left, 0), x1 = smaller<Long>(to - left, w);
            if (x0 >= x1) return;
            if (doubles) {
                across(x0, x1, EACH(F, Long x) {
                    const AtCorner even = {row, sides.left, x, 2 * lower, 0};
                    const AtCorner odd = {row, sides.right, x, 2 * lower + 1, 1};
                    const F a = light_sample<F>(row, even, light_weights<F>(even), 0);
                    const F b = light_sample<F>(row, odd, light_weights<F>(odd), 0);
                    store_pairs<F>(out + 2 * x, within<F>(a, 0.0f, 1.0f), within<F>(b, 0.0f, 1.0f));
                });
                return;
            }
            while (done < width && rooms.index.at[done] < x0) done++;
            const Long begin = done;
            while (done < width && rooms.index.at[done] < x1) done++;
            across(begin, done, EACH(F, Long x) {
                const Anywhere place = {row, columns, down, lean_of(at.offset), x};
                const F found = light_sample<F>(row, place, light_weights<F>(place), 0);
                store<F>(out + x, within<F>(found, 0.0f, 1.0f));
            });
        });
    }
    return DONE;
}
EXPORT_ALONE(denoise_enlarge_alpha, enlarge_rows)

// Rows of whole pictures.
#include "image.h"

// Cubic resampling. Values stay within those of the four nearest samples, so that edges do not
// ring; what is not finite counts as 0.

constexpr int MARGIN = 5;  // pixels beside a row, so that no tap lies outside
constexpr float EVEN = 1e-3f;
constexpr int BEHIND = 4;  // numbers after a row, which are read with its last pixel

FN Long floor_to_whole(float x) { return Long(floor_of(x)); }

// Whether the result has twice the columns, evenly: all even ones lie alike, and so do all odd ones,
// which lie less than two pixels after them.
static bool doubles(const Places& columns, Long w) {
    if (columns.size[0] != 2 * w) return false;
    for (int side = 0; side < 2; side++) {
        if (size_of<float>(columns.at[side]) > MARGIN - 3) return false;
        for (Long x = 0; x < w; x++) {
            const float off = columns.at[2 * x + side] - float(x) - columns.at[side];
            if (!(size_of<float>(off) <= EVEN)) return false;
        }
    }
    const Long between = floor_to_whole(columns.at[1]) - floor_to_whole(columns.at[0]);
    return between == 0 || between == 1;
}

// Whether the result's columns are the picture's own.
static bool stays(const Places& columns, Long w) {
    bool same = columns.size[0] == w;
    for (Long x = 0; x < w && same; x++) same = columns.at[x] == float(x);
    return same;
}

// Rows begin where a vector of their numbers is read from one line of the cache.
FN Long whole_vectors(Long count) { return (count + WIDE - 1) / WIDE * WIDE; }
FN float* first_vector(float* at) {
    const Long beyond = Long((__UINTPTR_TYPE__)at % sizeof(Wide));
    return at && beyond ? at + (Long(sizeof(Wide)) - beyond) / Long(sizeof(float)) : at;
}

struct Resampler {
    Picture image;
    Places rows, columns;
    Long h, w, channels, width, size;
    bool twice, still;
    Room<float> room, weights;
    Room<int> index;
    float* const lines_at;
    float *value, *least, *most, *sides[2];
    Long numbers[TAPS], bounded[2];

    Resampler(const Picture& image, const Places& rows, const Places& columns)
        : image(image), rows(rows), columns(columns), h(image.size[0]), w(image.size[1]),
          channels(image.size[2]), width(columns.size[0]),
          size(whole_vectors((w + 2 * MARGIN) * channels + BEHIND)), twice(doubles(columns, w)),
          still(stays(columns, w)), room(WIDE + (TAPS + 5) * size),
          weights(TAPS * width), index(width), lines_at(first_vector(room.at)),
          numbers{-1, -1, -1, -1}, bounded{-1, -1} {
        if (!*this) return;
        for (Long i = 0; i < (TAPS + 3) * size; i++) lines_at[i] = 0.0f;
        value = lines_at + TAPS * size;
        least = value + size;
        most = least + size;
        sides[0] = most + size;
        sides[1] = sides[0] + size;
        for (Long x = 0; x < width && !twice; x++) {
            const Long left = floor_to_whole(columns.at[x]);
            const Taps taps = catmull_rom(columns.at[x] - float(left));
            for (int i = 0; i < TAPS; i++) weights.at[i * width + x] = taps.at[i];
            const Long first = left < -3 ? -3 : left > w + 2 ? w + 2 : left;
            index.at[x] = int(channels * (MARGIN - 1 + first));
        }
    }
    explicit operator bool() const { return bool(room) && bool(weights) && bool(index); }

    float* line(Long row) const { return lines_at + row % TAPS * size; }

    // A row with its first and last pixel repeated in the margins.
    void clean(Long row) const {
        const Long count = w * channels, first = MARGIN * channels, end = first + count;
        const float* from = image(row);
        float* to = line(row);
        across(0, count, EACH(F, Long i) {
            store<F>(to + first + i, finite<F>(load<F>(from + i)));
        });
        for (Long i = 0; i < first; i++) {
            to[i] = to[first + i % channels];
            to[end + i] = to[end - channels + i % channels];
        }
    }

    // Cubic sums of four rows, and the least and the largest of the two in the middle, of each
    // pixel and the one after it.
    void sum(Long y) {
        const Long top = floor_to_whole(rows.at[y]);
        const Taps taps = catmull_rom(rows.at[y] - float(top));
        const float* lines[TAPS];
        Long near[TAPS];
        for (int j = 0; j < TAPS; j++) {
            near[j] = clip(top - 1 + j, h);
            if (numbers[near[j] % TAPS] != near[j]) clean(near[j]);
            numbers[near[j] % TAPS] = near[j];
            lines[j] = line(near[j]);
        }
        across(0, size, EACH(F, Long i) {
            store<F>(value + i, sum_of_taps<F>(taps, load<F>(lines[0] + i), load<F>(lines[1] + i),
                                               load<F>(lines[2] + i), load<F>(lines[3] + i)));
        });
        if (bounded[0] == near[1] && bounded[1] == near[2]) return;
        bounded[0] = near[1];
        bounded[1] = near[2];
        across(0, size - channels, EACH(F, Long i) {
            const float *upper = lines[1] + i, *lower = lines[2] + i;
            const F b = load<F>(upper), c = load<F>(lower), next_b = load<F>(upper + channels),
                    next_c = load<F>(lower + channels);
            store<F>(least + i, smaller<F>(smaller<F>(b, c), smaller<F>(next_b, next_c)));
            store<F>(most + i, larger<F>(larger<F>(b, c), larger<F>(next_b, next_c)));
        });
    }

    // Numbers a pixel apart, from the first tap on.
    template <class V>
    FN_MEMBER V sample(const Taps& taps, V a, V b, V c, V d, V under, V over) const {
        const V found = sum_of_taps<V>(taps, a, b, c, d), held = found > under ? found : under;
        return held < over ? held : over;
    }
    // Both of two columns from the same numbers; those of the second begin `LATER` pixels after.
    template <int LATER> FN_MEMBER void find_twice(Long left, const Taps* taps) const {
        const Long first = channels * (MARGIN + left - 1), one_more = channels;
        across(0, w * channels, EACH(F, Long i) {
            const float *at = value + first + i, *under = least + first + one_more + i,
                        *over = most + first + one_more + i;
            const F a = load<F>(at), b = load<F>(at + one_more), c = load<F>(at + 2 * one_more),
                    d = load<F>(at + 3 * one_more), low_end = load<F>(under),
                    high_end = load<F>(over);
            store<F>(sides[0] + i, sample<F>(taps[0], a, b, c, d, low_end, high_end));
            if constexpr (LATER == 0) {
                store<F>(sides[1] + i, sample<F>(taps[1], a, b, c, d, low_end, high_end));
            } else {
                store<F>(sides[1] + i, sample<F>(taps[1], b, c, d, load<F>(at + 4 * one_more),
                                                 load<F>(under + one_more),
                                                 load<F>(over + one_more)));
            }
        });
    }
    void put_twice(float* out) const {
        Long lefts[2];
        Taps taps[2];
        for (int side = 0; side < 2; side++) {
            lefts[side] = floor_to_whole(columns.at[side]);
            taps[side] = catmull_rom(columns.at[side] - float(lefts[side]));
        }
        if (lefts[1] == lefts[0]) find_twice<0>(lefts[0], taps);
        else find_twice<1>(lefts[0], taps);
        if (channels == 1) {
            across(0, w, EACH(F, Long x) {
                store_pairs<F>(out + 2 * x, load<F>(sides[0] + x), load<F>(sides[1] + x));
            });
        } else if (channels == 3) {
            across(0, w, EACH(F, Long x) {
                interleave_triples<F>(out + 6 * x, sides[0] + 3 * x, sides[1] + 3 * x);
            });
        } else {
            for (Long x = 0; x < w; x++) {
                put(out, 2 * x, load<Four>(sides[0] + channels * x), sides[0] + channels * x);
                put(out, 2 * x + 1, load<Four>(sides[1] + channels * x), sides[1] + channels * x);
            }
        }
    }
    // A pixel of three or four numbers at once, over which the next one is written; others one by
    // one.
    FN_MEMBER void put(float* out, Long x, Four pixel, const float* numbers) const {
        float* to = out + channels * x;
        const bool whole = channels == 4 || (channels == 3 && x + 1 < width);
        if (whole) {
            store(to, pixel);
        } else {
            for (Long k = 0; k < channels; k++) to[k] = k < 4 ? pixel[k] : numbers[k];
        }
    }
    void put_anyhow(float* out) const {
        if (channels == 1) {
            across(0, width, EACH(F, Long x) {
                const int* at = index.at + x;
                const auto weighed = PIXELS(int tap) {
                    return load<F>(weights.at + tap * width + x) * gather<F>(value + tap, at);
                };
                const F found = weighed(0) + weighed(1) + weighed(2) + weighed(3);
                const F held = larger<F>(found, gather<F>(least + 1, at));
                store<F>(out + x, smaller<F>(held, gather<F>(most + 1, at)));
            });
            return;
        }
        for (Long x = 0; x < width; x++) {
            Taps taps;
            for (int i = 0; i < TAPS; i++) taps.at[i] = weights.at[i * width + x];
            const Long a = index.at[x], b = a + channels, c = b + channels, d = c + channels;
            if (channels <= 4) {
                put(out, x, sample<Four>(taps, load<Four>(value + a), load<Four>(value + b),
                                         load<Four>(value + c), load<Four>(value + d),
                                         load<Four>(least + b), load<Four>(most + b)), nullptr);
                continue;
            }
            for (Long k = 0; k < channels; k++) {
                out[channels * x + k] =
                    sample<float>(taps, value[a + k], value[b + k], value[c + k], value[d + k],
                                  least[b + k], most[b + k]);
            }
        }
    }
    // A row that is one of the picture's own.
    void copy(Long row, float* out) const {
        const float* from = image(row);
        across(0, w * channels, EACH(F, Long i) {
            store<F>(out + i, finite<F>(load<F>(from + i)));
        });
    }
    void put_row(Long y, float* out) {
        const Long row = floor_to_whole(rows.at[y]);
        if (still && rows.at[y] == float(row) && row >= 0 && row < h) return copy(row, out);
        sum(y);
        if (twice) put_twice(out);
        else put_anyhow(out);
    }
};

static Status resample_rows(Long first, Long last, Picture image, Places rows, Places columns,
                            NewPicture output) {
    Resampler resampler(image, rows, columns);
    if (!resampler) return NO_MEMORY;
    for (Long y = first; y < last; y++) resampler.put_row(y, output(y));
    settle();
    return DONE;
}
EXPORT(resample, resample_rows)

// Overlays of premultiplied RGBA.

// Cubic, and colours are no brighter and no darker than the nearest four pixels' own colours at the
// coverage that comes out: so edges have no halo, whatever they are composited over.
static Status enlarge_rows(Long first, Long last, Picture image, Places rows, Places columns,
                           NewPicture output) {
    const Long h = image.size[0], w = image.size[1], width = columns.size[0];
    Resampler resampler(image, rows, columns);
    const Room<Four> bounds(2 * w);
    if (!resampler || !bounds) return NO_MEMORY;
    Long above = -1, below = -1;
    for (Long y = first; y < last; y++) {
        float* out = output(y);
        resampler.put_row(y, out);
        const Long at = floor_to_whole(rows.at[y]);
        if (above != clip(at, h) || below != clip(at + 1, h)) {
            above = clip(at, h);
            below = clip(at + 1, h);
            const float infinite = __builtin_inff();
            for (Long x = 0; x < w; x++) {
                const Four upper = load<Four>(image(above, x)), lower = load<Four>(image(below, x));
                bounds.at[2 * x] =
                    smaller_four(straight(upper, infinite), straight(lower, infinite));
                bounds.at[2 * x + 1] = larger_four(straight(upper, -infinite),
                                                   straight(lower, -infinite));
            }
        }
        for (Long x = 0; x < width; x++) {
            const Long left = floor_to_whole(columns.at[x]);
            const Four* one = bounds.at + 2 * clip(left, w);
            const Four* other = bounds.at + 2 * clip(left + 1, w);
            const Four pixel = held(load<Four>(out + 4 * x), smaller_four(one[0], other[0]),
                                    larger_four(one[1], other[1]));
            store(out + 4 * x, pixel);
        }
    }
    return DONE;
}
EXPORT(overlay_enlarge, enlarge_rows)

static void over_row(Long y, Picture overlay, Picture colour, NewPicture output) {
    const float *front = overlay(y), *behind = colour(y);
    float* out = output(y);
    across(0, output.size[1], EACH(F, Long x) {
        const F alpha = pick<F, 4>(front + 4 * x + 3);
        F found[3];
        for (int c = 0; c < 3; c++) {
            found[c] =
                over<F>(pick<F, 4>(front + 4 * x + c), alpha, pick<F, 3>(behind + 3 * x + c));
        }
        store_triples<F>(out + 3 * x, found[0], found[1], found[2]);
    });
}
EXPORT(overlay_over, over_row)

static void over_alpha_row(Long y, Picture overlay, Picture alpha, NewPicture output) {
    const float *front = overlay(y), *behind = alpha(y);
    float* out = output(y);
    across(0, output.size[1], EACH(F, Long x) {
        const F covered = within<F>(known<F>(pick<F, 4>(front + 4 * x + 3)), 0.0f, 1.0f);
        store<F>(out + x, over<F>(covered, covered, load<F>(behind + x)));
    });
}
EXPORT(overlay_over_alpha, over_alpha_row)

// Greys of cells where both numbers are equal, and of the others.
struct Greys {
    float equal, other;
};
static void checkerboard_row(Long y, Places rows, Places columns, Given<Greys> greys,
                             NewPicture output) {
    float* out = output(y);
    const float row = rows.at[y];
    across(0, columns.size[0], EACH(F, Long x) {
        const F grey = load<F>(columns.at + x) == row ? F(greys->equal) : F(greys->other);
        store_triples<F>(out + 3 * x, grey, grey, grey);
    });
}
EXPORT(checkerboard, checkerboard_row)

// Largest difference of a channel between points now and a picture before, bilinear at places,
// which are brought to its edge; and whether they lie in it.
static void compare_row(Long n, Picture before, View<const float, 2> now,
                        View<const float, 2> across, View<const float, 2> down,
                        View<float, 2> apart, View<byte, 2> inside) {
    const Long height = before.size[0], width = before.size[1], channels = before.size[2];
    const float last_x = float(width - 1), last_y = float(height - 1);
    for (Long p = 0; p < across.size[1]; p++) {
        const float at_x = across(n)[p], at_y = down(n)[p];
        inside(n)[p] = at_x >= 0.0f && at_x <= last_x && at_y >= 0.0f && at_y <= last_y;
        const float x = within<float>(at_x, 0.0f, last_x), y = within<float>(at_y, 0.0f, last_y);
        const Long left = clip(Long(x), width > 1 ? width - 1 : 1);
        const Long top = clip(Long(y), height > 1 ? height - 1 : 1);
        const Long right = clip(left + 1, width), bottom = clip(top + 1, height);
        const float u = x - float(left), v = y - float(top);
        const float *a = before(top, left), *b = before(top, right);
        const float *c = before(bottom, left), *d = before(bottom, right);
        float largest = 0.0f;
        for (Long k = 0; k < channels; k++) {
            const float upper = a[k] * (1.0f - u) + b[k] * u, lower = c[k] * (1.0f - u) + d[k] * u;
            const float off = upper * (1.0f - v) + lower * v - now(p)[k];
            largest = larger<float>(size_of<float>(off), largest);
        }
        apart(n)[p] = largest;
    }
}
EXPORT(compare_places, compare_row)

// Rows of what the host looks at in a frame's planes.
#include "statistics.h"
#include "rows.h"

typedef View<const unsigned, 1> Bits;
typedef View<const Long, 1> Lengths;
typedef View<const double, 2> Columns;
typedef View<const double, 3> Cells;

// Whole planes.

// Pieces of WORTH bytes, of which the last may be smaller.
static void copy_rows(Long first, Long last, Bits source, View<unsigned, 1> target) {
    constexpr Long EACH = WORTH / Long(sizeof(unsigned));
    const Long begin = first * EACH, end = smaller<Long>(last * EACH, target.size[0]);
    if (begin >= end) return;
    __builtin_memcpy(target.at + begin, source.at + begin, sizeof(unsigned) * (end - begin));
}
EXPORT(copy_pieces, copy_rows)

// The largest bits of numbers without their signs: four vectors at once, so that none waits.
FN WideInt larger_bits(const unsigned* at, WideInt before) {
    const WideInt found = load_int<Wide>((const int*)at) & 0x7FFFFFFF;
    return found > before ? found : before;
}
ONCE int largest_of(const unsigned* numbers, Long count) {
    constexpr Long AT_ONCE = 4, AHEAD = 512;  // numbers that memory is asked for early
    WideInt wide[AT_ONCE] = {};
    Long i = 0;
    for (; i + AT_ONCE * WIDE <= count; i += AT_ONCE * WIDE) {
        UNROLL for (Long k = 0; k < AT_ONCE; k++) {
            __builtin_prefetch(numbers + i + k * WIDE + AHEAD);
            wide[k] = larger_bits(numbers + i + k * WIDE, wide[k]);
        }
    }
    for (; i + WIDE <= count; i += WIDE) wide[0] = larger_bits(numbers + i, wide[0]);
    int largest = 0;
    AS_IT_IS for (; i < count; i++) largest = larger<int>(int(numbers[i] & 0x7FFFFFFF), largest);
    for (const WideInt& some : wide) largest = larger<int>(__builtin_reduce_max(some), largest);
    return largest;
}
static void largest_rows(Long first, Long last, View<const unsigned, 2> rows,
                         View<unsigned, 1> largest) {
    for (Long y = first; y < last; y++) largest.at[y] = unsigned(largest_of(rows(y), rows.size[1]));
}
EXPORT(largest_bits, largest_rows)

// Whether all numbers are 0.
static void blank_rows(Long, Long, Bits bits, View<bool, 1> blank) {
    const Long count = bits.size[0];
    *blank.at = true;
    for (Long first = 0; first < count && *blank.at; first += PIECE) {
        *blank.at = largest_of(bits.at + first, smaller<Long>(count - first, PIECE)) == 0;
    }
}
EXPORT(is_blank, blank_rows)

// Whether all numbers are the same, or NaN in both.
static void same_rows(Long, Long, Places one, Places other, View<bool, 1> same) {
    const Long count = one.size[0];
    *same.at = true;
    for (Long first = 0; first < count && *same.at; first += PIECE) {
        Wide wide = Wide(0.0f);
        float single = 0.0f;
        across(first, smaller<Long>(first + PIECE, count), EACH(F, Long i) {
            const F a = load<F>(one.at + i), b = load<F>(other.at + i);
            const F yes = F(1.0f), no = F(0.0f), number = b == b ? yes : no;
            const F unlike = a == b ? no : a == a ? yes : number;
            if constexpr (Of<F>::COUNT == 1) single += unlike;
            else wide += unlike;
        });
        for (int i = 0; i < WIDE; i++) single += wide[i];
        *same.at = single == 0.0f;
    }
}
EXPORT_ALONE(is_same_plane, same_rows)

// Blocks of pixels.

ONCE void add_lights(const float* row, Long width, double* total, double* brightest,
                     double* unknown) {
    across_once(0, width, EACH(F, Long x) {
        const Light<F> found = light_of<F>(row + 3 * x);
        const Double<F> most = load<Double<F>>(brightest + x);
        store(total + x, load<Double<F>>(total + x) + found.light);
        store(brightest + x, found.light > most ? found.light : most);
        store(unknown + x, load<Double<F>>(unknown + x) + found.unknown);
    });
}

// Of each column of a row of blocks: its light, its brightest pixel, and pixels that are not
// finite.
struct Lights {
    Room<double> room;
    Long width;
    double *total, *brightest, *unknown;

    explicit Lights(Long width)
        : room(3 * width), width(width), total(room.at), brightest(total + width),
          unknown(brightest + width) {}
    explicit operator bool() const { return bool(room); }

    void clear() const {
        for (Long i = 0; i < 3 * width; i++) room.at[i] = 0.0;
    }
    void add(const float* row) const { add_lights(row, width, total, brightest, unknown); }
};
struct Block {
    double total = 0.0, brightest = 0.0, unknown = 0.0;
};
FN Block block_of(const Lights& lights, Long first, Long last) {
    Block found;
    for (Long x = first; x < last; x++) {
        found.total += lights.total[x];
        found.brightest = larger<double>(lights.brightest[x], found.brightest);
        found.unknown += lights.unknown[x];
    }
    return found;
}

// Mean luminance of each block of side x side pixels without the brightest. Non-finite pixels are
// left out, negative ones count as 0. Averaging keeps the noise of one sample a pixel out of the
// logarithm that follows, which would read it as darkness; without the brightest pixel a firefly is
// no light.
static Status block_rows(Long first, Long last, Picture colour, Lengths side,
                         View<double, 2> means) {
    const Long height = colour.size[0], width = colour.size[1], block = *side.at;
    const Lights lights(width);
    if (!lights) return NO_MEMORY;
    for (Long j = first; j < last; j++) {
        const Long begin = j * block, end = smaller<Long>(begin + block, height);
        lights.clear();
        for (Long y = begin; y < end; y++) lights.add(colour(y));
        for (Long i = 0; i < means.size[1]; i++) {
            const Long left = i * block, right = smaller<Long>(left + block, width);
            const Block found = block_of(lights, left, right);
            const double count = double((end - begin) * (right - left)) - found.unknown;
            const double mean = (found.total - found.brightest) / (count - 1.0);
            means(j)[i] = count > 1.0 ? mean : found.total;
        }
    }
    return DONE;
}
EXPORT(block_means, block_rows)

// Mean luminance of the even and of the odd rows of each whole block of side x side pixels, which
// show the same with other noise. The brightest pixel of each is left out; pixels that are not
// finite and negative ones count as 0.
static Status half_rows(Long first, Long last, Picture colour, Lengths side,
                        View<double, 3> means) {
    const Long block = *side.at, columns = means.size[2];
    const Lights lights(columns * block);
    if (!lights) return NO_MEMORY;
    for (Long j = first; j < last; j++) {
        for (Long half = 0; half < 2; half++) {
            const Long count = (block + 1 - half) / 2 * block;
            lights.clear();
            for (Long row = half; row < block; row += 2) lights.add(colour(j * block + row));
            for (Long i = 0; i < columns; i++) {
                const Block found = block_of(lights, i * block, (i + 1) * block);
                means(half, j)[i] = (found.total - found.brightest) / double(count - 1);
            }
        }
    }
    return DONE;
}
EXPORT(half_means, half_rows)

// Means of two pairs of pixels of each whole block. Each pair lies on a diagonal, a quarter of the
// block from its corners. Means that are not finite become 0.
static void pair_row(Long j, Picture plane, Lengths side, View<double, 4> means) {
    const Long block = *side.at, near = block / 4, far = block - 1 - near;
    for (Long i = 0; i < means.size[1]; i++) {
        for (Long pair = 0; pair < 2; pair++) {
            const Long left = i * block + (pair ? far : near);
            const Long right = i * block + (pair ? near : far);
            const float* upper = plane(j * block + near, left);
            const float* lower = plane(j * block + far, right);
            double* out = means(j, i, pair);
            for (Long c = 0; c < means.size[3]; c++) {
                const double mean = (double(upper[c]) + double(lower[c])) / 2.0;
                out[c] = size_of(mean) < __builtin_inf() ? mean : 0.0;
            }
        }
    }
}
EXPORT(pair_means, pair_row)

// The least or the largest of each column of rows of a plane, from what is given before.
template <bool LARGEST>
ONCE void extreme_of(Plane plane, Long first, Long last, float* found) {
    for (Long y = first; y < last; y++) {
        across_once(0, plane.size[1], EACH(F, Long x) {
            const F value = load<F>(plane(y) + x), before = load<F>(found + x);
            store<F>(found + x, LARGEST ? larger<F>(value, before) : smaller<F>(value, before));
        });
    }
}

// The lowest and highest value, 0 to 1, in each cell of so many pixels along a side.
static Status bounds_rows(Long first, Long last, Plane plane, Lengths side, View<float, 2> low,
                          View<float, 2> high) {
    const Long h = plane.size[0], w = plane.size[1], block = *side.at;
    const Room<float> room(2 * w);
    if (!room) return NO_MEMORY;
    float *least = room.at, *most = least + w;
    for (Long j = first; j < last; j++) {
        const Long begin = j * block, end = smaller<Long>(begin + block, h);
        fill(least, 0, w, 1.0f);
        fill(most, 0, w, 0.0f);
        extreme_of<false>(plane, begin, end, least);
        extreme_of<true>(plane, begin, end, most);
        for (Long i = 0; i < low.size[1]; i++) {
            float lowest = 1.0f, highest = 0.0f;
            for (Long x = i * block; x < smaller<Long>((i + 1) * block, w); x++) {
                lowest = smaller<float>(least[x], lowest);
                highest = larger<float>(most[x], highest);
            }
            low(j)[i] = lowest;
            high(j)[i] = highest;
        }
    }
    return DONE;
}
EXPORT_ALONE(bounds_of_cells, bounds_rows)

// Sets cells of side x side pixels in which a plane is positive anywhere.
static Status positive_rows(Long first, Long last, Plane plane, Lengths side, View<bool, 2> cells) {
    const Long h = plane.size[0], w = plane.size[1], block = *side.at;
    const Room<float> most(w);
    if (!most) return NO_MEMORY;
    for (Long j = first; j < last; j++) {
        fill(most.at, 0, w, 0.0f);
        extreme_of<true>(plane, j * block, smaller<Long>((j + 1) * block, h), most.at);
        for (Long x = 0; x < w; x++) {
            if (most.at[x] > 0.0f) cells(j)[x / block] = true;
        }
    }
    return DONE;
}
EXPORT_ALONE(mark_positive, positive_rows)

// Sets cells of side x side pixels that are not 0 everywhere.
static void lit_row(Long j, View<const unsigned, 3> plane, Lengths side, View<bool, 2> cells) {
    const Long h = plane.size[0], w = plane.size[1], channels = plane.size[2], block = *side.at;
    const Long end = smaller<Long>((j + 1) * block, h);
    for (Long y = j * block; y < end; y++) {
        for (Long x = 0; x < w; x += block) {
            const unsigned* from = plane(y, x);
            const Long width = smaller<Long>(block, w - x);
            unsigned any = 0;
            for (Long i = 0; i < width * channels; i++) any |= from[i];
            if (any & 0x7FFFFFFF) cells(j)[x / block] = true;
        }
    }
}
EXPORT_ALONE(mark_lit, lit_row)

// How many of every second row's pixels, but for the first and the last, are a hit where at least
// three of four neighbours are misses, or the other way round.
static void odd_row(Long n, Plane depth, Places farthest, View<float, 1> odd) {
    const Long y = 2 * n + 1;
    const float *above = depth(y - 1), *row = depth(y), *below = depth(y + 1);
    const float far = *farthest.at;
    Wide wide = Wide(0.0f);
    float single = 0.0f;
    across_once(1, depth.size[1] - 1, EACH(F, Long x) {
        const F beside =
            hit_of<F>(load<F>(row + x - 1), far) + hit_of<F>(load<F>(row + x + 1), far);
        const F around = hit_of<F>(load<F>(above + x), far) + hit_of<F>(load<F>(below + x), far);
        const F found = is_odd<F>(hit_of<F>(load<F>(row + x), far), around + beside);
        if constexpr (Of<F>::COUNT == 1) single += found;
        else wide += found;
    });
    for (int i = 0; i < WIDE; i++) single += wide[i];
    odd.at[n] = single;
}
EXPORT(coverage_noise, odd_row)

// The coarse grid.

// Mean over width x width cells around each cell of a row, edges repeated. The line has room for
// half of the width beside the row on either side.
FN void box_row(const Cells& planes, Long y, Long width, double* line, double* means) {
    const Long rows = planes.size[0], columns = planes.size[1], channels = planes.size[2];
    const Long near = width / 2, count = columns * channels;
    double* inner = line + near * channels;
    for (Long i = 0; i < count; i++) inner[i] = 0.0;
    for (Long v = y - near; v <= y + near; v++) {
        const double* row = planes(clip(v, rows));
        across_once(0, count, EACH(F, Long i) {
            store(inner + i, load<Double<F>>(inner + i) + load<Double<F>>(row + i));
        });
    }
    for (Long i = 0; i < near * channels; i++) {
        line[i] = inner[i % channels];
        inner[count + i] = inner[count - channels + i % channels];
    }
    const double share = 1.0 / double(width * width);
    across(0, count, EACH(F, Long i) {
        Double<F> sum = load<Double<F>>(line + i);
        for (Long u = 1; u < width; u++) sum += load<Double<F>>(line + u * channels + i);
        store(means + i, sum * share);
    });
}

// Mean over narrow x narrow cells less that over wide x wide ones, both odd.
static Status band_rows(Long first, Long last, Cells planes, Lengths widths, View<double, 3> band) {
    const Long columns = planes.size[1], channels = planes.size[2], count = columns * channels;
    const Long narrow = widths.at[0], wide = widths.at[1];
    const Room<double> room(count + wide * channels + count);
    if (!room) return NO_MEMORY;
    double *means = room.at, *line = means + count;
    for (Long y = first; y < last; y++) {
        double* out = band(y);
        box_row(planes, y, narrow, line, out);
        box_row(planes, y, wide, line, means);
        for (Long i = 0; i < count; i++) out[i] -= means[i];
    }
    return DONE;
}
EXPORT(band_of, band_rows)

// Sums over a channel: as many at once at every level, so that all give the same bits.
constexpr int SUMS = 8;
typedef double Sums __attribute__((ext_vector_type(SUMS)));
template <class Term> FN double sum_of(Long count, const Term& term) {
    Sums sums = 0.0;
    Long i = 0;
    for (; i + SUMS <= count; i += SUMS) sums += term(Sums(), i);
    double total = 0.0;
    for (int k = 0; k < SUMS; k++) total += sums[k];
    AS_IT_IS for (; i < count; i++) total += term(double(), i);
    return total;
}

ONCE double mean_of(const double* x, Long count) {
    return sum_of(count, EACH(D, Long i) {
        return load<D>(x + i);
    }) / double(count);
}
ONCE double sum_of_products(const double* x, double mean_x, const double* y, double mean_y,
                            Long count) {
    return sum_of(count, EACH(D, Long i) {
        return (load<D>(x + i) - mean_x) * (load<D>(y + i) - mean_y);
    });
}

// Sums of squares and of products of two sets of numbers without their means.
ONCE void add_moments(const double* a, const double* b, Long count, double* found) {
    const double mean_a = mean_of(a, count), mean_b = mean_of(b, count);
    found[0] = sum_of_products(a, mean_a, a, mean_a, count);
    found[1] = sum_of_products(b, mean_b, b, mean_b, count);
    found[2] = sum_of_products(a, mean_a, b, mean_b, count);
}

// Light (rows, columns) of a picture at some of its rows and columns; what is no number counts as 0.
static void picked_row(Long y, Picture colour, Lengths rows, Lengths columns,
                       View<float, 2> light) {
    constexpr float LARGEST = 1e30f;  // that counts: sums of it are finite
    constexpr float WEIGHTS[3] = {0.2126f, 0.7152f, 0.0722f};  // of Rec.709's luminance
    const float* row = colour(rows.at[y]);
    for (Long x = 0; x < columns.size[0]; x++) {
        const float* pixel = row + 3 * columns.at[x];
        float sum = 0.0f;
        for (int c = 0; c < 3; c++) {
            const float lit = smaller<float>(larger<float>(pixel[c], 0.0f), LARGEST);
            sum += WEIGHTS[c] * (pixel[c] == pixel[c] ? lit : pixel[c]);
        }
        light(y)[x] = sum == sum ? sum : 0.0f;
    }
}
EXPORT(pick_light, picked_row)

// A cell, and where its motion leads, in cells.
struct Moved {
    double x, y;
    Long cell;
};
// Cells whose motion leads to a place between the outermost cells' centres; how many.
static Long find_inside(const Cells& motion, Moved* places) {
    const Long rows = motion.size[0], columns = motion.size[1];
    Long count = 0;
    for (Long j = 0; j < rows; j++) {
        for (Long i = 0; i < columns; i++) {
            const double across = double(i) + motion(j, i)[0], down = double(j) + motion(j, i)[1];
            const bool beside = across >= 0.0 && across <= double(columns - 1);
            if (!(beside && down >= 0.0 && down <= double(rows - 1))) continue;
            places[count++] = {across, down, j * columns + i};
        }
    }
    return count;
}

// A bilinear value at a place inside.
FN double mix(double one, double other, double share) {
    const double kept = one * (1.0 - share), added = other * share;
    return kept + added;  // as NumPy does
}
FN double value_at(const Cells& plane, double x, double y, Long k) {
    const Long left = smaller<Long>(Long(x), larger<Long>(plane.size[1] - 2, 0));
    const Long top = smaller<Long>(Long(y), larger<Long>(plane.size[0] - 2, 0));
    const Long right = smaller<Long>(left + 1, plane.size[1] - 1);
    const Long bottom = smaller<Long>(top + 1, plane.size[0] - 1);
    const double u = x - double(left), v = y - double(top);
    const double above = mix(plane(top, left)[k], plane(top, right)[k], u);
    return mix(above, mix(plane(bottom, left)[k], plane(bottom, right)[k], u), v);
}

// Cells (rows, columns, 2 halves of channels) and those before where their motion leads: for each
// channel the moments of both means, and of both halves of each. And how many lead inside.
static Status compared_rows(Long first, Long last, Cells before, Cells now, Cells motion,
                            View<double, 3> found, View<Long, 1> inside) {
    const Long most = motion.size[0] * motion.size[1], channels = now.size[2] / 2;
    const Room<Moved> places(most);
    const Room<double> room(6 * most);
    if (!places || !room) return NO_MEMORY;
    double *const then[] = {room.at, room.at + most, room.at + 2 * most};
    double *const here[] = {then[2] + most, then[2] + 2 * most, then[2] + 3 * most};
    const Long count = *inside.at = find_inside(motion, places.at);
    for (Long c = first; c < last; c++) {
        for (Long p = 0; p < count; p++) {
            const Moved& place = places.at[p];
            for (int half = 0; half < 2; half++) {
                const Long k = half * channels + c;
                then[half][p] = value_at(before, place.x, place.y, k);
                here[half][p] = now.at[place.cell * now.size[2] + k];
            }
            then[2][p] = (then[0][p] + then[1][p]) / 2.0;
            here[2][p] = (here[0][p] + here[1][p]) / 2.0;
        }
        add_moments(then[2], here[2], count, found(0, c));
        add_moments(then[0], then[1], count, found(1, c));
        add_moments(here[0], here[1], count, found(2, c));
    }
    return DONE;
}
EXPORT(compare_cells, compared_rows)

// Rows of the tone mapper.
#include "colour.h"
#include "tonemap.h"

// The copy that the network sees.

// Shares of the pixels between two places along an axis: the first pixel's number, and how many.
struct Shares {
    Long first, count;
    double from, to;

    Shares(Long at, Long size)
        : from(double(at * size) / SIDE), to(double((at + 1) * size) / SIDE) {
        first = Long(from);
        count = 0;
        while (first + count < size && double(first + count) < to) count++;
    }
    float share(Long i) const {
        const double low = double(first + i), high = low + 1.0;
        return float(((high < to ? high : to) - (low > from ? low : from)) / (to - from));
    }
};

static Status lowres_rows(Long first, Long last, Picture colour, Given<Shaping> params,
                          Given<Matrix> matrix, View<float, 4> lowres) {
    const Long height = colour.size[0], width = colour.size[1];
    const Shaper shaper(*params, *matrix);
    const Room<float> room(4 * width + SIDE + height / SIDE + 2);
    const Room<int> places(2 * SIDE);
    if (!room || !places) return NO_MEMORY;
    float *totals = room.at, *shares = totals + 3 * width, *down = shares + width + SIDE;
    float* next = shares;
    for (Long x = 0; x < SIDE; x++) {
        const Shares columns(x, width);
        places.at[2 * x] = int(columns.first);
        places.at[2 * x + 1] = int(columns.count);
        for (Long i = 0; i < columns.count; i++) *next++ = columns.share(i);
    }
    for (Long y = first; y < last; y++) {
        const Shares rows(y, height);
        for (Long j = 0; j < rows.count; j++) down[j] = rows.share(j);
        across(0, width, EACH(F, Long x) {
            Colour<F> sum = {F(0.0f), F(0.0f), F(0.0f)};
            for (Long j = 0; j < rows.count; j++) {
                const float share = down[j];
                const float* from = colour(rows.first + j) + 3 * x;
                const Colour<F> seen = shaper.shape<F>(colour_at<F>(from));
                sum = {sum.r + share * seen.r, sum.g + share * seen.g, sum.b + share * seen.b};
            }
            store<F>(totals + x, sum.r);
            store<F>(totals + width + x, sum.g);
            store<F>(totals + 2 * width + x, sum.b);
        });
        const float* share = shares;
        for (Long x = 0; x < SIDE; x++) {
            const float* from = totals + places.at[2 * x];
            float sums[3] = {};
            for (Long i = 0; i < places.at[2 * x + 1]; i++, share++) {
                for (int c = 0; c < 3; c++) sums[c] += *share * from[c * width + i];
            }
            for (int c = 0; c < 3; c++) lowres(0, c, y)[x] = sums[c];
        }
    }
    return DONE;
}
EXPORT(lowres, lowres_rows)

// Steadiness.

static void light_row(Long y, View<const float, 4> lowres, View<float, 2> light) {
    for (int c = 0; c < 3; c++) {
        const float* row = lowres(0, c, y);
        double total = 0.0;
        for (int x = 0; x < SIDE; x++) total += row[x];
        light(y)[c] = float(total / SIDE);
    }
}
EXPORT(light, light_row)

// In double precision, so that nothing depends on the order of the sum.
static void follow_row(Long y, View<const float, 2> light, Given<Following> params,
                       View<const float, 2> before, View<float, 2> after) {
    const Long count = light.size[0] * light.size[1];
    double total = 0.0;
    for (Long i = 0; i < count; i++) total += light.at[i];
    const Followed found = followed(total / double(count) / params->scale, *params, before(y));
    const double numbers[4] = {found.kept, found.made_for, found.now, found.share};
    for (int i = 0; i < 4; i++) after(y)[i] = float(numbers[i]);
}
EXPORT(follow, follow_row)

// With nothing kept `previous` is not looked at, so it may hold anything.
static void smooth_row(Long y, View<const float, 5> previous, View<const float, 5> current,
                       View<const float, 2> keep, View<float, 5> result) {
    const Long count = current.size[2] * current.size[3] * current.size[4];
    const float kept = keep.at[0];
    const float *before = previous(0, y), *now = current(0, y);
    float* out = result(0, y);
    across(0, count, EACH(F, Long i) {
        const F value = load<F>(now + i), change = load<F>(before + i) - value;
        const F mixed = value + kept * change;
        const F found = size_of<F>(change) <= BROKEN ? mixed : value;
        store<F>(out + i, kept > 0.0f ? found : value);
    });
}
EXPORT(smooth, smooth_row)

// A double's logarithm and power of 2: series, to its last bits, for a normal x > 0 and |x| < 1000.
FN double log2_of_double(double x) {
    const Long all = __builtin_bit_cast(Long, x);
    const Long exponent = (all - 0x3FE6A09E667F3BCDLL) >> 52;
    const double m = __builtin_bit_cast(double, all - (exponent << 52));
    const double z = (m - 1.0) / (m + 1.0), q = z * z;
    double sum = 0.0;
    for (int k = 23; k >= 1; k -= 2) sum = sum * q + 1.0 / k;
    return double(exponent) + 2.0 * 1.4426950408889634 * z * sum;
}
FN double exp2_of_double(double x) {
    const Long n = Long(x < 0.0 ? x - 0.5 : x + 0.5);
    const double r = (x - double(n)) * 0.6931471805599453;
    double sum = 1.0;
    for (int k = 14; k >= 1; k--) sum = 1.0 + sum * r / k;
    return sum * __builtin_bit_cast(double, (n + 1023) << 52);
}

// In double precision, so that the exposure of a still picture stays as it is to the bit.
static void expose_rows(Long first, Long last, View<const float, 1> previous,
                        View<const float, 2> current, View<const float, 2> keep,
                        Given<Shaping> params, View<float, 1> result) {
    const float kept = keep.at[0];
    double stops = current.at[0];
    if (kept > 0.0f && previous.at[0] > 0.0f) {
        const double change = log2_of_double(previous.at[0]) - stops;
        if (change <= MOST_STOPS && change >= -MOST_STOPS) stops += double(kept) * change;
    }
    const float found[3] = {float(exp2_of_double(stops)), params->toe / params->exposure,
                            params->scale};
    for (Long i = first; i < last; i++) result.at[i] = found[i];
}
EXPORT(expose, expose_rows)

// The look: a bilateral grid of matrices, and a cube.

// Level of a shaped colour in the grid, before the clip: ramps of each channel of a matrix's
// result.
struct Guide {
    float matrix[9], bias[3], shifts[3][KNOTS], slopes[3][KNOTS], mix[3], mix_bias;
};
struct Ramps {
    const Guide& guide;
    float slopes[3][KNOTS];

    explicit Ramps(const Guide& guide) : guide(guide) {
        for (int c = 0; c < 3; c++) {
            for (int k = 0; k < KNOTS; k++) slopes[c][k] = guide.mix[c] * guide.slopes[c][k];
        }
    }
    template <class F> FN_MEMBER F level(F r, F g, F b) const {
        F sum = F(guide.mix_bias);
        for (int c = 0; c < 3; c++) {
            const float* m = guide.matrix + 3 * c;
            const F value = m[0] * r + m[1] * g + m[2] * b + guide.bias[c];
            UNROLL for (int k = 0; k < KNOTS; k++) {
                sum += slopes[c][k] * larger<F>(value - guide.shifts[c][k], F(0.0f));
            }
        }
        return sum;
    }
};

FN float least_of(float x) { return x; }
FN float most_of(float x) { return x; }
FN float least_of(Wide x) { return __builtin_reduce_min(x); }
FN float most_of(Wide x) { return __builtin_reduce_max(x); }

// Pixels between two columns of the grid, and a row of it: what they share. The second matrix is
// what the right column's has more than the left one's.
struct Span {
    const float *left, *more;
    Long levels;

    template <class F>
    FN_MEMBER Colour<F> apply(const Colour<F>& colour, F depth, F across) const {
        Colour<F> sum = {F(0.0f), F(0.0f), F(0.0f)};
        const int from = int(least_of(depth)), to = int(most_of(depth)) + 1;
        for (int j = from; j <= to && j < levels; j++) {
            const float *a = left + j * COEFFICIENTS, *d = more + j * COEFFICIENTS;
            const F weight = larger<F>(1.0f - size_of<F>(depth - float(j)), F(0.0f));
            const Colour<F> own = {colour.r * weight, colour.g * weight, colour.b * weight};
            const auto row = PIXELS(int i) {
                const F r = a[i] + across * d[i], g = a[i + 1] + across * d[i + 1];
                const F b = a[i + 2] + across * d[i + 2], w = a[i + 3] + across * d[i + 3];
                const F found = r * own.r + g * own.g + b * own.b + w * weight;
                return weight > 0.0f ? found : F(0.0f);
            };
            sum = {sum.r + row(0), sum.g + row(4), sum.b + row(8)};
        }
        return sum;
    }
};

// A row of the grid at a place in [0, 1], and what each of its columns has more than the one
// before.
static void fill_grid(const View<const float, 5>& grid, float place, float* row, float* more) {
    const Long high = grid.size[1], wide = grid.size[2], count = grid.size[3] * COEFFICIENTS;
    const float y = within<float>(place * float(high) - 0.5f, 0.0f, float(high - 1));
    const Long above = Long(y), below = smaller<Long>(above + 1, high - 1);
    const float share = y - float(above);
    for (Long i = 0; i < wide * count; i++) {
        const float a = grid(0, above)[i], b = grid(0, below)[i];
        row[i] = a + share * (b - a);
    }
    for (Long i = 0; i < (wide + 1) * count; i++) {
        const bool inside = i >= count && i < wide * count;
        more[i] = inside ? row[i] - row[i - count] : 0.0f;
    }
}

// First pixels of the spans between the grid's columns, and after the last one's end; and how far
// across its span each pixel is.
static void fill_spans(Long width, Long wide, int* spans, float* shares) {
    spans[0] = 0;
    spans[wide + 1] = int(width);
    for (Long n = 1; n <= wide; n++) {
        const double at = (double(n) - 0.5) * double(width) / double(wide) - 0.5;
        const int next = int(at) + (double(int(at)) < at ? 1 : 0);
        spans[n] = smaller<int>(larger<int>(next, spans[n - 1]), int(width));
    }
    for (Long n = 0; n <= wide; n++) {
        for (Long x = spans[n]; x < spans[n + 1]; x++) {
            const double at =
                (double(x) + 0.5) * double(wide) / double(width) - 0.5 - double(n - 1);
            shares[x] = float(at < 0.0 ? 0.0 : at > 1.0 ? 1.0 : at);
        }
    }
}

static Status slice_apply_rows(Long first, Long last, Picture colour, Given<Shaping> params,
                               Given<Matrix> matrix, Given<Guide> guide, View<const float, 5> grid,
                               Cube cube, NewPicture output) {
    const Long height = colour.size[0], width = colour.size[1];
    const Long wide = grid.size[2], levels = grid.size[3], count = levels * COEFFICIENTS;
    const Shaper shaper(*params, *matrix);
    const LookUp cubes(cube, width);
    const Room<float> room(width + (2 * wide + 1) * count);
    const Room<int> spans(wide + 2);
    if (!cubes || !room || !spans) return NO_MEMORY;
    float *shares = room.at, *row = shares + width, *more = row + wide * count;
    fill_spans(width, wide, spans.at, shares);
    const Ramps ramps(*guide);
    for (Long y = first; y < last; y++) {
        fill_grid(grid, (float(y) + 0.5f) / float(height), row, more);
        const float* from = colour(y);
        for (Long n = 0; n <= wide; n++) {
            const Long left = larger<Long>(n - 1, 0);
            const Span span = {row + left * count, more + n * count, levels};
            across(spans.at[n], spans.at[n + 1], EACH(F, Long x) {
                const Colour<F> seen = shaper.shape<F>(colour_at<F>(from + 3 * x));
                const F level = ramps.level<F>(seen.r, seen.g, seen.b) * float(levels) - 0.5f;
                const F depth = within<F>(level, 0.0f, float(levels - 1));
                cubes.find<F>(span.apply<F>(seen, depth, load<F>(shares + x)), x);
            });
        }
        cubes.put(output(y));
    }
    return DONE;
}
EXPORT(slice_apply, slice_apply_rows)

// Rows of the enlargement. Its six kernels differ in where the head comes from and in what
// reflectance radiance is multiplied by.
#include "upsample_rows.h"
#include "fine_codes.h"
#include "tints.h"

// What all six read and write.
struct Upsample : Samples {
    Picture warped;
    NewPicture output, history;

    // The frame's row that one of the output is; beyond the frame, its last one.
    Long row(Long n) const {
        return smaller<Long>(Long(window.out_top) + n, Long(window.out_height) - 1);
    }
};
struct Guides {
    Picture diffuse, specular, trust;
    typedef Arrays<Picture, Picture, Picture> Members;
};

// The head's rows: they are there, or two at a time are made of codes.
struct CodedHead {
    Codes codes;
    Factors factors;
    Scaling scaling;
    typedef Arrays<Codes, Factors, Scaling> Members;
};
struct Heads {
    FineHead fine;
    CodedHead coded;
    Room<int> turned;
    Room<float> made;
    mutable Long pair = -1;

    explicit Heads(const FineHead& fine) : fine(fine), coded(), turned(0), made(0) {}
    explicit Heads(const CodedHead& coded)
        : fine(), coded(coded), turned(room_for(coded.codes)),
          made(MIX * 4 * coded.codes.size[2]) {}
    explicit operator bool() const { return bool(turned) && bool(made); }

    Head row(Long y) const {
        if (coded.codes.at == nullptr) return head_of(fine, y);
        const Long w = 2 * coded.codes.size[2];
        if (pair != y / 2) {
            pair = y / 2;
            open_fine_row(coded.codes, pair, coded.factors, coded.scaling, TAP_WEIGHTS, MIX,
                          turned.at, made.at + TAP_WEIGHTS * 2 * w, 2 * w);
        }
        return {made.at + y % 2 * w, 2 * w};
    }
};

// Where a pixel's centre lies among the cells of `size` render pixels, from centre to centre.
FN float place_of(Place at, Long size) {
    const float place = (float(at.index) + at.offset + 0.5f) / TRUST_CELL - 0.5f;
    return within<float>(place, 0.0f, float((size - 1) / TRUST_CELL));
}

// How far each pixel of a row of the output trusts the guides, linear between cells.
static void fill_trust(const Picture& cells, float place, const float* places, Long width,
                       float* out) {
    const Long upper = Long(place), lower = clip(upper + 1, cells.size[0]);
    const float share = place - float(upper);
    for (Long x = 0; x < width; x++) {
        const Long left = Long(places[x]), right = clip(left + 1, cells.size[1]);
        const float across = places[x] - float(left);
        const float a = *cells(upper, left), b = *cells(upper, right);
        const float c = *cells(lower, left), d = *cells(lower, right);
        const float above = a + (b - a) * across, below = c + (d - c) * across;
        out[x] = above + (below - above) * share;
    }
}

// The guides' reflectance in a row of the output, planar; beyond the frame the last one is
// repeated.
static void fill_guides(const Guides& guides, Long y, Long left, const Rooms& rooms) {
    const Long held = smaller<Long>(rooms.width, guides.diffuse.size[1] - left);
    const float *some = guides.diffuse(y, left), *others = guides.specular(y, left);
    fill_tints(some, others, held, rooms.guide(0), rooms.guide(1), rooms.guide(2));
    for (int c = 0; c < 3; c++) {
        for (Long x = held; x < rooms.width; x++) rooms.guide(c)[x] = rooms.guide(c)[held - 1];
    }
}

// The render pixels' reflectance in a row of the output, planar.
static void fill_own(const float* factor, const Rooms& rooms) {
    for (Long x = 0; x < rooms.width; x++) {
        for (int c = 0; c < 3; c++) rooms.guide(c)[x] = factor[3 * rooms.index.at[x] + c];
    }
}

template <class F> FN void keep_lit(const Rooms& rooms, Long x, const Lit<F>& lit) {
    for (int c = 0; c < 3; c++) store<F>(rooms.rgb(c) + x, lit.rgb[c]);
    store<F>(rooms.trust() + x, lit.trust);
}

// Colours of a row, in three ways.

template <Reflectance BY>
FN void row_at_corners(const Row& row, const Sides& sides, int lower, const Rooms& rooms) {
    across(0, rooms.columns, EACH(F, Long x) {
        const AtCorner left = {row, sides.left, x, 2 * lower, 0};
        const AtCorner right = {row, sides.right, x, 2 * lower + 1, 1};
        const Lit<F> even = upsample_pixel<F, BY>(row, left);
        const Lit<F> odd = upsample_pixel<F, BY>(row, right);
        for (int c = 0; c < 3; c++) store_pairs<F>(rooms.rgb(c) + 2 * x, even.rgb[c], odd.rgb[c]);
        store_pairs<F>(rooms.trust() + 2 * x, even.trust, odd.trust);
    });
}

template <Reflectance BY>
FN void row_at_centres(const Row& row, const Weights& weights, const Rooms& rooms) {
    across(0, rooms.width, EACH(F, Long x) {
        keep_lit<F>(rooms, x, upsample_pixel<F, BY>(row, AtCentre{row, weights, x}));
    });
}

template <Reflectance BY>
FN void row_anywhere(const Row& row, const Distances& distances, float lower, const Rooms& rooms) {
    const Columns columns = {rooms.index.at, rooms.lean(), rooms.near(), rooms.wide(), rooms.width};
    across(0, rooms.width, EACH(F, Long x) {
        const Anywhere at = {row, columns, distances, lower, x};
        keep_lit<F>(rooms, x, upsample_pixel<F, BY>(row, at));
    });
}

FN void blend_row(const Rooms& rooms, const Upsample& given, Long n) {
    const float *warped = given.warped(n), darken = 1.0f / given.params.exposure;
    float *history = given.history(n), *output = given.output(n);
    across(0, rooms.width, EACH(F, Long x) {
        const F trust = load<F>(rooms.trust() + x);
        F kept[3];
        for (int c = 0; c < 3; c++) {
            kept[c] = blended<F>(load<F>(rooms.rgb(c) + x), pick<F, 3>(warped + 3 * x + c), trust);
        }
        store_triples<F>(history + 3 * x, kept[0], kept[1], kept[2]);
        store_triples<F>(output + 3 * x, expm1_of<F>(kept[0]) * darken,
                         expm1_of<F>(kept[1]) * darken, expm1_of<F>(kept[2]) * darken);
    });
}

// Any of the kernels: fill(y, at) makes the guides of a row. Where it is the render pixels' OWN,
// the output has the render's size, and a compiler need not make the other ways.
template <Reflectance BY, class Fill>
FN Status upsample_rows(Long first, Long last, const Upsample& given, const Heads& heads,
                        const Rooms& rooms, const Fill& fill) {
    const Long h = given.moved.size[0];
    const bool doubles = given.doubles(rooms.width), same = given.keeps_size(rooms.width);
    fill_columns(given, rooms);
    for (Long n = first; n < last; n++) {
        const Long y = given.row(n);
        const Place at = row_of(given.window, n, h);
        const Distances down = distances_of(given.params.jitter_y - at.offset);
        fill(y, at);
        const Row row = row_of_samples(given, rooms, heads.row(at.index), y, at.index);
        if (BY != OWN && doubles) {
            const Sides sides = sides_of(down, given.params);
            if constexpr (BY != OWN) row_at_corners<BY>(row, sides, int(y % 2), rooms);
        } else if (BY != GUIDED && same) {
            const Weights weights = weights_of(down, distances_of(given.params.jitter_x));
            if constexpr (BY != GUIDED) row_at_centres<BY>(row, weights, rooms);
        } else if constexpr (BY != OWN) {
            row_anywhere<BY>(row, down, lean_of(at.offset), rooms);
        }
        blend_row(rooms, given, n);
    }
    return DONE;
}

// Reflectance.

static Status plain_rows(Long first, Long last, const Upsample& given, const Heads& heads) {
    const Rooms rooms(given.output.size[1], given.moved.size[1]);
    if (!rooms || !heads) return NO_MEMORY;
    return upsample_rows<NONE>(first, last, given, heads, rooms, [](Long, Place) {});
}

// Radiance without reflectance and with it: the first gets the guides' as far as they are trusted.
static Status guided_rows(Long first, Long last, const Upsample& given, const Guides& guides,
                          const Heads& heads) {
    const Rooms rooms(given.output.size[1], given.moved.size[1]);
    if (!rooms || !heads) return NO_MEMORY;
    const Window& window = given.window;
    const Long h = smaller<Long>(given.moved.size[0], Long(window.height) - Long(window.top));
    const Long w = smaller<Long>(given.moved.size[1], Long(window.width) - Long(window.left));
    for (Long x = 0; x < rooms.width; x++) {
        rooms.place()[x] = place_of(column_of(window, x, rooms.columns), w);
    }
    return upsample_rows<GUIDED>(first, last, given, heads, rooms, [&](Long y, Place at) {
        fill_guides(guides, y, Long(window.out_left), rooms);
        fill_trust(guides.trust, place_of(at, h), rooms.place(), rooms.width, rooms.guide(3));
    });
}

// The same planes at the size of the render. Where samples lie at the centres of pixels, those
// without reflectance are weighed and then multiplied by the pixels' own: texture is not resampled.
// Else those with it are, and multiplied by 1.
static Status unscaled_rows(Long first, Long last, Upsample given, const Picture& factor,
                            const Heads& heads) {
    const bool resampled = given.params.jitter_x != 0 || given.params.jitter_y != 0;
    if (resampled) given.radiance.at = given.radiance(3);
    const Rooms rooms(given.output.size[1], given.moved.size[1]);
    if (!rooms || !heads) return NO_MEMORY;
    if (resampled) fill(rooms.guide(0), 0, 3 * rooms.width, 1.0f);
    return upsample_rows<OWN>(first, last, given, heads, rooms, [&](Long, Place at) {
        if (!resampled) fill_own(factor(at.index), rooms);
    });
}

// The kernels.

// What leads to the last output, and that at the output's pixels.
struct Before {
    Picture moved, past, warped;
    typedef Arrays<Picture, Picture, Picture> Members;
};
struct Made {
    Given<Params> params;
    Given<Window> window;
    Picture keep;
    NewPicture output, history;
    typedef Arrays<Given<Params>, Given<Window>, Picture, NewPicture, NewPicture> Members;
};
FN Upsample upsample_of(const Picture& radiance, const Before& before, const Made& made) {
    return {{radiance, before.moved, before.past, *made.params, *made.window, made.keep},
            before.warped, made.output, made.history};
}

template <class Head>
static Status plain(Long first, Long last, Picture radiance, Head head, Before before, Made made) {
    return plain_rows(first, last, upsample_of(radiance, before, made), Heads(head));
}
EXPORT_ALONE(denoise_upsample, plain<FineHead>)
EXPORT_ALONE(denoise_upsample_codes, plain<CodedHead>)

template <class Head>
static Status guided(Long first, Long last, Picture radiance, Head head, Before before,
                     Guides guides, Made made) {
    return guided_rows(first, last, upsample_of(radiance, before, made), guides, Heads(head));
}
EXPORT_ALONE(denoise_upsample_guided, guided<FineHead>)
EXPORT_ALONE(denoise_upsample_guided_codes, guided<CodedHead>)

template <class Head>
static Status unscaled(Long first, Long last, Picture radiance, Head head, Before before,
                       Picture factor, Made made) {
    return unscaled_rows(first, last, upsample_of(radiance, before, made), factor, Heads(head));
}
EXPORT_ALONE(denoise_upsample_unscaled, unscaled<FineHead>)
EXPORT_ALONE(denoise_upsample_unscaled_codes, unscaled<CodedHead>)

// A picture that the network gives itself: its pixels are log-encoded, and the first control is the
// share of each beside the history.
struct AtPixel {
    const Row& row;
    Long x;

    template <class F> FN_MEMBER F predicted(int) const { return load<F>(row.head.at + x); }
    template <class F, int STEP> FN_MEMBER F render(const float* from) const {
        return pick<F, STEP>(from + STEP * x);
    }
    template <class F> FN_MEMBER F column() const { return ramp<F>(float(row.left + x), 1.0f); }
};

static Status picture(Long first, Long last, View<const float, 4> picture, FineHead controls,
                      Before before, Made made) {
    const Picture planes = {picture.at, {picture.size[1], picture.size[2], picture.size[3]}};
    const Upsample given = upsample_of(planes, before, made);
    const Rooms rooms(given.output.size[1], given.moved.size[1]);
    if (!rooms) return NO_MEMORY;
    for (Long n = first; n < last; n++) {
        const Long y = given.row(n), at = row_of(given.window, n, given.moved.size[0]).index;
        const Row row = row_of_samples(given, rooms, head_of(controls, at), y, at);
        across(0, rooms.width, EACH(F, Long x) {
            Lit<F> lit;
            for (int c = 0; c < 3; c++) {
                lit.rgb[c] = larger<F>(load<F>(row.radiance + c * row.plane + x), F(0.0f));
            }
            lit.trust = trust_of<F>(row, AtPixel{row, x});
            keep_lit<F>(rooms, x, lit);
        });
        blend_row(rooms, given, n);
    }
    return DONE;
}
EXPORT_ALONE(denoise_blend_picture, picture)

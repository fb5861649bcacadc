// Rows of the picture's parts, such as light groups: they get the picture's weights and filters.
#include "parts.h"
#include "tints.h"
#include "upsample_rows.h"
#include "warp.h"

// Reflectance of a part that has another one than the picture. Columns beyond the frame repeat its
// last one.
static void reflectance_row(Long y, Picture diffuse, Picture specular, Places rows, Places columns,
                            NewPicture factor) {
    const Long w = columns.size[0], left = Long(columns.at[0]);
    const Long held = Long(columns.at[w - 1]) - left + 1;
    const Long row = Long(rows.at[y]);
    const float *some = diffuse(row, left), *others = specular(row, left);
    float* out = factor(y);
    across(0, held, EACH(F, Long x) {
        const Tint<F> found = tint_at<F>(some, others, x);
        store_triples<F>(out + 3 * x, found.red, found.green, found.blue);
    });
    for (Long i = 3 * held; i < 3 * w; i++) out[i] = out[i - 3];
}
EXPORT_ALONE(denoise_reflectance, reflectance_row)

// Running mean.

// Four numbers from a pixel on; of the last pixel there are three.
FN Four load_pixel(const float* at, const float* end) {
    if (at + 4 <= end) return load<Four>(at);
    return Four{at[0], at[1], at[2], 0.0f};
}

// Where the last frame's pixels are bilinear, of a row: the first of each four, and their shares.
struct Recalled {
    const float* picture;
    Long height, width;
    float *right, *lower;
    int* start;

    FN_MEMBER void find(const float* moved, Long v, Long left, Long count) const {
        across(0, count, EACH(F, Long x) {
            const F px = within<F>(ramp<F>(float(left + x), 1.0f) + pick<F, 2>(moved + 2 * x), 0.0f,
                                   float(width - 1));
            const F py = within<F>(float(v) + pick<F, 2>(moved + 2 * x + 1), 0.0f,
                                   float(height - 1));
            const F at_x = smaller<F>(floor_of(px), F(float(width > 1 ? width - 2 : 0)));
            const F at_y = smaller<F>(floor_of(py), F(float(height > 1 ? height - 2 : 0)));
            store<F>(right + x, px - at_x);
            store<F>(lower + x, py - at_y);
            store_int<F>(start + x, (whole(at_y) * int(width) + whole(at_x)) * 3);
        });
    }
    FN_MEMBER Four sample(Long x) const {
        const float *at = picture + start[x], *end = picture + 3 * height * width;
        const Long beside = width > 1 ? 3 : 0, below = height > 1 ? 3 * width : 0;
        const float tx = right[x], ty = lower[x];
        const Four top = load_pixel(at, end) * (1.0f - tx) + load_pixel(at + beside, end) * tx;
        const Four bottom = load_pixel(at + below, end) * (1.0f - tx)
                            + load_pixel(at + below + beside, end) * tx;
        return top * (1.0f - ty) + bottom * ty;
    }
};

static Status accumulate_rows(Long first, Long last, Picture part, Given<Coding> coding,
                              Picture factor, Picture past, Picture moved, Picture last_part,
                              FineHead fine, Given<Window> window, NewPicture next_part,
                              NewPicture level) {
    const Long h = part.size[0], w = part.size[1], th = next_part.size[0], tw = next_part.size[1];
    const Long top = Long(window->top), left = Long(window->left), width = level.size[2];
    const Long rows = smaller<Long>(th, h - top), columns = smaller<Long>(tw, w - left);
    const Room<float> room(5 * columns + 3 * columns + 1);
    const Room<int> start(columns);
    if (!room || !start) return NO_MEMORY;
    const Recalled recalled = {last_part.at, h, w, room.at, room.at + columns, start.at};
    float* before = room.at + 5 * columns;
    for (Long y = first; y < last; y++) {
        const Long held = y < rows ? columns : 0;
        for (int c = 0; c < 3; c++) {
            for (Long x = held; x < width; x++) level(c, y)[x] = 0.0f;
        }
        if (y < th) {
            for (Long i = 3 * held; i < 3 * tw; i++) next_part(y)[i] = 0.0f;
        }
        if (held == 0) continue;
        recalled.find(moved(y), top + y, left, held);
        const float* counts = past(y) + 3;
        for (Long x = 0; x < held; x++) {
            const Four found = counts[4 * x] > 0.0f ? recalled.sample(x) : Four{};
            store(before + 3 * x, found);
        }
        const float *values = part(top + y, left), *divisor = factor(y),
                    *distrust = fine(0, DISTRUST, y);
        float *mean = next_part(y), *const planes[3] = {level(0, y), level(1, y), level(2, y)};
        across(0, held, EACH(F, Long x) {
            const F share = newer_share<F>(pick<F, 4>(past(y) + 4 * x + 3), load<F>(distrust + x));
            F found[3];
            for (int c = 0; c < 3; c++) {
                const F now = coded<F>(pick<F, 3>(values + 3 * x + c),
                                       pick<F, 3>(divisor + 3 * x + c), *coding);
                found[c] = accumulated<F>(now, pick<F, 3>(before + 3 * x + c), share);
                store<F>(planes[c] + x, found[c]);
            }
            store_triples<F>(mean + 3 * x, found[0], found[1], found[2]);
        });
    }
    return DONE;
}
EXPORT_ALONE(denoise_accumulate_part, accumulate_rows)

// Enlargement: the weights of a row are made once for all parts.

// Enlarged parts of a row before they are blended, three rows each.
struct LightRows {
    float* at;
    Long width, parts;

    FN_MEMBER float* row(Long channel) const { return at + channel * width; }
};

FN void light_at_corners(const Row& row, const Sides& sides, int lower, const Rooms& rooms,
                         const LightRows& light) {
    across(0, rooms.columns, EACH(F, Long x) {
        const AtCorner left = {row, sides.left, x, 2 * lower, 0};
        const AtCorner right = {row, sides.right, x, 2 * lower + 1, 1};
        const LightWeights<F> even = light_weights<F>(left), odd = light_weights<F>(right);
        for (Long c = 0; c < 3 * light.parts; c++) {
            store_pairs<F>(light.row(c) + 2 * x, light_sample<F>(row, left, even, c),
                           light_sample<F>(row, right, odd, c));
        }
        store_pairs<F>(rooms.trust() + 2 * x, trust_of<F>(row, left), trust_of<F>(row, right));
    });
}

template <class F, class At>
FN void light_at(const Row& row, const At& at, const Rooms& rooms, const LightRows& light) {
    const LightWeights<F> weights = light_weights<F>(at);
    for (Long c = 0; c < 3 * light.parts; c++) {
        store<F>(light.row(c) + at.x, light_sample<F>(row, at, weights, c));
    }
    store<F>(rooms.trust() + at.x, trust_of<F>(row, at));
}

FN bool any_of(const float* row, Long count) {
    for (Long i = 0; i < count; i++) {
        if (row[i] != 0.0f) return true;
    }
    return false;
}

static Status light_rows(Long first, Long last, Picture radiance, FineHead fine, Picture moved,
                         Picture past, View<const float, 4> before, Given<Params> params,
                         Given<Window> window, Picture keep, Places out_rows, Places out_columns,
                         View<float, 4> light) {
    const Samples given = {radiance, moved, past, *params, *window, keep};
    const Long parts = light.size[0], width = light.size[2], w = moved.size[1];
    const Long left = Long(window->out_left);
    const Rooms rooms(width, w);
    const Warper warper(out_columns, *window, w, before.size[1], before.size[2]);
    const Room<float> room(6 * parts * width);
    if (!rooms || !warper || !room) return NO_MEMORY;
    const LightRows enlarged = {room.at, width, parts};
    float* warped = room.at + 3 * parts * width;
    for (Long i = 0; i < 3 * parts * width; i++) warped[i] = 0.0f;
    const bool doubles = given.doubles(width), same = given.keeps_size(width);
    const bool beyond = left + width > Long(window->out_width);
    fill_columns(given, rooms);
    Long known = -1;
    for (Long n = first; n < last; n++) {
        const Long y = Long(out_rows.at[n]);
        const Place at = row_of(*window, n, moved.size[0]);
        const Distances down = distances_of(params->jitter_y - at.offset);
        const Row row = row_of_samples(given, rooms, head_of(fine, at.index), y, at.index);
        if (doubles) {
            light_at_corners(row, sides_of(down, *params), int(y % 2), rooms, enlarged);
        } else if (same) {
            const Weights weights = weights_of(down, distances_of(params->jitter_x));
            across(0, width, EACH(F, Long x) {
                light_at<F>(row, AtCentre{row, weights, x}, rooms, enlarged);
            });
        } else {
            const Columns columns = {rooms.index.at, rooms.lean(), rooms.near(), rooms.wide(),
                                     width};
            const float lower = lean_of(at.offset);
            across(0, width, EACH(F, Long x) {
                light_at<F>(row, Anywhere{row, columns, down, lower, x}, rooms, enlarged);
            });
        }
        // Rows that keep nothing, or where nothing moves, need no reprojection.
        const bool keeps = any_of(rooms.trust(), width);
        const bool moves = beyond || any_of(moved(at.index), 2 * w);
        if (keeps && moves) {
            if (known != at.index) warper.move(moved(at.index));
            known = at.index;
            warper.find(y);
        }
        for (Long k = 0; k < parts; k++) {
            float* own = warped + 3 * k * width;
            if (keeps && moves) warper.warp(before(k), y, own);
            const float* last_light = keeps && !moves ? before(k, y, left) : own;
            float* out = light(k, n);
            across(0, width, EACH(F, Long x) {
                const F trust = load<F>(rooms.trust() + x);
                F found[3];
                for (int c = 0; c < 3; c++) {
                    found[c] = blended_light<F>(load<F>(enlarged.row(3 * k + c) + x),
                                                pick<F, 3>(last_light + 3 * x + c), trust,
                                                1.0f / params->exposure);
                }
                store_triples<F>(out + 3 * x, found[0], found[1], found[2]);
            });
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_upsample_light, light_rows)

// Proportions.

// Covers of a row: where there is light of each part, by render pixels, for every number.
FN void fill_covers(const Picture& reached, Long y, Long height, Long width, float* covers) {
    for (Long k = 0; k < reached.size[0]; k++) {
        const float* from = reached(k, y * reached.size[1] / height);
        for (Long x = 0; x < width; x++) {
            const float cover = from[x * reached.size[2] / width];
            for (int c = 0; c < 3; c++) covers[(k * width + x) * 3 + c] = cover;
        }
    }
}

// Parts in the proportions that they have to each other if they are complete, when each counts as
// having the same where none has light; else to the whole, which was filtered like them. Parts that
// are no part of the picture stay as they were filtered: nothing tells their light.
template <bool COVERED, bool COMPLETE>
FN void balance_row(const View<const float, 4>& parts, const float* covers, const float* whole,
                    const float* picture, Long y, const View<float, 4>& balanced) {
    const Long count = parts.size[0], width = 3 * parts.size[2];
    across(0, width, EACH(F, Long i) {
        const auto light = PIXELS(Long k) {
            const F found = load<F>(parts(k, y) + i);
            return COVERED ? found * load<F>(covers + k * width + i) : found;
        };
        F total = F(0.0f), rest = F(0.0f);
        for (Long k = 0; k < count; k++) total += light(k);
        if constexpr (COMPLETE) {
            rest = larger<F>(F(DARKEST) - total, F(0.0f));
            total += float(count) * rest;
        } else {
            total = larger<F>(total, larger<F>(load<F>(whole + i), F(DARKEST)));
        }
        const F ratio = load<F>(picture + i) / total;
        for (Long k = 0; k < count; k++) store<F>(balanced(k, y) + i, (light(k) + rest) * ratio);
    });
}

template <bool COVERED>
FN void keep_row(const View<const float, 4>& parts, const float* covers, Long y,
                 const View<float, 4>& balanced) {
    const Long width = 3 * parts.size[2];
    for (Long k = 0; k < parts.size[0]; k++) {
        across(0, width, EACH(F, Long i) {
            const F found = load<F>(parts(k, y) + i);
            store<F>(balanced(k, y) + i, COVERED ? found * load<F>(covers + k * width + i) : found);
        });
    }
}

static Status balance_rows(Long first, Long last, View<const float, 4> parts, Picture reached,
                           Picture whole, Picture picture, Places complete,
                           View<float, 4> balanced) {
    const Long height = parts.size[1], width = parts.size[2];
    const bool covered = reached.size[1] > 1, alone = complete.at[0] > 0.0f;
    const bool beyond = complete.at[0] < 0.0f;
    const Room<float> covers(covered ? parts.size[0] * width * 3 : 0);
    if (!covers) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        const float *all = whole(y), *target = picture(y);
        if (covered) fill_covers(reached, y, height, width, covers.at);
        with_flag(covered, PIXELS(auto is_covered) {
            if (beyond) return keep_row<is_covered()>(parts, covers.at, y, balanced);
            with_flag(alone, PIXELS(auto is_alone) {
                balance_row<is_covered(), is_alone()>(parts, covers.at, all, target, y, balanced);
            });
        });
    }
    return DONE;
}
EXPORT_ALONE(denoise_balance, balance_rows)

// Values of a plane from filtered ones. Planes of one channel were filtered as three.
template <int CHANNELS>
static void decode_row(Long y, Picture filtered, Given<Decoding> decoding, NewPicture plane) {
    const Decoding& by = *decoding;
    const float* from = filtered(y);
    float* out = plane(y);
    across(0, plane.size[1], EACH(F, Long x) {
        F found[3];
        if (by.kind < 0.0f) {
            found[0] = distance_of<F>(pick<F, 3>(from + 3 * x), pick<F, 3>(from + 3 * x + 1), by);
            found[1] = found[2] = found[0];
        } else {
            for (int c = 0; c < CHANNELS; c++) {
                found[c] = decoded<F>(pick<F, 3>(from + 3 * x + c), by);
            }
        }
        if (by.kind > 0.0f) {
            F square = F(0.0f);
            for (int c = 0; c < CHANNELS; c++) square += found[c] * found[c];
            const F scale = scale_to_one<F>(square);
            for (int c = 0; c < CHANNELS; c++) found[c] *= scale;
        }
        if constexpr (CHANNELS == 3) store_triples<F>(out + 3 * x, found[0], found[1], found[2]);
        else store<F>(out + x, found[0]);
    });
}
EXPORT_ALONE(denoise_decode, decode_row<3>)
EXPORT_ALONE(denoise_decode_one, decode_row<1>)

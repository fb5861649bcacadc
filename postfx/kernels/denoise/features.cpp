// Rows of what the network looks at. Channels: colour 0, accumulated colour 3 and last output 6
// (demodulated, log-encoded), diffuse albedo 9, specular albedo 12, normal 15, roughness 18, depth
// 19, its change 20, valid history 21, sample count 22, jitter 23, length of motion 25, inverse
// scale 26, hidden state 27.
#include "features.h"
#include "recall.h"
#include "store.h"
#include "tints.h"

struct Looks {
    Picture colour, diffuse, specular, normal, roughness, depth, moved, state, last_depth, warped;
    Places depth_scale;
    Given<Params> params;
    Given<Window> window;
    Picture keep;
    Places seen_rows, seen_columns;
    typedef Arrays<Picture, Picture, Picture, Picture, Picture, Picture, Picture, Picture, Picture,
                   Picture, Places, Given<Params>, Given<Window>, Picture, Places, Places> Members;

    // Columns of the part that lie in the frame.
    Long held(const NewPicture& past) const {
        return smaller<Long>(past.size[1], Long(window->width) - Long(window->left));
    }
};

// Memory of a row: what is recalled, the last output's sum and mean; and the first output column
// that each pixel touches, with the one after the last.
struct FeatureRooms : RecallRooms {
    Long out;
    Room<int> edges;
    Room<float> lines, spare;

    FeatureRooms(Long count, Long wide, Long out)
        : RecallRooms(count),
          out(out),
          edges(2 * count),
          lines(3 * count + 3 * out),
          spare(4 * wide) {}
    explicit operator bool() const {
        return RecallRooms::operator bool() && bool(edges) && bool(lines) && bool(spare);
    }
    int* left() const { return edges.at; }
    int* right() const { return edges.at + count; }
    float* mean(int c) const { return lines.at + c * count; }
    float* total(int c) const { return lines.at + 3 * count + c * out; }
};

// Rows of channels, a step apart.
struct ChannelRows {
    float* at;
    Long step;
    float* operator()(int channel) const { return at + channel * step; }
};

FN void fill_edges(const Looks& looks, const FeatureRooms& rooms) {
    const Window& window = *looks.window;
    const Long w = Long(window.width), width = Long(window.out_width), first = Long(window.left);
    for (Long x = 0; x < rooms.count; x++) {
        rooms.left()[x] = int((first + x) * width / w - Long(window.out_left));
        rooms.right()[x] = int(((first + x + 1) * width + w - 1) / w - Long(window.out_left));
    }
}

// Mean of the output pixels that each render pixel of a row touches.
FN void mean_row(const Looks& looks, Long top, Long bottom, const FeatureRooms& rooms) {
    across(0, rooms.out, EACH(F, Long x) {
        for (int c = 0; c < 3; c++) {
            F total = F(0.0f);
            for (Long y = top; y < bottom; y++) total += pick<F, 3>(looks.warped(y) + 3 * x + c);
            store<F>(rooms.total(c) + x, total);
        }
    });
    const int *left = rooms.left(), *right = rooms.right();
    const Long count = rooms.count, step = right[0] - left[0];
    const bool even = step <= 2 && right[count - 1] - left[0] == step * count;
    const float share = 1.0f / float((bottom - top) * step);
    for (int c = 0; c < 3; c++) {
        const float* total = rooms.total(c);
        float* mean = rooms.mean(c);
        if (even && step == 2) {
            across(0, count, EACH(F, Long x) {
                const float* from = total + left[0] + 2 * x;
                store<F>(mean + x, (pick<F, 2>(from) + pick<F, 2>(from + 1)) * share);
            });
        } else if (even) {
            across(0, count, EACH(F, Long x) {
                store<F>(mean + x, load<F>(total + left[0] + x) * share);
            });
        } else {
            for (Long x = 0; x < count; x++) {
                float sum = 0.0f;
                for (int i = left[x]; i < right[x]; i++) sum += total[i];
                mean[x] = sum * (1.0f / float((bottom - top) * (right[x] - left[x])));
            }
        }
    }
}

// A row of all channels up to the frame's right edge, and of `light`.
FN void feature_row(const Looks& looks, Long here, const FeatureRooms& rooms, float* light,
                    const ChannelRows& to) {
    const Window& window = *looks.window;
    const Long y = Long(window.top) + here, first = Long(window.left), count = rooms.count;
    const Long h = Long(window.height), height = Long(window.out_height),
               above = Long(window.out_top);
    const Recall before = {looks.moved, looks.state,  looks.last_depth,
                           looks.keep,  *looks.params, *looks.window};
    locate_row(before, here, rooms);
    recall_row(before, rooms, light, to(PLANAR), to.step);
    mean_row(looks, y * height / h - above, ((y + 1) * height + h - 1) / h - above, rooms);
    const float *colour = looks.colour(y, first), *normal = looks.normal(y, first);
    const float *some = looks.diffuse(y, first), *others = looks.specular(y, first);
    const float *rough = looks.roughness(y, first), *depth = looks.depth(y, first),
                *motion = looks.moved(here);
    const float exposure = looks.params->exposure, scale = *looks.depth_scale.at;
    across(0, count, EACH(F, Long x) {
        const F valid = load<F>(rooms.valid() + x);
        F diffuse[3], specular[3];
        for (int c = 0; c < 3; c++) {
            diffuse[c] = pick<F, 3>(some + 3 * x + c);
            specular[c] = pick<F, 3>(others + 3 * x + c);
            store<F>(to(9 + c) + x, within<F>(diffuse[c], 0.0f, MOST_REFLECTANCE));
            store<F>(to(12 + c) + x, within<F>(specular[c], 0.0f, MOST_REFLECTANCE));
            store<F>(to(15 + c) + x, held<F>(pick<F, 3>(normal + 3 * x + c), -1.0f, 1.0f));
        }
        const Tint<F> tint = tinted<F>(diffuse[0] + specular[0], diffuse[1] + specular[1],
                                       diffuse[2] + specular[2]);
        const F factor[3] = {tint.red, tint.green, tint.blue};
        for (int c = 0; c < 3; c++) {
            const F now = within<F>(pick<F, 3>(colour + 3 * x + c), 0.0f, MAX_FLOAT);
            const F last = expm1_of<F>(within<F>(load<F>(rooms.mean(c) + x), 0.0f, MOST_LOG));
            store<F>(to(c) + x, log_encode<F>(now * exposure / factor[c]));
            store<F>(to(3 + c) + x, log_encode<F>(pick<F, 4>(light + 4 * x + c) * valid));
            store<F>(to(6 + c) + x, log_encode<F>(last * valid / factor[c]));
        }
        store<F>(to(18) + x, within<F>(load<F>(rough + x), 0.0f, 1.0f));
        const F near = within<F>(load<F>(depth + x), 0.0f, MAX_DEPTH);
        store<F>(to(19) + x, scale / (scale + near));
        store<F>(to(20) + x, depth_change<F>(load<F>(rooms.before() + x), near) * valid);
        store<F>(to(21) + x, valid);
        store<F>(to(22) + x, larger<F>(pick<F, 4>(light + 4 * x + 3), F(0.0f)) / MAX_COUNT);
        store<F>(to(23) + x, F(looks.params->jitter_x));
        store<F>(to(24) + x, F(looks.params->jitter_y));
        const F px = pick<F, 2>(motion + 2 * x), py = pick<F, 2>(motion + 2 * x + 1);
        store<F>(to(25) + x, log1p_of<F>(root_of(px * px + py * py)) * 0.25f);
        store<F>(to(26) + x, F(window.width / window.out_width));
    });
}

// Beyond the frame's right edge the network sees it as in a mirror.
FN void mirror_light(const Looks& looks, Long count, const NewPicture& past, float* light) {
    for (Long x = count; x < past.size[1]; x++) {
        __builtin_memcpy(light + 4 * x, light + 4 * Long(looks.seen_columns.at[x]),
                         4 * sizeof(float));
    }
}

static Status feature_rows(Long first, Long last, Looks looks, NewPicture past,
                           View<float, 4> features) {
    const Long count = looks.held(past), width = features.size[3];
    const FeatureRooms rooms(count, past.size[1], looks.warped.size[1]);
    if (!rooms) return NO_MEMORY;
    fill_edges(looks, rooms);
    for (Long row = first; row < last; row++) {
        float* light = row < past.size[0] ? past(row) : rooms.spare.at;
        const ChannelRows to = {features(0, 0, row), features.size[2] * width};
        feature_row(looks, Long(looks.seen_rows.at[row]), rooms, light, to);
        for (int c = 0; c < FEATURES; c++) {
            for (Long x = count; x < width; x++) to(c)[x] = to(c)[Long(looks.seen_columns.at[x])];
        }
        mirror_light(looks, count, past, light);
    }
    return DONE;
}
EXPORT_ALONE(denoise_features, feature_rows)

// The same in 8 bits, without a plane between, with a border or without.
static Status stored_feature_rows(Long first, Long last, Looks looks, CodingOf coding,
                                  NewPicture past, View<byte, 4> stored) {
    const Long count = looks.held(past), words = stored.size[3] / WORD,
               height = looks.seen_rows.size[0];
    const Long ring = (stored.size[1] - height) / 2;
    const FeatureRooms rooms(count, past.size[1], looks.warped.size[1]);
    const Room<float> planes(FEATURES * count);
    const Room<int> turned(words * count);
    if (!rooms || !planes || !turned) return NO_MEMORY;
    fill_edges(looks, rooms);
    for (Long y = first; y < last; y++) {
        const Long row = y - ring;
        int* pixels = (int*)stored(0, y);
        if (ring > 0) store_zeros(coding, stored.size[2], pixels);
        if (row < 0 || row >= height) continue;
        float* light = row < past.size[0] ? past(row) : rooms.spare.at;
        feature_row(looks, Long(looks.seen_rows.at[row]), rooms, light, {planes.at, count});
        int* inner = pixels + ring * words;
        store_codes(planes.at, count, FEATURES, coding, count, turned.at, inner);
        for (Long x = count; x < looks.seen_columns.size[0]; x++) {
            __builtin_memcpy(inner + words * x, inner + words * Long(looks.seen_columns.at[x]),
                             WORD * words);
        }
        mirror_light(looks, count, past, light);
    }
    return DONE;
}
EXPORT_ALONE(denoise_features_stored, stored_feature_rows)

// Planes in 8 bits.

static Status store_rows(Long first, Long last, View<const float, 4> planes, CodingOf coding,
                         View<byte, 4> stored) {
    const Long h = planes.size[2], w = planes.size[3], ring = (stored.size[1] - h) / 2;
    const Long words = stored.size[3] / WORD;
    const Room<int> turned(words * w);
    if (!turned) return NO_MEMORY;
    for (Long row = first; row < last; row++) {
        const Long y = row - ring;
        int* pixels = (int*)stored(0, row);
        if (ring > 0) store_zeros(coding, stored.size[2], pixels);
        if (y < 0 || y >= h) continue;
        store_codes(planes(0, 0, y), h * w, planes.size[1], coding, w, turned.at,
                    pixels + ring * words);
    }
    return DONE;
}
EXPORT_ALONE(denoise_store, store_rows)
EXPORT_ALONE(denoise_store_ringed, store_rows)

// Guides: the nearest pixel at every corner of what the network sees.

constexpr int CORNERS = 4;
constexpr int CHANNELS = 11;

template <int STEP>
FN void picked_planes(const float* row, const int* columns, float low, float high, Long count,
                      const ChannelRows& to, int channel) {
    for (int c = 0; c < STEP; c++) {
        across(0, count, EACH(F, Long x) {
            store<F>(to(channel + c) + x,
                     held<F>(gather<F, STEP>(row + c, columns + x), low, high));
        });
    }
}

static Status guide_rows(Long first, Long last, Picture diffuse, Picture specular, Picture normal,
                         Picture roughness, Picture depth, Places depth_scale, Given<Window> window,
                         Places seen_rows, Places seen_columns, View<float, 4> guides) {
    const Long h = Long(window->height), w = Long(window->width), count = guides.size[3];
    const Long top = Long(window->top), left = Long(window->left);
    const float scale = *depth_scale.at;
    const Room<int> room(2 * count);
    if (!room) return NO_MEMORY;
    for (Long x = 0; x < count; x++) {
        for (int side = 0; side < 2; side++) {
            const Long quarter = 4 * (left + Long(seen_columns.at[x])) + 1 + 2 * side;
            room.at[side * count + x] = int(quarter * depth.size[1] / (4 * w));
        }
    }
    for (Long row = first; row < last; row++) {
        const ChannelRows to = {guides(0, 0, row), guides.size[2] * count};
        for (int corner = 0; corner < CORNERS; corner++) {
            const Long y = (4 * (top + Long(seen_rows.at[row])) + 1 + 2 * (corner / 2))
                           * depth.size[0] / (4 * h);
            const int *at = room.at + corner % 2 * count, channel = CHANNELS * corner;
            picked_planes<3>(diffuse(y), at, 0.0f, 2.0f, count, to, channel);
            picked_planes<3>(specular(y), at, 0.0f, 2.0f, count, to, channel + 3);
            picked_planes<3>(normal(y), at, -1.0f, 1.0f, count, to, channel + 6);
            picked_planes<1>(roughness(y), at, 0.0f, 1.0f, count, to, channel + 9);
            float *near = to(channel + 10), *distances = near;
            picked_planes<1>(depth(y), at, 0.0f, MAX_DEPTH, count, to, channel + 10);
            for (Long x = 0; x < count; x++) near[x] = scale / (scale + distances[x]);
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_guides, guide_rows)

// Planes of what mirrors and glass show: albedo 0, normal 3.
static Status mirrored_rows(Long first, Long last, Picture albedo, Picture normal,
                            Given<Window> window, Places seen_rows, Places seen_columns,
                            View<float, 4> mirrored) {
    const Long count = mirrored.size[3], top = Long(window->top), left = Long(window->left);
    const Room<int> columns(count);
    if (!columns) return NO_MEMORY;
    for (Long x = 0; x < count; x++) columns.at[x] = int(left + Long(seen_columns.at[x]));
    for (Long row = first; row < last; row++) {
        const ChannelRows to = {mirrored(0, 0, row), mirrored.size[2] * count};
        const Long y = top + Long(seen_rows.at[row]);
        picked_planes<3>(albedo(y), columns.at, 0.0f, 1.0f, count, to, 0);
        picked_planes<3>(normal(y), columns.at, -1.0f, 1.0f, count, to, 3);
    }
    return DONE;
}
EXPORT_ALONE(denoise_mirrored, mirrored_rows)

// How far the guides' reflectance is trusted, in cells: fully where its mean over a render pixel is
// the reflectance at render size, less where that follows the detail, as with planes of one sample
// a pixel.

// Memory of a row: the guides' reflectance and the render's, the difference's mean and square in
// each render pixel, both summed over the rows of a cell; and the output pixels that each render
// pixel touches.
struct TrustRooms {
    Long count, out;
    Room<float> floats;
    Room<int> ints;

    TrustRooms(Long count, Long out)
        : count(count), out(out), floats(9 * count + 3 * out), ints(2 * count) {}
    explicit operator bool() const { return bool(floats) && bool(ints); }
    float* own(int c) const { return floats.at + c * count; }
    float* mean(int c) const { return floats.at + (3 + c) * count; }
    float* square() const { return floats.at + 6 * count; }
    float* apart() const { return floats.at + 7 * count; }
    float* spread() const { return floats.at + 8 * count; }
    float* guide(int c) const { return floats.at + 9 * count + c * out; }
    int* left() const { return ints.at; }
    int* touched() const { return ints.at + count; }
};

// Adds what a row of guides differs by in each render pixel.
FN void add_guides(const TrustRooms& rooms, int most) {
    across_once(0, rooms.count, EACH(F, Long x) {
        const F touched = number(load_int<F>(rooms.touched() + x)), zero = F(0.0f);
        F square = load<F>(rooms.square() + x);
        for (int c = 0; c < 3; c++) {
            const F own = load<F>(rooms.own(c) + x);
            F sum = load<F>(rooms.mean(c) + x);
            for (int k = 0; k < most; k++) {
                const F apart = gather<F>(rooms.guide(c) + k, rooms.left() + x) / own - 1.0f;
                const F counted = float(k) < touched ? apart : zero;
                sum += counted;
                square += counted * counted;
            }
            store<F>(rooms.mean(c) + x, sum);
        }
        store<F>(rooms.square() + x, square);
    });
}

// Adds a row of render pixels to its cells.
FN void add_judged(const TrustRooms& rooms, Long rows) {
    across_once(0, rooms.count, EACH(F, Long x) {
        const F share = 1.0f / (number(load_int<F>(rooms.touched() + x)) * float(rows));
        F apart = load<F>(rooms.apart() + x);
        for (int c = 0; c < 3; c++) {
            const F mean = load<F>(rooms.mean(c) + x) * share;
            apart += mean * mean;
            store<F>(rooms.mean(c) + x, F(0.0f));
        }
        store<F>(rooms.apart() + x, apart);
        store<F>(rooms.spread() + x,
                 load<F>(rooms.spread() + x) + load<F>(rooms.square() + x) * share);
        store<F>(rooms.square() + x, F(0.0f));
    });
}

static Status trust_rows(Long first, Long last, Picture diffuse, Picture specular,
                         Picture guide_diffuse, Picture guide_specular, Given<Window> window,
                         Places part_rows, Places part_columns, NewPicture trust) {
    const Long h = Long(window->height), w = Long(window->width);
    const Long height = guide_diffuse.size[0], width = guide_diffuse.size[1],
               left = Long(part_columns.at[0]);
    const Long rows = smaller<Long>(part_rows.size[0], h - Long(window->top));
    const Long columns = smaller<Long>(part_columns.size[0], w - Long(window->left));
    const Long begin = left * width / w, end = ((left + columns) * width + w - 1) / w;
    int most = 0;
    for (Long x = 0; x < columns; x++) {
        const Long from = (left + x) * width / w, to = ((left + x + 1) * width + w - 1) / w;
        most = larger<int>(most, int(to - from));
    }
    const TrustRooms rooms(columns, end - begin + most);
    if (!rooms) return NO_MEMORY;
    for (Long x = 0; x < columns; x++) {
        const Long from = (left + x) * width / w, to = ((left + x + 1) * width + w - 1) / w;
        rooms.left()[x] = int(from - begin);
        rooms.touched()[x] = int(to - from);
    }
    for (Long i = 0; i < 9 * columns + 3 * rooms.out; i++) rooms.floats.at[i] = 0.0f;
    for (Long row = first; row < last; row++) {
        const Long top = TRUST_CELL * row, bottom = smaller<Long>(top + TRUST_CELL, rows);
        for (Long x = 0; x < columns; x++) rooms.apart()[x] = rooms.spread()[x] = 0.0f;
        for (Long i = top; i < bottom; i++) {
            const Long y = Long(part_rows.at[i]), upper = y * height / h,
                       lower = ((y + 1) * height + h - 1) / h;
            fill_tints(diffuse(y, left), specular(y, left), columns, rooms.own(0), rooms.own(1),
                       rooms.own(2));
            for (Long v = upper; v < lower; v++) {
                fill_tints(guide_diffuse(v, begin), guide_specular(v, begin), end - begin,
                           rooms.guide(0), rooms.guide(1), rooms.guide(2));
                add_guides(rooms, most);
            }
            add_judged(rooms, lower - upper);
        }
        for (Long column = 0; column < trust.size[1]; column++) {
            const Long from = TRUST_CELL * column, to = smaller<Long>(from + TRUST_CELL, columns);
            const Long count = bottom > top && to > from ? (bottom - top) * (to - from) : 0;
            float apart = 0.0f, spread = 0.0f;
            for (Long x = from; x < to; x++) {
                apart += rooms.apart()[x];
                spread += rooms.spread()[x];
            }
            const float found = 1.0f - DOUBT * apart / (spread + 3.0f * FAINT * float(count));
            *trust(row, column) = count > 0 ? found : 1.0f;
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_trust, trust_rows)

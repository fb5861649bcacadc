// Rows of the output: lost detail restored, tiles assembled into the frame, and a blend by
// strength.
#include "output.h"
#include "../rows.h"

constexpr int TILE = 16;
constexpr int LAGS = 8;
constexpr int NEAR = 6;  // the first lags, which a pixel filter reaches
constexpr int COUNT = 0;
constexpr int POWER = 1;
constexpr int HELD_POWER = 2;
constexpr int FIRST = 3;
constexpr int SUMS = FIRST + LAGS;
// times a tile's root mean square, to which larger differences are held
constexpr float LIMIT = 3.0f;
constexpr float SPREAD_NOISE = 2.25f;
constexpr float TINY_POWER = 1e-12f;
struct Lag {
    int down, right;
};
constexpr Lag LAG[LAGS] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}, {0, 2}, {2, 0}, {0, 4}, {4, 0}};

// Detail

// What was removed from up to TILE rows of a picture.
struct Removed {
    const float* at;
    Long rows, width;
};

FN void fill_removed(const Picture& colour, const Picture& denoised, Long top, float exposure,
                     const Removed& removed, float* out) {
    for (Long y = 0; y < removed.rows; y++) {
        const float *noisy = colour(top + y), *clean = denoised(top + y);
        across(0, removed.width, EACH(F, Long x) {
            const auto luminance = PIXELS(const float* row) {
                const float* from = row + 3 * x;
                return luminance_of<F>(pick<F, 3>(from), pick<F, 3>(from + 1), pick<F, 3>(from + 2),
                                       exposure);
            };
            store<F>(out + y * removed.width + x,
                     seen_difference<F>(luminance(noisy), luminance(clean)));
        });
    }
}

// Products of pixels with their neighbours at a lag, summed down the rows.
FN void multiply_rows(const Removed& removed, Lag lag, float* total) {
    const Long first = lag.right < 0 ? -lag.right : 0;
    const Long last = larger<Long>(removed.width - (lag.right > 0 ? lag.right : 0), first);
    for (Long x = 0; x < first; x++) total[x] = 0.0f;
    for (Long x = last; x < removed.width; x++) total[x] = 0.0f;
    across(first, last, EACH(F, Long x) {
        F sum = F(0.0f);
        for (Long y = 0; y < removed.rows - lag.down; y++) {
            const float* own = removed.at + y * removed.width + x;
            sum += load<F>(own) * load<F>(own + lag.down * removed.width + lag.right);
        }
        store<F>(total + x, sum);
    });
}

// Sums of the columns of every tile, without those whose neighbour lies in another, per whole tile
// of pairs.
FN void sum_tiles(const float* total, Long width, Lag lag, Long tiles, float* sums) {
    const int apart = lag.right < 0 ? -lag.right : lag.right;
    const float scale = float(double(TILE * TILE) / double((TILE - lag.down) * (TILE - apart)));
    for (Long column = 0; column < tiles; column++) {
        const Long left = column * TILE + (lag.right < 0 ? apart : 0);
        const Long right = smaller<Long>(column * TILE + TILE - (lag.right > 0 ? apart : 0), width);
        float found = 0.0f;
        AS_IT_IS for (Long x = left; x < right; x++) found += total[x];
        sums[column * SUMS] = found * scale;
    }
}

// Whether any tile of a row is judged.
FN bool has_judged(const Picture& judged, Long row) {
    for (Long column = 0; column < judged.size[1]; column++) {
        if (*judged(row, column) > 0.0f) return true;
    }
    return false;
}

// Sums over the removed part of each tile; all are 0 where a tile is not judged.
static Status judge_rows(Long first, Long last, Picture colour, Picture denoised, Places params,
                         Picture judged, NewPicture sums) {
    const Long h = colour.size[0], w = colour.size[1], tiles = sums.size[1];
    const Room<float> room((TILE + 1) * w);
    if (!room) return NO_MEMORY;
    float* total = room.at + TILE * w;
    for (Long i = 0; i < (TILE + 1) * w; i++) room.at[i] = 0.0f;
    for (Long row = first; row < last; row++) {
        const Removed removed = {room.at, smaller<Long>(TILE, h - row * TILE), w};
        float* found = sums(row);
        if (!has_judged(judged, row)) {
            for (Long i = 0; i < tiles * SUMS; i++) found[i] = 0.0f;
            continue;
        }
        fill_removed(colour, denoised, row * TILE, params.at[0], removed, room.at);
        multiply_rows(removed, {0, 0}, total);
        sum_tiles(total, w, {0, 0}, tiles, found + POWER);
        for (Long column = 0; column < tiles; column++) {
            const Long left = column * TILE, right = smaller<Long>(left + TILE, w);
            float* own = found + column * SUMS;
            own[COUNT] = float(removed.rows * (right - left));
            const float limit = LIMIT * root_of(own[POWER] / own[COUNT]);
            for (Long y = 0; y < removed.rows; y++) {
                for (Long x = left; x < right; x++) {
                    room.at[y * w + x] = within<float>(room.at[y * w + x], -limit, limit);
                }
            }
        }
        multiply_rows(removed, {0, 0}, total);
        sum_tiles(total, w, {0, 0}, tiles, found + HELD_POWER);
        for (int k = 0; k < LAGS; k++) {
            multiply_rows(removed, LAG[k], total);
            sum_tiles(total, w, LAG[k], tiles, found + FIRST + k);
        }
        for (Long column = 0; column < tiles; column++) {
            if (*judged(row, column) > 0.0f) continue;
            for (int k = 0; k < SUMS; k++) found[column * SUMS + k] = 0.0f;
        }
    }
    return DONE;
}
EXPORT(denoise_judge, judge_rows)

// From `low` (0) to `high` (1).
struct Ramp {
    float low, high;
    float at(float value) const { return within<float>((value - low) / (high - low), 0.0f, 1.0f); }
};
constexpr Ramp STRUCTURE = {0.45f, 0.8f}, CLEAN = {0.35f, 0.55f};
// By the natural logarithm of 10^-5.6 and 10^-6.4; 10^-4.2 and 10^-3.5; 10^-1.4 and 10^-1.8.
constexpr double TEN = 2.302585092994046;
constexpr Ramp INVISIBLE = {float(5.6 * TEN), float(6.4 * TEN)},
               FILTERED = {float(-4.2 * TEN), float(-3.5 * TEN)};
constexpr Ramp QUIET = {float(1.4 * TEN), float(1.8 * TEN)};

// Power, noise of the structure and correlations around a tile; neighbours count by 1 2 1 both
// ways.
struct Around {
    float power, noise, correlation[LAGS];
};
FN Around gather_tile(const Picture& sums, Long y, Long x) {
    float spread[SUMS] = {};
    for (Long j = y - 1; j <= y + 1; j++) {
        for (Long i = x - 1; i <= x + 1; i++) {
            if (j < 0 || i < 0 || j >= sums.size[0] || i >= sums.size[1]) continue;
            const float weight = (j == y ? 2.0f : 1.0f) * (i == x ? 2.0f : 1.0f);
            for (int k = 0; k < SUMS; k++) spread[k] += weight * sums(j, i)[k];
        }
    }
    const float count = larger<float>(spread[COUNT], 1.0f);  // 0 if nothing around is judged
    Around found = {spread[POWER] / count, SPREAD_NOISE * LAGS / count, {}};
    for (int k = 0; k < LAGS; k++)
        found.correlation[k] = spread[FIRST + k] / (spread[HELD_POWER] + TINY_POWER);
    return found;
}

// Share of detail in the part removed around a tile.
FN float detail_of(const Around& tile, const float (&common)[NEAR]) {
    float structure = -tile.noise;
    for (int k = 0; k < LAGS; k++) {
        const float own = tile.correlation[k] - (k < NEAR ? common[k] : 0.0f);
        structure += own * own;
    }
    const float faint = INVISIBLE.at(-log_of<float>(tile.power + TINY_POWER));
    return larger<float>(STRUCTURE.at(root_of(larger<float>(structure, 0.0f))), faint);
}

// Share of each tile's difference to give back; every band of rows judges the whole frame for
// itself. `evidence` for detail is 1 when nothing is known. Below 1 it scales every tile's share;
// it always scales the share of detail by which the whole frame counts as clean. A tile's share is
// at least `known`.
static Status detail_rows(Long first, Long last, Picture sums, Places evidence, Picture known,
                          NewPicture detail) {
    const Long height = sums.size[0], width = sums.size[1];
    const Room<Around> tiles(height * width);
    const Room<float> weights(height * width), shares(height * width);
    if (!tiles || !weights || !shares) return NO_MEMORY;
    double total = TINY_POWER, all = 0.0, pixels = 0.0, correlations[NEAR] = {};
    for (Long i = 0; i < height * width; i++) {
        const float* own = sums(i / width, i % width);
        tiles.at[i] = gather_tile(sums, i / width, i % width);
        weights.at[i] = root_of(tiles.at[i].power) * own[COUNT];
        total += weights.at[i];
        all += own[POWER];
        pixels += own[COUNT];
        for (int k = 0; k < NEAR; k++)
            correlations[k] += weights.at[i] * tiles.at[i].correlation[k];
    }
    const float loud = log_of<float>(float(all / larger<double>(pixels, 1.0)) + TINY_POWER);
    const float quiet = QUIET.at(-loud) * smaller<float>(*evidence.at, 1.0f);
    float common[NEAR];
    for (int k = 0; k < NEAR; k++) {
        common[k] = FILTERED.at(loud) * larger<float>(float(correlations[k] / total), 0.0f);
    }
    double share = 0.0;
    for (Long i = 0; i < height * width; i++) {
        shares.at[i] = quiet * detail_of(tiles.at[i], common);
        share += shares.at[i] * weights.at[i];
    }
    const float clean = CLEAN.at(float(share / total) * *evidence.at);
    for (Long y = first; y < last; y++) {
        for (Long x = 0; x < width; x++) {
            const float own = shares.at[y * width + x];
            *detail(y, x) = larger<float>(own + (1.0f - own) * clean, *known(y, x));
        }
    }
    return DONE;
}
EXPORT(denoise_detail, detail_rows)

// Blends

// Shares of a row of pixels, made once for each and kept for each channel.
struct Shares {
    Long width, channels;
    Room<float> room;

    Shares(Long width, Long channels) : width(width), channels(channels), room(width * channels) {}
    explicit operator bool() const { return bool(room); }

    // make(F(), x) gives those from x on.
    template <class Make> FN_MEMBER void fill(const Make& make) const {
        across(0, width, EACH(F, Long x) {
            const F share = make(F(), x);
            if (channels == 1) {
                store<F>(room.at + x, share);
            } else if (channels == 3) {
                store_triples<F>(room.at + 3 * x, share, share, share);
            } else {
                float some[Of<F>::COUNT];
                store<F>(some, share);
                float* to = room.at + x * channels;
                for (int i = 0; i < Of<F>::COUNT; i++) {
                    for (Long c = 0; c < channels; c++) *to++ = some[i];
                }
            }
        });
    }

    // A row from one picture to another, whose light is held within what a picture may have.
    template <bool HELD> FN_MEMBER void blend(const float* from, const float* to,
                                              float* out) const {
        across(0, width * channels, EACH(F, Long i) {
            const F end = load<F>(to + i), held = HELD ? within<F>(end, 0.0f, MAX_FLOAT) : end;
            store<F>(out + i, blended_by<F>(load<F>(from + i), held, load<F>(room.at + i)));
        });
    }
};

// The tile before a pixel, the one after it, and how far the pixel lies between their centres.
struct Tiles {
    int before, after;
    float share;
};
FN Tiles tiles_at(Long position, Long count) {
    const float at = within<float>((float(position) + 0.5f) / TILE - 0.5f, 0.0f, float(count - 1));
    return {int(at), clip(Long(at) + 1, count), at - float(int(at))};
}

// From the result to the input by the share of detail, linear between the tiles' centres.
static Status restore_rows(Long first, Long last, Picture colour, Picture denoised, Picture detail,
                           NewPicture output) {
    const Long width = output.size[1], tiles = detail.size[1];
    const Shares shares(width, output.size[2]);
    const Room<float> across_by(width);
    const Room<int> before(width), after(width);
    if (!shares || !across_by || !before || !after) return NO_MEMORY;
    for (Long x = 0; x < width; x++) {
        const Tiles at = tiles_at(x, tiles);
        before.at[x] = at.before;
        after.at[x] = at.after;
        across_by.at[x] = at.share;
    }
    for (Long y = first; y < last; y++) {
        const Tiles at = tiles_at(y, detail.size[0]);
        const float *upper = detail(at.before), *lower = detail(at.after);
        shares.fill(EACH(F, Long x) {
            const F by = load<F>(across_by.at + x);
            const auto between = PIXELS(const float* row) {
                const F left = gather<F>(row, before.at + x);
                return left + (gather<F>(row, after.at + x) - left) * by;
            };
            const F above = between(upper);
            return above + (between(lower) - above) * at.share;
        });
        shares.blend<true>(denoised(y), colour(y), output(y));
    }
    return DONE;
}
EXPORT(denoise_restore, restore_rows)

// From the plain picture to the denoised one by strength times amount.
static Status strength_rows(Long first, Long last, Picture denoised, Picture plain,
                            Picture strength, Places amount, NewPicture output) {
    const float factor = within<float>(*amount.at, 0.0f, 1.0f);
    const Shares shares(output.size[1], output.size[2]);
    if (!shares) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        const float* from = strength(y);
        shares.fill(EACH(F, Long x) {
            return within<F>(load<F>(from + x), 0.0f, 1.0f) * factor;
        });
        shares.blend<false>(plain(y), denoised(y), output(y));
    }
    return DONE;
}
EXPORT_ALONE(denoise_strength, strength_rows)

// Tiles: of each its usable area, then the area where it comes before all others. The first of
// several is written last.
struct Area {
    float top, left, bottom, right;
};
struct TilePlace {
    float y, x;
    Area areas[2];
};
static void assemble_row(Long row, View<const float, 4> tiles, View<const float, 2> places,
                         Places frame_rows, Places frame_columns, NewPicture picture) {
    const Long columns = frame_columns.size[0], left = Long(frame_columns.at[0]),
               channels = tiles.size[3];
    const Long y = Long(frame_rows.at[row]);
    float* out = picture(row);
    for (Long i = 0; i < columns * channels; i++) out[i] = 0.0f;
    for (int kind = 0; kind < 2; kind++) {
        for (Long tile = tiles.size[0] - 1; tile >= 0; tile--) {
            const TilePlace& place = *(const TilePlace*)places(tile);
            const Area& area = place.areas[kind];
            const Long from = larger<Long>(Long(area.left), left);
            const Long to = smaller<Long>(Long(area.right), left + columns);
            if (float(y) < area.top || float(y) >= area.bottom || from >= to) continue;
            const float* source = tiles(tile, y - Long(place.y), from - Long(place.x));
            float* target = out + (from - left) * channels;
            across(0, (to - from) * channels, EACH(F, Long i) {
                store<F>(target + i, load<F>(source + i));
            });
        }
    }
}
EXPORT(denoise_assemble, assemble_row)

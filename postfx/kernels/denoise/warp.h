// Pictures warped by rows: what the output pixels of a row share, whatever picture is warped.
#pragma once
#include "history.h"
#include "window.h"
#include "../rows.h"

// Motion of a row of render pixels: ten numbers of each, a row apart.
struct MovedRow {
    float* at;
    Long apart;

    template <class F> FN_MEMBER void put(Long x, const Moved<F>& moved) const {
        store<F>(at + x, moved.left);
        store<F>(at + apart + x, moved.top);
        for (int i = 0; i < CUBIC; i++) store<F>(at + (2 + i) * apart + x, moved.across[i]);
        for (int i = 0; i < CUBIC; i++) store<F>(at + (6 + i) * apart + x, moved.down[i]);
    }
    FN_MEMBER Moved<float> get(Long x) const {
        Moved<float> moved;
        moved.left = at[x];
        moved.top = at[apart + x];
        for (int i = 0; i < CUBIC; i++) moved.across[i] = at[(2 + i) * apart + x];
        for (int i = 0; i < CUBIC; i++) moved.down[i] = at[(6 + i) * apart + x];
        return moved;
    }
};

// Whole numbers of a motion beyond any picture would not fit.
FN Long whole_of(float x) { return Long(within<float>(x, -1e8f, 1e8f)); }

// The column of a render pixel's output pixels if there are one or two, beside one another, with
// room behind them for eight numbers; else one that lies in no picture.
FN float first_of_pair(const float* columns, Long first, Long last, Long end) {
    const bool pair = last - first == 1
                      || (last - first == 2 && columns[first + 1] == columns[first] + 1);
    return pair && first + 3 <= end ? columns[first] : -1e9f;
}

// Output pixels of one render pixel, which share its motion: two at a time where no edge is near.
FN void warp_run(const Pixels& picture, const Moved<float>& moved, Long y, const float* columns,
                 Long first, Long last, float* out, Long end) {
    const Long top = y + whole_of(moved.top) - 1, shift = whole_of(moved.left) - 1;
    for (Long x = first; x < last; x += 2) {
        const Long left = Long(columns[x]) + shift;
        const bool beside = x + 1 < last && columns[x + 1] == columns[x] + 1;
        if (is_inside(picture, top, left) && (beside || x + 1 == last)) {
            const Eight found = warp_two(picture, moved, (top * picture.width + left) * 3);
            if (x + 3 <= end) {
                store(out + 3 * x, found);
            } else {
                for (int i = 0; i < 3 * (beside ? 2 : 1); i++) out[3 * x + i] = found[i];
            }
        } else {
            for (Long n = x; n < x + 2 && n < last; n++) {
                warp_edge(picture, moved, top, Long(columns[n]) + shift, out + 3 * n);
            }
        }
    }
}

// Rows at given output columns, of pictures of one size.
struct Warper {
    const float* columns;
    Long count, w, height, width;  // of output columns and render pixels; the pictures' size
    float across_scale, down_scale;
    Room<float> room;
    Room<int> begin, starts;

    // Where the output pixels of each render pixel begin, and after the last one's end.
    Warper(const Places& out_columns, const Window& window, Long w, Long height, Long width)
        : columns(out_columns.at), count(out_columns.size[0]), w(w), height(height), width(width),
          across_scale(float(double(width) / window.width)),
          down_scale(float(double(height) / window.height)), room(11 * w), begin(w + 1), starts(w) {
        if (!*this) return;
        for (Long x = 0; x <= w; x++) begin.at[x] = 0;
        for (Long x = 0; x < count; x++) {
            const Long at = centre_of(Long(columns[x]), Long(window.width), width).index;
            begin.at[clip(at - Long(window.left), w) + 1]++;
        }
        for (Long x = 0; x < w; x++) begin.at[x + 1] += begin.at[x];
        for (Long x = 0; x < w; x++) {
            column()[x] = first_of_pair(columns, begin.at[x], begin.at[x + 1], count);
        }
    }
    explicit operator bool() const { return bool(room) && bool(begin) && bool(starts); }

    MovedRow row() const { return {room.at, w}; }
    float* column() const { return room.at + 10 * w; }

    // Motion (w, 2) of a row of render pixels.
    FN_MEMBER void move(const float* motion) const {
        across(0, w, EACH(F, Long x) {
            row().put<F>(x, moved_pixel<F>(pick<F, 2>(motion + 2 * x) * across_scale,
                                           pick<F, 2>(motion + 2 * x + 1) * down_scale));
        });
    }

    // Where samples of the output's row y begin, with that motion.
    FN_MEMBER void find(Long y) const {
        across(0, w, EACH(F, Long x) {
            const F left = load<F>(column() + x) + load<F>(room.at + x) - 1.0f;
            const F top = load<F>(room.at + w + x) + (float(y) - 1.0f);
            store_int<F>(starts.at + x, start_of<F>({nullptr, height, width}, top, left));
        });
    }

    // The row y of a picture, warped.
    FN_MEMBER void warp(const float* at, Long y, float* out) const {
        const Pixels picture = {at, height, width};
        for (Long x = 0; x < w; x++) {
            const Long start = starts.at[x], to = begin.at[x];
            if (start >= 0) {
                const Eight found = warp_two(picture, row().get(x), start);
                store(out + 3 * to, found);
            } else {
                warp_run(picture, row().get(x), y, columns, to, begin.at[x + 1], out, count);
            }
        }
    }
};

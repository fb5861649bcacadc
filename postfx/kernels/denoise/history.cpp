// Rows of the reprojected history.
#include "history.h"
#include "window.h"
#include "../rows.h"

typedef View<const float, 1> Places;
typedef View<const float, 3> Picture;

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

// The column of a render pixel's output pixels if there are one or two, beside one another, with room
// behind them for eight numbers; else one that lies in no picture.
FN float first_of_pair(const float* columns, Long first, Long last, Long end) {
    const bool pair = last - first == 1 || (last - first == 2 && columns[first + 1] == columns[first] + 1);
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
                __builtin_memcpy(out + 3 * x, &found, sizeof found);
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

static Status history_rows(Long first, Long last, Picture history, Picture moved, Given<Params> params,
                           Given<Window> window, Places out_rows, Places out_columns,
                           View<float, 3> warped) {
    const Pixels picture = {history.at, history.size[0], history.size[1]};
    const Long w = moved.size[1], width = out_columns.size[0];
    const float across_scale = float(double(picture.width) / window->width);
    const float down_scale = float(double(picture.height) / window->height);
    const Room<float> room(11 * w);
    const Room<int> begin(w + 1), starts(w);
    if (!room || !begin || !starts) return NO_MEMORY;
    const MovedRow row = {room.at, w};
    float* column = room.at + 10 * w;
    // Where the output pixels of each render pixel begin, and after the last one's end.
    for (Long x = 0; x <= w; x++) begin.at[x] = 0;
    for (Long x = 0; x < width; x++) {
        const Long at = centre_of(Long(out_columns.at[x]), Long(window->width), picture.width).index;
        begin.at[clip(at - Long(window->left), w) + 1]++;
    }
    for (Long x = 0; x < w; x++) begin.at[x + 1] += begin.at[x];
    for (Long x = 0; x < w; x++) {
        column[x] = first_of_pair(out_columns.at, begin.at[x], begin.at[x + 1], width);
    }
    Long known = -1;
    for (Long n = first; n < last; n++) {
        const Long y = Long(out_rows.at[n]);
        const Long at = centre_of(y, Long(window->height), picture.height).index - Long(window->top);
        const Long iy = clip(at, moved.size[0]);
        if (known != iy) {
            known = iy;
            const float* from = moved(iy);
            across(0, w, PIXELS(auto one, Long x) {
                typedef decltype(one) F;
                row.put<F>(x, moved_pixel<F>(pick<F, 2>(from + 2 * x) * across_scale,
                                             pick<F, 2>(from + 2 * x + 1) * down_scale));
            });
        }
        float* out = warped(n);
        across(0, w, PIXELS(auto one, Long x) {
            typedef decltype(one) F;
            const F left = load<F>(column + x) + load<F>(row.at + x) - 1.0f;
            const F top = load<F>(row.at + w + x) + (float(y) - 1.0f);
            store_int<F>(starts.at + x, start_of<F>(picture, top, left));
        });
        for (Long x = 0; x < w; x++) {
            const Long start = starts.at[x], to = begin.at[x];
            if (start >= 0) {
                const Eight found = warp_two(picture, row.get(x), start);
                __builtin_memcpy(out + 3 * to, &found, sizeof found);
            } else {
                warp_run(picture, row.get(x), y, out_columns.at, to, begin.at[x + 1], out, width);
            }
        }
        if (params->gain != 1.0f) {
            for (Long i = 0; i + WIDE <= 3 * width; i += WIDE) {
                store<Wide>(out + i, rescaled<Wide>(load<Wide>(out + i), params->gain));
            }
            for (Long i = 3 * width / WIDE * WIDE; i < 3 * width; i++) {
                out[i] = rescaled<float>(out[i], params->gain);
            }
        }
    }
    return DONE;
}
EXPORT(denoise_history, history_rows)

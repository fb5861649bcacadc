// Rows of the share of the history that pixels use, and of the history at another render size.
#include "denoise.h"
#include "../rows.h"

// Exposed light as a display shows it, 0 to 1.
template <class F> FN F shown(F light, float exposure) {
    const F held = smaller<F>(within<F>(light, 0.0f, MAX_FLOAT) * exposure, F(MAX_COLOUR));
    return root_of(held / (1.0f + held));
}

// The mask of what is in front of opaque things: the largest channel's difference of the two
// colours as seen, times the scale, at most 1; 0 below the threshold.
struct Difference {
    float exposure, scale, threshold;
};
static void reactive_row(Long y, Picture colour, Picture opaque, Given<Difference> difference,
                         NewPicture reactive) {
    const float *all = colour(y), *behind = opaque(y);
    float* out = reactive(y);
    across(0, reactive.size[1], EACH(F, Long x) {
        F most = F(0.0f);
        for (int c = 0; c < 3; c++) {
            const F with_all = shown<F>(pick<F, 3>(all + 3 * x + c), difference->exposure);
            const F without = shown<F>(pick<F, 3>(behind + 3 * x + c), difference->exposure);
            most = larger<F>(size_of<F>(with_all - without), most);
        }
        const F scaled = smaller<F>(most * difference->scale, F(1.0f));
        store<F>(out + x, most >= difference->threshold ? scaled : F(0.0f));
    });
}
EXPORT(denoise_reactive, reactive_row)

// The largest value in 3x3 pixels, within 0 and 1.
static Status spread_rows(Long first, Long last, Picture reactive, NewPicture next) {
    const Long h = reactive.size[0], w = reactive.size[1], line = w + 2;
    const Room<float> room(line);
    if (!room) return NO_MEMORY;
    room.at[0] = room.at[w + 1] = 0.0f;
    for (Long y = first; y < last; y++) {
        const Long above = y > 0 ? y - 1 : y, below = y + 1 < h ? y + 1 : y;
        const float *upper = reactive(above), *own = reactive(y), *lower = reactive(below);
        float* out = next(y);
        across(0, w, EACH(F, Long x) {
            F most = within<F>(load<F>(own + x), 0.0f, 1.0f);
            most = larger<F>(within<F>(load<F>(upper + x), 0.0f, 1.0f), most);
            store<F>(room.at + 1 + x, larger<F>(within<F>(load<F>(lower + x), 0.0f, 1.0f), most));
        });
        across(0, w, EACH(F, Long x) {
            const F beside = larger<F>(load<F>(room.at + x), load<F>(room.at + x + 2));
            store<F>(out + x, larger<F>(load<F>(room.at + x + 1), beside));
        });
    }
    return DONE;
}
EXPORT(denoise_spread, spread_rows)

// How much of the history each pixel of a part uses.
static Status keep_rows(Long first, Long last, Picture reactive, Picture last_reactive,
                        Picture moved, Places rows, Places columns, NewPicture keep) {
    const float bottom = float(reactive.size[0] - 1), right = float(reactive.size[1] - 1);
    const int w = int(reactive.size[1]);
    const Long width = keep.size[1];
    const Room<int> from(width), here(width);
    if (!from || !here) return NO_MEMORY;
    for (Long x = 0; x < width; x++) here.at[x] = int(columns.at[x]);
    for (Long row = first; row < last; row++) {
        const float *motion = moved(row), *own = reactive(Long(rows.at[row]));
        const float y = rows.at[row];
        float* out = keep(row);
        across(0, width, EACH(F, Long x) {
            const F px = nearest_of(load<F>(columns.at + x) + pick<F, 2>(motion + 2 * x));
            const F py = nearest_of(y + pick<F, 2>(motion + 2 * x + 1));
            store_int<F>(from.at + x, whole(within<F>(py, 0.0f, bottom)) * w
                                          + whole(within<F>(px, 0.0f, right)));
            const F now = within<F>(gather<F>(own, here.at + x), 0.0f, 1.0f);
            store<F>(out + x, 1.0f - larger<F>(gather<F>(last_reactive.at, from.at + x), now));
        });
    }
    return DONE;
}
EXPORT(denoise_keep, keep_rows)

// A state at another render size: bilinear, edge repeated, and depth of the nearest pixel. Pixels
// whose count is 0 are unknown and have no weight. Where they would have half of it, the result is
// unknown.
static void resize_row(Long y, Picture state, Picture last_depth, Places rows, Places columns,
                       NewPicture resized, NewPicture resized_depth) {
    const Long h = state.size[0], w = state.size[1];
    const float top = floor_of(rows.at[y]), ty = rows.at[y] - top;
    const float *upper = state(clip(Long(top), h)), *lower = state(clip(Long(top) + 1, h));
    const float* depths = last_depth(clip(Long(nearest_of(rows.at[y])), h));
    for (Long x = 0; x < resized.size[1]; x++) {
        const float left = floor_of(columns.at[x]), tx = columns.at[x] - left;
        const Long here = STATE * clip(Long(left), w), beside = STATE * clip(Long(left) + 1, w);
        const float* const from[4] = {upper + here, upper + beside, lower + here, lower + beside};
        float share[4] = {(1.0f - ty) * (1.0f - tx), (1.0f - ty) * tx, ty * (1.0f - tx), ty * tx};
        float total = 0.0f;
        for (int i = 0; i < 4; i++) {
            share[i] = from[i][3] > 0.0f ? share[i] : 0.0f;
            total += share[i];
        }
        const float scale = total > 0.5f ? 1.0f / total : 0.0f;
        Four light = 0.0f;
        Eight hidden = 0.0f;
        for (int i = 0; i < 4; i++) {
            light += share[i] * load<Four>(from[i]);
            hidden += share[i] * load<Eight>(from[i] + 4);
        }
        light *= scale;
        hidden *= scale;
        store(resized(y, x), light);
        store(resized(y, x) + 4, hidden);
        *resized_depth(y, x) = depths[clip(Long(nearest_of(columns.at[x])), w)];
    }
}
EXPORT(denoise_resize, resize_row)

// What was known of a row's pixels in the frame before: its state, bilinear, and the depth of the
// nearest one.
#pragma once
#include "history.h"
#include "window.h"
#include "../rows.h"

// Where a pixel was in the frame before, edges repeated: the first of four pixels, the shares of
// those right of it and below, and the nearest one.
template <class F> struct Located {
    typename Of<F>::Int x0, y0, x1, y1, near;
    F right, lower;
    F inside;  // 1 in the picture, else 0
};
template <class F> FN Located<F> locate(F px, F py, int h, int w) {
    typedef typename Of<F>::Int I;
    const F one = F(1.0f), zero = F(0.0f);
    Located<F> found;
    found.inside = px >= -0.5f ? one : zero;
    found.inside = px <= float(w) - 0.5f ? found.inside : zero;
    found.inside = py >= -0.5f ? found.inside : zero;
    found.inside = py <= float(h) - 0.5f ? found.inside : zero;
    const F last_x = F(float(w - 1)), last_y = F(float(h - 1));
    const F x = within<F>(px, 0.0f, float(w - 1)), y = within<F>(py, 0.0f, float(h - 1));
    found.near = whole(nearest_of(y)) * I(w) + whole(nearest_of(x));
    found.x0 = whole(x);
    found.y0 = whole(y);
    const F left = number(found.x0), upper = number(found.y0);
    found.right = x - left;
    found.lower = y - upper;
    found.x1 = whole(smaller<F>(left + 1.0f, last_x));
    found.y1 = whole(smaller<F>(upper + 1.0f, last_y));
    return found;
}

// Whether more than a trace of a pixel is missing in the history, by its neighbours' counts.
FN bool is_unknown(float a, float b, float c, float d, float tx, float ty) {
    if (smaller<float>(smaller<float>(a, b), smaller<float>(c, d)) > 0.0f) return false;
    const float left = 1.0f - tx, upper = 1.0f - ty;
    float lacking = a <= 0.0f ? left * upper : 0.0f;
    lacking += b <= 0.0f ? tx * upper : 0.0f;
    lacking += c <= 0.0f ? left * ty : 0.0f;
    lacking += d <= 0.0f ? tx * ty : 0.0f;
    return lacking > UNKNOWN;
}

// Planes of the frame before, and what leads there.
struct Recall {
    View<const float, 3> moved, state, last_depth, keep;
    Params params;
    Window window;
};

// Memory of a row: places in the history, its shares, depth and validity.
struct RecallRooms {
    Long count;
    Room<int> places;
    Room<float> known;

    explicit RecallRooms(Long count) : count(count), places(5 * count), known(5 * count) {}
    explicit operator bool() const { return bool(places) && bool(known); }
    int* place(int k) const { return places.at + k * count; }
    float* tx() const { return known.at; }
    float* ty() const { return known.at + count; }
    float* valid() const { return known.at + 2 * count; }
    float* share() const { return known.at + 3 * count; }
    float* before() const { return known.at + 4 * count; }
};

FN void locate_row(const Recall& from, Long here, const RecallRooms& rooms) {
    const int h = int(from.window.height), w = int(from.window.width);
    const float left = from.window.left, y = from.window.top + float(here);
    const float *motion = from.moved(here), *kept = from.keep(clip(here, from.keep.size[0]));
    for (Long x = 0; x < rooms.count; x++) rooms.share()[x] = kept[clip(x, from.keep.size[1])];
    across(0, rooms.count, EACH(F, Long x) {
        typedef typename Of<F>::Int I;
        const F px = ramp<F>(left + float(x), 1.0f) + pick<F, 2>(motion + 2 * x);
        const F py = y + pick<F, 2>(motion + 2 * x + 1);
        const Located<F> found = locate<F>(px, py, h, w);
        const I upper = found.y0 * I(w), lower = found.y1 * I(w);
        store_int<F>(rooms.place(0) + x, upper + found.x0);
        store_int<F>(rooms.place(1) + x, upper + found.x1);
        store_int<F>(rooms.place(2) + x, lower + found.x0);
        store_int<F>(rooms.place(3) + x, lower + found.x1);
        store_int<F>(rooms.place(4) + x, found.near);
        store<F>(rooms.tx() + x, found.right);
        store<F>(rooms.ty() + x, found.lower);
        store<F>(rooms.valid() + x, found.inside * load<F>(rooms.share() + x));
    });
}

template <class Vector> FN Vector lerp(Vector a, Vector b, float share) {
    return a + (b - a) * share;
}

// The state of the frame before, bilinear: mean colour after an exposure change and count in
// `light` (w, 4), -1 where the history lacks a pixel; and the hidden state, in rows that are apart.
// The share that is used scales validity, count and hidden state.
FN void recall_row(const Recall& from, const RecallRooms& rooms, float* light,
                             float* hidden, Long apart) {
    const float gain = from.params.gain;
    for (Long x = 0; x < rooms.count; x++) {
        rooms.before()[x] = from.last_depth.at[rooms.place(4)[x]];
        const float tx = rooms.tx()[x], ty = rooms.ty()[x], share = rooms.share()[x];
        const float* const a = from.state.at + Long(rooms.place(0)[x]) * STATE;
        const float* const b = from.state.at + Long(rooms.place(1)[x]) * STATE;
        const float* const c = from.state.at + Long(rooms.place(2)[x]) * STATE;
        const float* const d = from.state.at + Long(rooms.place(3)[x]) * STATE;
        const bool inside = rooms.valid()[x] != 0.0f;
        const bool lacks = inside && is_unknown(a[3], b[3], c[3], d[3], tx, ty);
        Four found = {0.0f, 0.0f, 0.0f, lacks ? -1.0f : 0.0f};
        Eight rest = 0.0f;
        if (lacks || !inside) {
            rooms.valid()[x] = 0.0f;
        } else {
            found = lerp(lerp(load<Four>(a), load<Four>(b), tx),
                         lerp(load<Four>(c), load<Four>(d), tx), ty)
                  * Four{gain, gain, gain, share};
            const Eight upper = lerp(load<Eight>(a + 4), load<Eight>(b + 4), tx);
            const Eight lower = lerp(load<Eight>(c + 4), load<Eight>(d + 4), tx);
            rest = lerp(upper, lower, ty) * share;
        }
        store(light + 4 * x, found);
        UNROLL for (int i = 0; i < HIDDEN; i++) hidden[i * apart + x] = rest[i];
    }
}

// Pictures between their pixels, by the cubics of Mitchell and Netravali (1988, B = 1 - k,
// C = k / 2) within the range of the four pixels around a place: where sharp, k, is 1, Catmull and
// Rom's, which keep all detail; where it is 0, B-splines, which average over noise.
#pragma once
#include "lanes.h"

// Weights of four taps around places in [0, 1) after the second one: of its powers from 0 to 3.
constexpr float CUBIC[4][4] = {{0.0f, 1.0f, 0.0f, 0.0f},
                               {-0.5f, 0.0f, 0.5f, 0.0f},
                               {1.0f, -2.5f, 2.0f, -0.5f},
                               {-0.5f, 1.5f, -1.5f, 0.5f}};
constexpr float SPLINE[4][4] = {{1 / 6.0f, 2 / 3.0f, 1 / 6.0f, 0.0f},
                                {-0.5f, 0.0f, 0.5f, 0.0f},
                                {0.5f, -1.0f, 0.5f, 0.0f},
                                {-1 / 6.0f, 0.5f, -0.5f, 1 / 6.0f}};

template <class V> struct TimesFour;
template <> struct TimesFour<Four> {
    static FN_MEMBER Four from(const float (&at)[4]) { return {at[0], at[1], at[2], at[3]}; }
};
template <> struct TimesFour<Sixteen> {
    static FN_MEMBER Sixteen from(const float (&at)[4]) {
        const Four four = TimesFour<Four>::from(at);
        return __builtin_shufflevector(four, four, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3);
    }
};

// Weights of taps, four for each of the places of V.
template <class V> FN V weights_at(V t, float sharp) {
    FUSED;
    V power[4];
    UNROLL for (int k = 0; k < 4; k++) {
        const V soft = TimesFour<V>::from(SPLINE[k]), cubic = TimesFour<V>::from(CUBIC[k]);
        power[k] = soft + (cubic - soft) * sharp;
    }
    return ((power[3] * t + power[2]) * t + power[1]) * t + power[0];
}

struct Colour {
    float r, g, b;
    FN_MEMBER float sum() const { return r + g + b; }
};

// Weighted sum of 4x4 pixels of three numbers, within the range of the middle four. Reads a third
// of a pixel on.
FN Four pixel_of(Sixteen row, int pixel) {
    switch (pixel) {
        case 0: return __builtin_shufflevector(row, row, 0, 1, 2, 3);
        case 1: return __builtin_shufflevector(row, row, 3, 4, 5, 6);
        case 2: return __builtin_shufflevector(row, row, 6, 7, 8, 9);
        default: return __builtin_shufflevector(row, row, 9, 10, 11, 12);
    }
}
FN Colour weigh_taps(const float* at, Long stride, Four down, Four across) {
    FUSED;
    const Sixteen a = load<Sixteen>(at), b = load<Sixteen>(at + stride);
    const Sixteen c = load<Sixteen>(at + 2 * stride), d = load<Sixteen>(at + 3 * stride);
    const Sixteen column = a * down[0] + b * down[1] + c * down[2] + d * down[3];
    Four value = pixel_of(column, 0) * across[0] + pixel_of(column, 1) * across[1]
               + pixel_of(column, 2) * across[2] + pixel_of(column, 3) * across[3];
    const Four p = pixel_of(b, 1), q = pixel_of(b, 2), r = pixel_of(c, 1), s = pixel_of(c, 2);
    const Four low = least_of<Four>(least_of<Four>(p, q), least_of<Four>(r, s));
    const Four high = most_of<Four>(most_of<Four>(p, q), most_of<Four>(r, s));
    value = least_of<Four>(most_of<Four>(value, low), high);
    return {value[0], value[1], value[2]};
}

// The pixel before a place, which is held in the picture, and how far after it the place lies.
struct Corner {
    Long j, i;
    float down, across;
};
FN Corner corner_of(double y, double x, Long h, Long w) {
    const double v = smaller<double>(double(h - 1), larger<double>(0.0, y));
    const double u = smaller<double>(double(w - 1), larger<double>(0.0, x));
    const Long j = Long(v), i = Long(u);
    return {j, i, float(v - double(j)), float(u - double(i))};
}

// One channel at a place after a pixel: likewise, anywhere in the picture.
FN float cubic_one(const Field& picture, const Corner& at, Four down, Four across, Long c) {
    const Long h = picture.size[0], w = picture.size[1];
    const Long first = larger<Long>(at.i - 1, 0), third = smaller<Long>(at.i + 1, w - 1);
    const Long fourth = smaller<Long>(at.i + 2, w - 1), low = smaller<Long>(at.j + 1, h - 1);
    float value = 0.0f;
    for (Long b = 0; b < 4; b++) {
        const Long row = clip(at.j - 1 + b, h);
        value += down[b] * (across[0] * picture(row, first)[c] + across[1] * picture(row, at.i)[c]
                            + across[2] * picture(row, third)[c]
                            + across[3] * picture(row, fourth)[c]);
    }
    const float p = picture(at.j, at.i)[c], q = picture(at.j, third)[c];
    const float r = picture(low, at.i)[c], s = picture(low, third)[c];
    const float least = smaller<float>(smaller<float>(s, r), smaller<float>(q, p));
    const float most = larger<float>(larger<float>(s, r), larger<float>(q, p));
    return smaller<float>(most, larger<float>(least, value));
}

// Three channels at a place.
static inline Colour colour_at(const Field& picture, double y, double x, float sharp) {
    const Long h = picture.size[0], w = picture.size[1];
    const Corner at = corner_of(y, x, h, w);
    const Four down = weights_at<Four>(Four(at.down), sharp);
    const Four across = weights_at<Four>(Four(at.across), sharp);
    if (1 <= at.j && at.j < h - 2 && 1 <= at.i && at.i < w - 4) {
        return weigh_taps(picture(at.j - 1, at.i - 1), 3 * w, down, across);
    }
    return {cubic_one(picture, at, down, across, 0), cubic_one(picture, at, down, across, 1),
            cubic_one(picture, at, down, across, 2)};
}

// Where a path of a pixel leads: pixels, across and down in both frames, those before the places
// and the nearest ones; and weights of taps, across and down in both. What waits for places is
// loaded in loops of its own, which overlap more.
struct Ends {
    int before[2], after[2], near_before[2], near_after[2];
};
struct Weights {
    Four across_before, down_before, across_after, down_after;
};
typedef int WholeFour __attribute__((ext_vector_type(4)));
FN void aim(const float* path, float y, float x, Four last, Ends& ends, Weights& weights) {
    const Four start = {x, y, x, y};
    const WideFour way = __builtin_convertvector(load<Four>(path), WideFour);
    const WideFour most = __builtin_convertvector(last, WideFour), none = 0.0;
    const auto held = PIXELS(Four from) {
        const WideFour place = __builtin_convertvector(from, WideFour) + way;
        const WideFour above = place > none ? place : none;
        return above < most ? above : most;
    };
    const WideFour place = held(start);
    const WholeFour corners = __builtin_convertvector(place, WholeFour);
    const WholeFour nearest = __builtin_convertvector(held(start + 0.5f), WholeFour);
    const Four rest =
        __builtin_convertvector(place - __builtin_convertvector(corners, WideFour), Four);
    __builtin_memcpy(ends.before, &corners, sizeof corners);
    __builtin_memcpy(ends.near_before, &nearest, sizeof nearest);
    const Sixteen places = __builtin_shufflevector(rest, rest, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2,
                                                   3, 3, 3, 3);
    store<Sixteen>((float*)&weights, weights_at<Sixteen>(places, path[6]));
}

// Whether all taps at both places lie in the picture.
FN bool has_taps(const Ends& at, Long h, Long w) {
    const int left = smaller<int>(at.before[0], at.after[0]);
    const int right = larger<int>(at.before[0], at.after[0]);
    const int top = smaller<int>(at.before[1], at.after[1]);
    const int low = larger<int>(at.before[1], at.after[1]);
    return top >= 1 && low < h - 2 && left >= 1 && right < w - 4;
}

// Pixels before and behind a network that sees each pixel of one scene alone: see scene.py.
#pragma once
#include "number.h"

constexpr int POINT = 9;
constexpr float FARTHEST_PLACE = 1.5f;
constexpr float LAMP_REFLECTANCE = 0.005f;
constexpr float REFLECTANCE_SHARE = 0.15f;
constexpr float REFLECTANCE_OFFSET = 0.01f;
constexpr float MOST_LIGHT_LOG = 20.0f;

// Axes and place in the world, tangents of half the field of view, and jitter in pixels.
struct SceneCamera {
    float left[3], up[3], forward[3], place[3], across, down, jitter_x, jitter_y;

    // Where the sample of a pixel is along an axis, in lengths of the axis at distance 1.
    template <class F> FN_MEMBER F at_column(F x, int width) const {
        return (1.0f - 2.0f * (x + 0.5f + jitter_x) / float(width)) * across;
    }
    FN_MEMBER float at_row(int y, int height) const {
        return (1.0f - 2.0f * (float(y) + 0.5f + jitter_y) / float(height)) * down;
    }
};

struct SceneBox {
    float middle[3], reach;
};

// What the network reads of a pixel.
template <class F> struct Point {
    F at[POINT];
};

template <class F>
FN Point<F> point_of(const SceneCamera& camera, const SceneBox& box, F column, float row, F depth,
                     const F (&normal)[3]) {
    F ray[3], square = F(0.0f), facing = F(0.0f);  // 1 long along the view axis
    UNROLL for (int c = 0; c < 3; c++) {
        ray[c] = column * camera.left[c] + (row * camera.up[c] + camera.forward[c]);
        square = square + ray[c] * ray[c];
        facing = facing + ray[c] * normal[c];
    }
    const F shorter = 1.0f / root_of(square);
    Point<F> found;
    UNROLL for (int c = 0; c < 3; c++) {
        const F place = camera.place[c] - box.middle[c] + depth * ray[c];
        found.at[c] = within<F>(place / box.reach, -FARTHEST_PLACE, FARTHEST_PLACE);
        found.at[3 + c] = normal[c];
        found.at[6 + c] = (ray[c] - 2.0f * facing * normal[c]) * shorter;
    }
    return found;
}

// Colour becomes what the network gave, but for lamps and misses; albedo is both together.
template <class F> FN void shade(const F (&values)[3], const F (&albedo)[3], F (&colour)[3]) {
    const F peak = larger<F>(larger<F>(albedo[0], albedo[1]), albedo[2]);
    UNROLL for (int c = 0; c < 3; c++) {
        const F light = expm1_of(within<F>(values[c], 0.0f, MOST_LIGHT_LOG));
        const F reflectance = larger<F>(albedo[c], REFLECTANCE_SHARE * peak) + REFLECTANCE_OFFSET;
        colour[c] = peak < LAMP_REFLECTANCE ? colour[c] : light * reflectance;
    }
}

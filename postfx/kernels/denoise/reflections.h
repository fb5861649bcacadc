// Surfaces that reflect, and the motion of what is seen in them. Sources are given in history.py.
#pragma once
#include "prepare.h"

constexpr float ROUGHEST = 0.3f;  // up to which a surface shows an image that is worth following
constexpr float STEP = 0.1f;      // most relative difference in depth of neighbours on one surface
constexpr float BEND = 0.9f;      // least cosine between their normals
// pixels, and share of the motion, by which the motion of a surface at rest
constexpr float STILL = 0.25f;
constexpr float PART = 0.05f;     // may differ from the camera's

struct Vector {
    float x, y, z;
};
FN Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
FN Vector operator*(Vector a, float by) { return {a.x * by, a.y * by, a.z * by}; }
FN float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Focal length now and then, jitter, the turn and shift from now to then, and the axes of the world
// now.
struct Camera {
    float focal_x, focal_y, then_x, then_y, jitter_x, jitter_y;
    Vector turn[3], shift, world[3];

    FN_MEMBER Vector to_world(Vector v) const {
        return {dot(v, {world[0].x, world[1].x, world[2].x}),
                dot(v, {world[0].y, world[1].y, world[2].y}),
                dot(v, {world[0].z, world[1].z, world[2].z})};
    }
    // Motion of a point at rest on a ray, at 1 / nearness along the view axis, and its z then over
    // that now.
    FN_MEMBER Vector motion(Vector ray, float nearness) const {
        const float x = ray.x * turn[0].x + ray.y * turn[1].x + turn[2].x + shift.x * nearness;
        const float y = ray.x * turn[0].y + ray.y * turn[1].y + turn[2].y + shift.y * nearness;
        const float z = ray.x * turn[0].z + ray.y * turn[1].z + turn[2].z + shift.z * nearness;
        const float ahead = larger<float>(z, NEAREST);
        return {x / ahead * then_x - ray.x * focal_x, y / ahead * then_y - ray.y * focal_y, z};
    }
};

// Whether a pixel with a hit shows an image: it is smooth, and reflects more than it scatters.
FN bool reflects(float hit_distance, float depth, float roughness, const float* diffuse,
                 const float* specular) {
    if (!(hit_distance > 0.0f && depth > 0.0f && depth < FARTHEST)) return false;
    float share = 0.0f;
    for (int c = 0; c < 3; c++) {
        share += within<float>(specular[c], 0.0f, 1.0f) - within<float>(diffuse[c], 0.0f, 1.0f);
    }
    return share > 0.0f && roughness <= ROUGHEST;
}

// Planes of a frame: picture(y, x) is where a pixel's numbers are.
template <class Picture> struct Surfaces {
    const Picture &depth, &normal, &hit_distance;
    const Camera& camera;
    int height, width;

    // Direction through a pixel's sample, 1 along the view axis.
    FN_MEMBER Vector ray(int y, int x) const {
        return {(float(x) + 0.5f + camera.jitter_x - 0.5f * float(width)) / camera.focal_x,
                (float(y) + 0.5f + camera.jitter_y - 0.5f * float(height)) / camera.focal_y,
                1.0f};
    }
    // The normal with length 1; zero if it has none.
    FN_MEMBER Vector unit(int y, int x) const {
        const float* n = normal(y, x);
        const Vector found = {n[0], n[1], n[2]};
        const float length = root_of(dot(found, found));
        return found * (length > 0.1f ? 1.0f / length : 0.0f);
    }
    // Mean of one over the hit distance, over the 3x3 pixels of about the same depth that have one;
    // -1 without any.
    FN_MEMBER float inverse_distance(int y, int x) const {
        const float z = *depth(y, x);
        float total = 0.0f;
        int count = 0;
        for (int j = larger<int>(0, y - 1); j < smaller<int>(height, y + 2); j++) {
            for (int i = larger<int>(0, x - 1); i < smaller<int>(width, x + 2); i++) {
                const float distance = *hit_distance(j, i);
                if (!(distance > 0.0f && size_of<float>(*depth(j, i) - z) <= STEP * z)) continue;
                total += 1.0f / larger<float>(distance, NEAREST);
                count++;
            }
        }
        return count ? total / float(count) : -1.0f;
    }
    // How much a surface bends outwards, at least 0, as a mean of both axes; -1 at its edges.
    FN_MEMBER float curvature(int y, int x) const {
        const float z = *depth(y, x);
        const Vector here = unit(y, x);
        float total = 0.0f;
        for (int axis = 0; axis < 2; axis++) {
            Vector place[2], facing[2];
            for (int side = 0; side < 2; side++) {
                const int step = 2 * side - 1;
                const int j = clip(y + step * (1 - axis), height), i = clip(x + step * axis, width);
                const float there = *depth(j, i);
                facing[side] = unit(j, i);
                if (!(size_of<float>(there - z) <= STEP * z && dot(facing[side], here) >= BEND))
                    return -1.0f;
                place[side] = ray(j, i) * there;
            }
            const Vector along = place[1] - place[0];
            const float turned = dot(camera.to_world(facing[1] - facing[0]), along);
            total += turned / larger<float>(dot(along, along), 1e-20f);
        }
        return larger<float>(0.5f * total, 0.0f);
    }
    // The motion (2,) of a pixel that reflects becomes that of what is seen there, if that can be
    // told.
    FN_MEMBER void follow(int y, int x, float roughness, float* motion) const {
        const float z = *depth(y, x);
        const Vector to = ray(y, x), still = camera.motion(to, 1.0f / z);
        const float across = size_of<float>(motion[0]), down = size_of<float>(motion[1]);
        const float most = STILL + PART * larger<float>(across, down);
        if (!(size_of<float>(still.x - motion[0]) <= most
              && size_of<float>(still.y - motion[1]) <= most))
            return;
        const float bend = curvature(y, x), mean = inverse_distance(y, x);
        if (bend < 0.0f || mean < 0.0f) return;
        const float smooth = 1.0f - within<float>(roughness, 0.0f, 1.0f);
        const float inverse = mean / (smooth * (root_of(smooth) + 1.0f - smooth)) + 2.0f * bend;
        const float stretched = inverse * root_of(to.x * to.x + to.y * to.y + 1.0f);
        const Vector moved = camera.motion(to, stretched / (1.0f + stretched * z));
        if (!(moved.z > 1e-3f)) return;
        motion[0] = moved.x;
        motion[1] = moved.y;
    }
};

// Ambient occlusion from normals and depth: directions, angles, and where surfaces lie. Products
// and sums are rounded apart, so that the same pixels are looked at on every processor.
#pragma once
#include "rows.h"
#pragma clang fp contract(off)

constexpr int RADIUS = 9;  // places in the camera's numbers
constexpr int TANGENTS = 10;
constexpr int SLICES = 4;
constexpr int STEPS = 8;
constexpr int WAYS = 8;
constexpr float REACHES[] = {0.04f, 0.1f, 0.2f, 0.4f, 0.65f, 1.0f};
constexpr float MOST_REACH = 0.5f;
constexpr float FAR = 1e5f;
constexpr float PI = 3.14159265f;
constexpr float QUARTER = 1.57079633f;
constexpr float LEAST = 1e-6f;  // lengths below count as this much

typedef View<const float, 3> Surfaces;
typedef View<const float, 1> Camera;

struct Vector {
    float x, y, z;
};
FN float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FN float length_of(Vector a) { return root_of(dot(a, a)); }
FN Vector less(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
FN Vector normal_at(const float* surface) { return {surface[0], surface[1], surface[2]}; }

// Directions, made when this is compiled: the series of cos(x) and sin(x), to the last bit of
// float.
struct Way {
    float c, s;
};
constexpr Way way_of(float turn) {
    const double x = turn;
    double term = 1.0, c = 0.0, s = 0.0;
    for (int n = 0; n < 40; n += 2) {
        c += n % 4 ? -term : term;
        term *= x / (n + 1);
        s += n % 4 ? -term : term;
        term *= x / (n + 2);
    }
    return {float(c), float(s)};
}
constexpr int PATTERN = 16;  // pixels of 4x4
struct Slices {
    Way at[SLICES][PATTERN];
    constexpr Slices() : at() {
        for (int k = 0; k < SLICES; k++) {
            for (int p = 0; p < PATTERN; p++) {
                at[k][p] = way_of((float(k) + float(p) / PATTERN) * PI / SLICES);
            }
        }
    }
};
struct Around {
    Way at[WAYS];
    constexpr Around() : at() {
        for (int k = 0; k < WAYS; k++) at[k] = way_of(2.0f * PI * float(k) / WAYS);
    }
};

// Polynomials of Cephes (Moshier), absolute errors below 3e-7: cos(x) for |x| <= 100, acos(x).
FN float cos_of(float x) {
    const float n = floor_of(x * 0.6366197723675814f + 0.5f);
    const float r = ((x - n * 1.5703125f) - n * 4.837512969970703e-4f) - n * 7.54978995489e-8f;
    const float z = r * r;
    const float p = (2.443315711809948e-5f * z - 1.388731625493765e-3f) * z + 4.166664568298827e-2f;
    const float q = (-1.9515295891e-4f * z + 8.3321608736e-3f) * z - 1.6666654611e-1f;
    const float c = p * z * z - 0.5f * z + 1.0f, s = q * z * r + r;
    const int quadrant = whole(n) & 3;
    const float size = quadrant & 1 ? s : c;
    return quadrant == 1 || quadrant == 2 ? -size : size;
}
FN float acos_of(float x) {
    const float a = size_of<float>(x);
    const bool beyond = a > 0.5f;
    const float z = beyond ? 0.5f * (1.0f - a) : a * a, y = beyond ? root_of(z) : a;
    float p = 4.2163199048e-2f * z + 2.4181311049e-2f;
    p = p * z + 4.5470025998e-2f;
    p = p * z + 7.4953002686e-2f;
    p = p * z + 1.6666752422e-1f;
    const float arc = p * z * y + y;
    if (beyond) return x > 0.0f ? 2.0f * arc : PI - 2.0f * arc;
    return x > 0.0f ? QUARTER - arc : QUARTER + arc;
}

// A picture of surfaces as the camera sees it.
struct Scene {
    Surfaces surface;
    Long h, w;
    float across, down;

    Scene(const Surfaces& surface, const Camera& camera)
        : surface(surface), h(surface.size[0]), w(surface.size[1]), across(camera.at[TANGENTS]),
          down(camera.at[TANGENTS + 1]) {}

    // A pixel's surface in camera space, in radii.
    FN_MEMBER Vector place(Long y, Long x, float z) const {
        return {((float(x) + 0.5f) / float(w) * 2.0f - 1.0f) * across * z,
                (1.0f - (float(y) + 0.5f) / float(h) * 2.0f) * down * z, -z};
    }
    // The radius on the screen at a depth, in pixels.
    FN_MEMBER float reach_at(float z) const {
        return smaller<float>(float(w) / (2.0f * across * z), MOST_REACH * float(h));
    }
    FN_MEMBER bool has(Long y, Long x) const { return 0 <= x && x < w && 0 <= y && y < h; }
};

// Motion, of smooth surfaces that of what they reflect: motion (h, w, 2), depth (h, w, 1), normal (h, w, 3),
// roughness (h, w, 1), diffuse_albedo and specular_albedo (h, w, 3), hit_distance (h, w, 1), camera (27,) ->
// reflected (h, w, 2). Sources are given in postfx/kernels/denoise/reflections.py.

enum { FOCAL = 0, FOCAL_THEN = 2, SHIFTED = 4, TURN = 6, SHIFT = 15, WORLD = 18 };

struct Vector {
    float x, y, z;
};

// Direction through a pixel's sample, 1 along the view axis.
__device__ inline Pair ray_of(const float* camera, int height, int width, int y, int x) {
    return {(float(x) + 0.5f + camera[SHIFTED] - 0.5f * float(width)) / camera[FOCAL],
            (float(y) + 0.5f + camera[SHIFTED + 1] - 0.5f * float(height)) / camera[FOCAL + 1]};
}

// Motion of a point at rest on a ray, at 1 / nearness along the view axis, and its z then over that now.
__device__ inline Vector motion_at(const float* camera, const Pair& ray, float nearness) {
    const float* turn = camera + TURN;
    const float* shift = camera + SHIFT;
    const float x = ray.x * turn[0] + ray.y * turn[3] + turn[6] + shift[0] * nearness;
    const float y = ray.x * turn[1] + ray.y * turn[4] + turn[7] + shift[1] * nearness;
    const float z = ray.x * turn[2] + ray.y * turn[5] + turn[8] + shift[2] * nearness, ahead = fmaxf(z, 1e-6f);
    return {x / ahead * camera[FOCAL_THEN] - ray.x * camera[FOCAL],
            y / ahead * camera[FOCAL_THEN + 1] - ray.y * camera[FOCAL + 1], z};
}

// A normal of length 1, zero where there is none.
__device__ inline Vector unit(const View& normal, size_t pixel) {
    const float* n = normal.at + 3 * pixel;
    const float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), scale = length > 0.1f ? 1.0f / length : 0.0f;
    return {n[0] * scale, n[1] * scale, n[2] * scale};
}

__device__ inline float dot(const Vector& a, const Vector& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

__device__ inline Vector minus(const Vector& a, const Vector& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}

// Mean of one over the hit distance, over the 3x3 pixels of about the same depth that have one; -1 without any.
__device__ inline float inverse_distance(const View& hit_distance, const View& depth, int y, int x) {
    const int h = depth.size[0], w = depth.size[1];
    const float z = depth.at[size_t(y) * w + x];
    float total = 0.0f;
    int count = 0;
    for (int j = max(0, y - 1); j < min(h, y + 2); j++)
        for (int i = max(0, x - 1); i < min(w, x + 2); i++) {
            const size_t pixel = size_t(j) * w + i;
            const float distance = hit_distance.at[pixel];
            if (!(distance > 0.0f && fabsf(depth.at[pixel] - z) <= 0.1f * z)) continue;
            total += 1.0f / fmaxf(distance, 1e-6f);
            count++;
        }
    return count ? total / float(count) : -1.0f;
}

// How much a surface bends outwards, at least 0; -1 at its edges.
__device__ inline float curvature(const View& normal, const View& depth, const float* camera, int y, int x) {
    const int h = depth.size[0], w = depth.size[1];
    const float z = depth.at[size_t(y) * w + x];
    const Vector here = unit(normal, size_t(y) * w + x);
    const float* world = camera + WORLD;
    float total = 0.0f;
    for (int axis = 0; axis < 2; axis++) {
        Vector place[2], facing[2];
        for (int side = 0; side < 2; side++) {
            const int step = 2 * side - 1, j = within(y + step * (1 - axis), h), i = within(x + step * axis, w);
            const size_t pixel = size_t(j) * w + i;
            const Vector n = unit(normal, pixel);
            const float there = depth.at[pixel];
            if (!(fabsf(there - z) <= 0.1f * z && dot(n, here) >= 0.9f)) return -1.0f;
            const Pair ray = ray_of(camera, h, w, j, i);
            place[side] = {ray.x * there, ray.y * there, there};
            facing[side] = {n.x * world[0] + n.y * world[3] + n.z * world[6],
                            n.x * world[1] + n.y * world[4] + n.z * world[7],
                            n.x * world[2] + n.y * world[5] + n.z * world[8]};
        }
        const Vector along = minus(place[1], place[0]);
        total += dot(minus(facing[1], facing[0]), along) / fmaxf(dot(along, along), 1e-20f);
    }
    return fmaxf(0.5f * total, 0.0f);
}

// Whether a pixel is smooth, and reflects more than it scatters.
__device__ inline bool reflects(const View& diffuse, const View& specular, const View& roughness, size_t pixel) {
    float share = 0.0f;
    for (int c = 0; c < 3; c++)
        share += clamped(specular.at[3 * pixel + c], 0.0f, 1.0f) - clamped(diffuse.at[3 * pixel + c], 0.0f, 1.0f);
    return share > 0.0f && roughness.at[pixel] <= 0.3f;
}

__device__ inline float plausible(float value) {
    return value > -1e5f && value < 1e5f ? value : 0.0f;
}

extern "C" __global__ void denoise_reflections(View motion, View depth, View normal, View roughness,
                                               View diffuse_albedo, View specular_albedo, View hit_distance,
                                               View camera, View reflected) {
    const int h = depth.size[0], w = depth.size[1];
    PIXEL(w, h);
    const size_t pixel = size_t(y) * w + x;
    const Pair stored = pair(motion, pixel), own = {plausible(stored.x), plausible(stored.y)};
    pair(reflected, pixel) = own;
    const float z = depth.at[pixel];
    if (!(hit_distance.at[pixel] > 0.0f && z > 0.0f && z < 1e9f) ||
        !reflects(diffuse_albedo, specular_albedo, roughness, pixel))
        return;
    const Pair ray = ray_of(camera.at, h, w, y, x);
    const Vector still = motion_at(camera.at, ray, 1.0f / z);
    const float most = 0.25f + 0.05f * fmaxf(fabsf(own.x), fabsf(own.y));
    if (!(fabsf(still.x - own.x) <= most && fabsf(still.y - own.y) <= most)) return;
    const float bend = curvature(normal, depth, camera.at, y, x), mean = inverse_distance(hit_distance, depth, y, x);
    if (bend < 0.0f || mean < 0.0f) return;
    const float smooth = 1.0f - clamped(roughness.at[pixel], 0.0f, 1.0f);
    const float inverse = mean / (smooth * (sqrtf(smooth) + 1.0f - smooth)) + 2.0f * bend;
    const float stretched = inverse * sqrtf(ray.x * ray.x + ray.y * ray.y + 1.0f);
    const Vector moved = motion_at(camera.at, ray, stretched / (1.0f + stretched * z));
    if (moved.z > 1e-3f) pair(reflected, pixel) = {moved.x, moved.y};
}

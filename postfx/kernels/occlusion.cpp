// Rows of ambient occlusion; `occlusion.py` says what each of them is.
#include "occlusion.h"

// Normals turned into camera space, of length 1, and depth in radii; pixels without a surface are
// empty.
static void surface_row(Long y, Surfaces normal, Surfaces depth, Camera camera,
                        View<float, 3> surface) {
    const float radius = camera.at[RADIUS];
    const float *normals = normal(y), *depths = depth(y);
    float* out = surface(y);
    across(0, surface.size[1], EACH(F, Long x) {
        const F a = pick<F, 3>(normals + 3 * x), b = pick<F, 3>(normals + 3 * x + 1);
        const F c = pick<F, 3>(normals + 3 * x + 2), z = load<F>(depths + x) / radius;
        const F length = root_of(a * a + b * b + c * c);
        const F none = 0.0f, one_length = length > 0.1f ? length : none;
        const F usual = one_length < 1e6f ? one_length : none;
        const F size = z > 0.0f ? usual : none, known = z < FAR ? size : none;
        F turned[3];
        for (int k = 0; k < 3; k++) {
            const float* to = camera.at + k;
            const F whole = a / length * to[0] + b / length * to[3] + c / length * to[6];
            turned[k] = known > 0.0f ? whole : none;
        }
        spread_four<4, F>(out + 4 * x, turned[0], turned[1], turned[2], known > 0.0f ? z : F(FAR));
    });
}
EXPORT(occlusion_surface, surface_row)

// One side of a slice through the view ray.
struct Side {
    float across, down;  // the way in pixels at the radius
    float low;           // cosine at the plane of the surface
};
struct Slice {
    Vector at, view, axis;
    float noise, fade, thin;
};

// Cosine of the angle from the view ray to the highest surface on a side, within the radius. Pixels
// do not lie on the slice, so their ways are projected along its axis.
FN float horizon_of(const Scene& scene, const Slice& slice, Long y, Long x, Side side) {
    float best = side.low;
    const float length = larger<float>(size_of<float>(side.across), size_of<float>(side.down));
    const float pixel = 1.0f / larger<float>(length, 1.0f);
    for (int step = 0; step < STEPS; step++) {
        const float even = (float(step) + slice.noise) / float(STEPS);
        const float share = larger<float>(even * even, pixel * (float(step) * 0.5f + 1.0f));
        const Long i = Long(floor_of(float(x) + 0.5f + side.across * share));
        const Long j = Long(floor_of(float(y) + 0.5f + side.down * share));
        if (!scene.has(j, i)) break;
        const float z = scene.surface(j, i)[3];
        if (z >= FAR) continue;
        const Vector way = less(scene.place(j, i, z), slice.at);
        const float distance = length_of(way), off = dot(way, slice.axis);
        if (distance < LEAST) continue;
        const float inside = root_of(larger<float>(distance * distance - off * off, 1e-12f));
        const float weight = within<float>((1.0f - distance) / (1.0f - slice.fade), 0.0f, 1.0f);
        const float cosine = side.low + weight * (dot(way, slice.view) / inside - side.low);
        const float behind = larger<float>(cosine, side.low) - best;
        best = cosine >= best ? cosine : best + slice.thin * weight * behind;
    }
    return best;
}

// Visible part of a slice from the view ray to a horizon, weighted by the cosine to the normal
// (eq. 7), which is given as an angle, its cosine and its sine.
FN float arc(float horizon, float normal, float cosine, float sine) {
    return (cosine + 2.0f * horizon * sine - cos_of(2.0f * horizon - normal)) / 4.0f;
}

// Visibility by the two horizons of each slice through the view ray.
FN float visible_at(const Scene& scene, Long y, Long x, float fade, float thin) {
    static constexpr Slices slices;
    const float z = scene.surface(y, x)[3];
    if (z >= FAR) return 1.0f;
    const Vector at = scene.place(y, x, z), normal = normal_at(scene.surface(y, x));
    const float length = length_of(at), reach = scene.reach_at(z);
    const Vector view = {-at.x / length, -at.y / length, z / length};
    float total = 0.0f, weights = 0.0f;
    for (int k = 0; k < SLICES; k++) {
        const Way way = slices.at[k][x % 4 * 4 + y % 4];
        const float noise = (float((x * 5 + y * 7 + k * 3) % 4) + 0.5f) / 4.0f;
        // the slice's axis is the direction on the screen times the view ray
        Vector axis = {way.s * view.z, -way.c * view.z, way.c * view.y - way.s * view.x};
        const float size = length_of(axis);
        axis = {axis.x / size, axis.y / size, axis.z / size};
        const float off = dot(normal, axis);
        const Vector within_slice = less(normal, {axis.x * off, axis.y * off, axis.z * off});
        const float shadow = larger<float>(length_of(within_slice), LEAST);
        const float along = way.c * view.x + way.s * view.y;
        const Vector beside = {way.c - along * view.x, way.s - along * view.y, -along * view.z};
        const float cosine = within<float>(dot(within_slice, view) / shadow, 0.0f, 1.0f);
        const float open = root_of((1.0f - cosine) * (1.0f + cosine));
        const bool turned = dot(beside, within_slice) > 0.0f;
        const float angle = turned ? acos_of(cosine) : -acos_of(cosine);
        const float sine = turned ? open : -open;
        const Slice slice = {at, view, axis, noise, fade, thin};
        const float c = way.c * reach, s = way.s * reach;
        const float first = horizon_of(scene, slice, y, x, {c, -s, -sine});
        const float last = horizon_of(scene, slice, y, x, {-c, s, sine});
        const float up = acos_of(within<float>(first, -1.0f, 1.0f));
        const float down = acos_of(within<float>(last, -1.0f, 1.0f));
        const float one = arc(smaller<float>(up, angle + QUARTER), angle, cosine, sine);
        const float other = arc(larger<float>(-down, angle - QUARTER), angle, cosine, sine);
        const float weight = 1.0f / larger<float>(dot(beside, beside), LEAST);
        total += weight * shadow * (one + other);  // even around the view ray
        weights += weight;
    }
    return within<float>(total / weights, 0.0f, 1.0f);
}

static void horizon_row(Long y, Surfaces surface, Camera camera, Camera settings,
                        View<float, 2> visible) {
    const Scene scene(surface, camera);
    for (Long x = 0; x < scene.w; x++) {
        *visible(y, x) = visible_at(scene, y, x, settings.at[0], settings.at[1]);
    }
}
EXPORT(occlusion_horizons, horizon_row)

// Mean of each pixel and its 5x5 neighbours on the same surface; the outermost ones count by half.
static void smooth_row(Long y, Surfaces surface, View<const float, 2> noisy,
                       View<float, 2> visible) {
    const Long h = surface.size[0], w = surface.size[1];
    for (Long x = 0; x < w; x++) {
        const float z = surface(y, x)[3];
        const Vector normal = normal_at(surface(y, x));
        float total = 0.0f, weights = 0.0f;
        for (Long j = larger<Long>(y - 2, 0); j < smaller<Long>(y + 3, h); j++) {
            for (Long i = larger<Long>(x - 2, 0); i < smaller<Long>(x + 3, w); i++) {
                const float row = j == y - 2 || j == y + 2 ? 0.5f : 1.0f;
                const float weight = i == x - 2 || i == x + 2 ? 0.5f * row : row;
                const float off = size_of<float>(surface(j, i)[3] - z);
                const float alike = dot(normal_at(surface(j, i)), normal);
                const bool same = off < 0.05f * z && alike > 0.9f;
                total += same ? weight * *noisy(j, i) : 0.0f;
                weights += same ? weight : 0.0f;
            }
        }
        const float mean = weights > 0.0f ? total / weights : *noisy(y, x);
        *visible(y, x) = z >= FAR ? 1.0f : mean;
    }
}
EXPORT(occlusion_smooth, smooth_row)

// What the network reads of each pixel.
FN void look_at(const Scene& scene, Long y, Long x, float raw, float smooth, float* row) {
    static constexpr Around around;
    const float z = scene.surface(y, x)[3];
    if (z >= FAR) return;
    const Vector normal = normal_at(scene.surface(y, x)), place = scene.place(y, x, z);
    const float flat = root_of(normal.x * normal.x + normal.y * normal.y);
    const bool leans = flat > 1e-3f;
    const float c = leans ? normal.x / flat : 1.0f, s = leans ? normal.y / flat : 0.0f;
    const float reach = scene.reach_at(z);
    for (int k = 0; k < WAYS; k++) {
        const Way way = around.at[k];
        const float across = way.c * c - way.s * s, up = way.c * s + way.s * c;
        for (const float share : REACHES) {
            const float far = larger<float>(share * reach, 1.0f);
            float* seen = row;
            row += 2;
            const Long i = Long(floor_of(float(x) + 0.5f + across * far));
            const Long j = Long(floor_of(float(y) + 0.5f - up * far));
            if (!scene.has(j, i) || !(scene.surface(j, i)[3] < FAR)) continue;
            const Vector to = less(scene.place(j, i, scene.surface(j, i)[3]), place);
            const float distance = larger<float>(length_of(to), LEAST);
            const float near = within<float>(1.25f - distance, 0.0f, 1.0f);
            seen[0] = dot(to, normal) / distance * near;
            seen[1] = near;
        }
    }
    row[0] = flat;
    row[1] = -dot(place, normal) / length_of(place);
    row[2] = 0.2f * log2_of<float>(larger<float>(reach, 1.0f)) - 0.5f;
    row[3] = raw;
    row[4] = smooth;
}

static void look_row(Long p, Surfaces surface, Camera camera, View<const float, 2> raw,
                     View<const float, 2> smooth, Camera first_row, View<float, 2> points) {
    const Scene scene(surface, camera);
    const Long y = Long(*first_row.at) + p / scene.w, x = p % scene.w;
    for (Long i = 0; i < points.size[1]; i++) points(p)[i] = 0.0f;
    look_at(scene, y, x, *raw(y, x), *smooth(y, x), points(p));
}
EXPORT(occlusion_looks, look_row)

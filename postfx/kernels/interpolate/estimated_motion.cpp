// What motion is estimated from: pictures of planes, how well a motion fits them, and the motion of
// a camera.
#include "between.h"

constexpr float BRIGHTEST = 1.5f;  // albedo beyond counts as this
constexpr float TURN[3] = {0.2f, 0.28f, 0.12f};  // weights of a normal's numbers
constexpr float LARGEST = 10.0f;  // what is larger is not finite
constexpr Long AROUND = 3;  // pixels over which misfits are taken, each way
constexpr float DEPTH_MISS = 1e10f;  // depth of what hits nothing
// depth of the point a frame ago: behind the camera, it leads far away
constexpr float NEAREST = 1e-3f;

// Means of step x step pixels of the root of the albedo and of a turn of the normal; a plane of 1x1
// is absent.
static void shade_row(Long row, Field albedo, Field normal, Places steps, NewPlane means) {
    const Long h = larger<Long>(albedo.size[0], normal.size[0]);
    const Long w = larger<Long>(albedo.size[1], normal.size[1]), step = Long(*steps.at);
    const bool has_albedo = albedo.size[0] == h && albedo.size[1] == w;
    const bool has_normal = normal.size[0] == h && normal.size[1] == w;
    const Long end = smaller<Long>((row + 1) * step, h);
    for (Long column = 0; column < means.size[1]; column++) {
        const Long right = smaller<Long>((column + 1) * step, w);
        float total = 0.0f;
        for (Long y = row * step; y < end; y++) {
            for (Long x = column * step; x < right; x++) {
                float value = 0.0f;
                if (has_albedo) {
                    const float* own = albedo(y, x);
                    const float grey = (own[0] + own[1] + own[2]) / 3.0f;
                    value += root_of(smaller<float>(BRIGHTEST, larger<float>(0.0f, grey)));
                }
                if (has_normal) {
                    const float* own = normal(y, x);
                    value += TURN[0] * own[0] + TURN[1] * own[1] + TURN[2] * own[2];
                }
                if (size_of<float>(value) < LARGEST) total += value;
            }
        }
        means(row)[column] = total / float((end - row * step) * (right - column * step));
    }
}
EXPORT(estimate_shade, shade_row)

// Means over 3x3 pixels, weighted 1 2 1 each way; edges are repeated.
static void smooth_row(Long y, Plane picture, NewPlane smoothed) {
    const Long h = picture.size[0], w = picture.size[1];
    const float *above = picture(larger<Long>(y - 1, 0)), *row = picture(y);
    const float* below = picture(smaller<Long>(y + 1, h - 1));
    for (Long x = 0; x < w; x++) {
        const Long left = larger<Long>(x - 1, 0), right = smaller<Long>(x + 1, w - 1);
        const float outer = above[left] + above[right] + below[left] + below[right];
        const float inner = above[x] + below[x] + row[left] + row[right];
        const double sum = outer + 2.0 * inner + 4.0 * row[x];
        smoothed(y)[x] = float(sum / 16.0);
    }
}
EXPORT(estimate_smooth, smooth_row)

// How far pixels are from where they were; 0 where that is out of the picture.
static void differ_row(Long y, Plane one, Plane other, Field motion, NewPlane apart) {
    const double bottom = double(one.size[0]) - 0.5, right = double(one.size[1]) - 0.5;
    for (Long x = 0; x < one.size[1]; x++) {
        const double u = double(x) + motion(y, x)[0], v = double(y) + motion(y, x)[1];
        const bool inside = u > -0.5 && u < right && v > -0.5 && v < bottom;
        apart(y)[x] = inside ? float(size_of(value_between(other, v, u) - one(y)[x])) : 0.0f;
    }
}
EXPORT(estimate_differ, differ_row)

// Means over 2 AROUND + 1 pixels of each row, which becomes a column.
static void average_row(Long y, Plane plane, NewPlane turned) {
    const Long w = plane.size[1];
    const float* row = plane(y);
    float total = 0.0f;
    Long count = 0;
    for (Long x = -AROUND; x < w; x++) {
        if (x + AROUND < w) {
            total += row[x + AROUND];
            count++;
        }
        if (x - AROUND > 0) {
            total -= row[x - AROUND - 1];
            count--;
        }
        if (x >= 0) turned(x)[y] = larger<float>(0.0f, total) / float(count);
    }
}
EXPORT(estimate_average, average_row)

// Values, and slopes to the right and down, at places between pixels (rows, then columns); NaN out
// of the picture.
static void sample_row(Long k, Plane picture, View<const double, 2> places, NewPlane found) {
    const double bottom = double(picture.size[0] - 2), right = double(picture.size[1] - 2);
    const double v = places(0)[k], u = places(1)[k];
    float* out = found(k);
    if (!(v >= 1.0 && v < bottom && u >= 1.0 && u < right)) {
        out[0] = __builtin_nanf("");
        out[1] = out[2] = 0.0f;
        return;
    }
    const float y = float(v), x = float(u);
    out[0] = float(value_between(picture, y, x));
    out[1] = float(value_between(picture, y, x + 0.5f) - value_between(picture, y, x - 0.5f));
    out[2] = float(value_between(picture, y + 0.5f, x) - value_between(picture, y - 0.5f, x));
}
EXPORT(estimate_sample, sample_row)

// The camera's motion, as a point (x, y, 1) at a depth z was at H (x, y, 1) + e / z, in pixels of
// a picture that has one for `step` x `step` of the depth; z in units of the median.
struct Camera {
    float h[8], e[3], median, step, jitter[2];
};
static void move_row(Long row, Given<Camera> camera, Field depth, NewField motion) {
    const Long height = depth.size[0], width = depth.size[1], step = Long(camera->step);
    const float *h = camera->h, *e = camera->e;
    const float pixel = float(double(step) / double(width));
    const float scale = float(double(width) / double(step));
    const float left = float((0.5 * double(step) - 0.5 * double(width)) / double(width));
    const float top = float((0.5 * double(step) - 0.5 * double(height)) / double(width));
    const Long at_row = smaller<Long>(row * step + step / 2, height - 1);
    const float y = float(row) * pixel + top;
    for (Long column = 0; column < motion.size[1]; column++) {
        const float z = *depth(at_row, smaller<Long>(column * step + step / 2, width - 1));
        const float near = z > 0.0f && z < DEPTH_MISS ? camera->median / z : 0.0f;
        const float x = float(column) * pixel + left;
        const float behind = h[6] * x + h[7] * y + 1.0f + e[2] * near;
        const float over = 1.0f / larger<float>(NEAREST, behind);
        const float u = (h[0] * x + h[1] * y + h[2] + e[0] * near) * over - x;
        const float v = (h[3] * x + h[4] * y + h[5] + e[1] * near) * over - y;
        motion(row, column)[0] = u * scale - camera->jitter[0];
        motion(row, column)[1] = v * scale - camera->jitter[1];
    }
}
EXPORT(estimate_move, move_row)

// The flow of things that move by themselves, in pixels of the frame; step, then jitter.
static void put_row(Long y, Field flow, View<const bool, 2> moves, Places numbers,
                    NewField motion) {
    const Long step = Long(numbers.at[0]);
    for (Long x = 0; x < motion.size[1]; x++) {
        if (!moves(y / step)[x / step]) continue;
        const float* found = flow(y / step, x / step);
        for (int c = 0; c < 2; c++) {
            motion(y, x)[c] = float(double(found[c]) * double(step) - numbers.at[1 + c]);
        }
    }
}
EXPORT(estimate_put, put_row)

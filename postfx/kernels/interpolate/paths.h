// Where the points of two frames are at a time between them: motion that is taken between pixels.
#pragma once
#include "lanes.h"

constexpr float FAR = 1e30f;  // stands for an unknown depth or a larger one
constexpr float ALIKE = 0.04f;  // relative difference in depth of paths that are one surface
constexpr float SEEN = 1.0f;  // pixels by which motion to the other frame and back may miss
constexpr float COVERS = 0.9f;  // share of a depth below which something else is in front
constexpr float SPRUNG = 0.5f;  // bend, in the motion's length, from which a path is a jump
constexpr float ROUND = 0.7f;  // relative difference of two bends up to which a path is a curve
constexpr float EXACT = 0.05f;  // pixels by which motion may differ before it matters
constexpr float ROUNDLY = 0.1f;  // share of the motion by which what turns evenly may miss
constexpr float LEAST_COSINE = 0.2f;  // of the angle by which a thing turns from frame to frame
constexpr float LOST = 1e4f;  // motion, in pixels, of a point that another frame does not show
constexpr float LEAST_AREA = 0.2f;  // of a pixel by its motion, for a step of Newton's method
constexpr float LEAST_TURNED = 0.5f;  // the same where a thing turns

FN float farther(float one, float other) {
    return larger<float>(size_of<float>(other), size_of<float>(one));
}

// Whether motion around a place changes from pixel to pixel by so much that it matters where it is
// taken.
FN bool is_sloping(const Field& motion, double v, double u) {
    const Long h = motion.size[0], w = motion.size[1];
    if (!(u >= 0.0 && v >= 0.0 && u < double(w - 1) && v < double(h - 1))) return false;
    const float *upper = motion(Long(v), Long(u)), *lower = upper + 2 * w;
    return farther(upper[0] - lower[2], upper[1] - lower[3]) > EXACT
        || farther(upper[2] - lower[0], upper[3] - lower[1]) > EXACT;
}

// Motion at a place between four pixels, whether it goes on evenly between them, and its slopes: of
// x and of y to the right, of x and of y down.
struct Sampled {
    bool is_even;
    float x, y, right, across, down, under;
};
FN Sampled sample_two(const Field& motion, double v, double u) {
    const Long h = motion.size[0], w = motion.size[1];
    if (!(u >= 0.0 && v >= 0.0 && u < double(w - 1) && v < double(h - 1))) return {};
    const Long j = Long(v), i = Long(u);
    const float y = float(v - double(j)), x = float(u - double(i));
    const float *upper = motion(j, i), *lower = upper + 2 * w;
    const float p = upper[0], q = upper[2], r = lower[0], s = lower[2];
    const float a = upper[1], b = upper[3], c = lower[1], d = lower[3];
    const float most_x = larger<float>(farther(r - p, s - q), farther(q - p, s - r));
    const float most_y = larger<float>(farther(c - a, d - b), farther(b - a, d - c));
    Sampled found;
    found.is_even = larger<float>(most_y, most_x) <= 1.0f;
    found.right = q - p + y * (s - r - q + p);
    found.across = b - a + y * (d - c - b + a);
    found.down = r - p + x * (s - r - q + p);
    found.under = c - a + x * (d - c - b + a);
    found.x = p + x * (q - p) + y * found.down;
    found.y = a + x * (b - a) + y * found.under;
    return found;
}

// Whether one of the four pixels around a place, where a motion led, shows something nearer that
// does not lead back.
struct Led {
    double v, u;
    float x, y, depth;
};
FN bool is_touched(const Field& back, const Field& depth, const Led& led) {
    const Long h = depth.size[0], w = depth.size[1];
    const Long j = floor_to_whole(led.v), i = floor_to_whole(led.u);
    const float before = COVERS * led.depth;
    for (Long corner = 0; corner < 4; corner++) {
        const Long b = j + corner / 2, a = i + corner % 2;
        if (b < 0 || b >= h || a < 0 || a >= w || !(*depth(b, a) < before)) continue;
        const float* own = back(b, a);
        const bool leads_back = size_of<float>(own[0] + led.x) <= SEEN
                             && size_of<float>(own[1] + led.y) <= SEEN;
        if (!leads_back) return true;
    }
    return false;
}

// How many times as far as a polynomial through four places what swings or turns leaves the chord:
// by the cosine of its angle from frame to frame.
FN double swing_of(double cosine) {
    const double held = smaller<double>(1.0, larger<double>(LEAST_COSINE, cosine));
    const double half = __builtin_sqrt(0.5 + 0.5 * held);
    return 2.0 / ((1.0 + half) * half);
}

// Motion from a point to the frame further back and to the one further ahead, and how many of the
// two are known.
struct Sides {
    int count;
    double back_x, back_y, on_x, on_y;

    FN_MEMBER bool has_back() const { return back_x > -LOST; }
    FN_MEMBER bool has_on() const { return on_x < LOST; }
};
// Of which one is given. Where it is what this motion becomes if all goes round one point, so is
// the other one.
FN Sides go_round(const Field& motion, Long y, Long x, const Sides& known) {
    const float mx = motion(y, x)[0], my = motion(y, x)[1];
    const Sampled near = sample_two(motion, double(y), double(x));
    const double a = 1.0 + near.right, d = 1.0 + near.under;
    const double area = a * d - near.down * near.across;
    if (!(near.is_even && area > LEAST_TURNED)) return known;
    const double px = a * mx + near.down * my, py = near.across * mx + d * my;
    const double qx = (near.down * my - d * mx) / area, qy = (near.across * mx - a * my) / area;
    const double off_x = known.has_back() ? known.back_x - px : known.on_x - qx;
    const double off_y = known.has_back() ? known.back_y - py : known.on_y - qy;
    const double miss = larger<double>(size_of(off_y), size_of(off_x));
    if (!(miss <= ROUNDLY * farther(mx, my))) return known;
    return {2, px, py, qx, qy};
}

// How far a path is from a line halfway, by motion on both sides; nothing where it is a jump.
FN WideTwo bend_of(float mx, float my, const Sides& sides) {
    double bx = 0.0, by = 0.0, ax = 0.0, ay = 0.0;
    if (sides.has_back()) {
        bx = sides.back_x - mx;
        by = sides.back_y - my;
    }
    if (sides.has_on()) {
        ax = sides.on_x + mx - bx;
        ay = sides.on_y + my - by;
        bx = bx + sides.on_x + mx;
        by = by + sides.on_y + my;
    }
    const double size = size_of(bx) + size_of(by), count = double(sides.count);
    const float length = mx * mx + my * my;
    // on both sides it bends the same way
    const bool is_round = sides.count == 2 && size_of(ax) + size_of(ay) <= ROUND * size;
    const float most = SPRUNG * (size_of<float>(mx) + size_of<float>(my));
    if (sides.count == 0 || !(is_round || size <= most * count)) return 0.0;
    double share = 0.5 / count;
    if (sides.count == 2 && length > 1.0f) {
        // x'' = -w w x: both neighbours' sum is 2 cos w times the motion
        share *= swing_of(1.0 - (ax * mx + ay * my) / (2.0 * length));
    }
    return {share * bx, share * by};
}

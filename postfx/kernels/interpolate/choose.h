// A path of a cell, and windows of two toned grey pictures that are compared along it.
#pragma once
#include "lanes.h"

constexpr int MARGIN = 8;  // pixels around a picture whose paths are compared: its edges, repeated
constexpr int ROWS = 6;  // rows of eight pixels that are compared
constexpr float OTHER = 0.3f;  // pixels by which paths must differ to be worth a comparison
constexpr float STILL = 0.01f;  // pixels below which a path stands still
constexpr float MOSTLY = 0.4f;  // share of detail from which what stands still is left as it is
constexpr float MOST_NOISE = 4.0f;  // square of a slope that noise makes, in squares of the noise
constexpr float COUNT = ROWS * 6.0f;  // of pixels of a window, by their weights
constexpr float SLOPES = (2 * ROWS - 1) * 6.0f;  // likewise of slopes

FN Eight taper() { return {0.25f, 0.75f, 1.0f, 1.0f, 1.0f, 1.0f, 0.75f, 0.25f}; }

// From a cell to its place in the frame before and in the one after, in pixels; and whether each of
// the two shows the point, 0 or 1.
struct Path {
    float ax, ay, bx, by, first, last;

    FN_MEMBER bool is_shown() const { return first + last >= 2.0f; }
    FN_MEMBER bool is_path() const { return ax == ax; }
    FN_MEMBER float longest() const {
        const float a = larger<float>(size_of<float>(ay), size_of<float>(ax));
        return larger<float>(larger<float>(size_of<float>(by), size_of<float>(bx)), a);
    }
    FN_MEMBER bool is_still() const { return longest() < STILL; }
};
FN Path path_at(const float* cell) {
    return {cell[0], cell[1], cell[2], cell[3], cell[4], cell[5]};
}
FN bool differ(const Path& one, const Path& other) {
    return size_of<float>(one.ax - other.ax) > OTHER || size_of<float>(one.ay - other.ay) > OTHER
        || size_of<float>(one.bx - other.bx) > OTHER || size_of<float>(one.by - other.by) > OTHER;
}

// Toned pictures with margins, and where they are known.
struct Toned {
    Both<Plane> pictures;
    Both<Known> known;
    typedef Arrays<Both<Plane>, Both<Known>> Members;

    FN_MEMBER Long height() const { return known.before.size[0]; }
    FN_MEMBER Long width() const { return known.before.size[1]; }
    FN_MEMBER bool has(double y, double x, const Path& path) const {
        return is_within(known.before, y + path.ay, x + path.ax)
            && is_within(known.after, y + path.by, x + path.bx);
    }
    FN_MEMBER Window window(const Plane& picture, double y, double x) const {
        const double v = y - 0.5 * (ROWS - 1), u = x - 3.5;
        const Long j = floor_to_whole(v), i = floor_to_whole(u);
        return {picture(j + MARGIN) + i + MARGIN, picture.size[1], float(u - double(i)),
                float(v - double(j))};
    }
    FN_MEMBER Window before(double y, double x, const Path& path) const {
        return window(pictures.before, y + path.ay, x + path.ax);
    }
    FN_MEMBER Window after(double y, double x, const Path& path) const {
        return window(pictures.after, y + path.by, x + path.bx);
    }
    // A picture between four pixels.
    FN_MEMBER float value(const Plane& picture, double y, double x) const {
        const double down = smaller<double>(double(height()), larger<double>(-1.0, y));
        const double right = smaller<double>(double(width()), larger<double>(-1.0, x));
        const Long j = floor_to_whole(down), i = floor_to_whole(right);
        const float v = float(down - double(j)), u = float(right - double(i));
        const float *upper = picture(j + MARGIN) + i + MARGIN, *lower = upper + picture.size[1];
        const float above = upper[0] + u * (upper[1] - upper[0]);
        const float below = lower[0] + u * (lower[1] - lower[0]);
        return above + v * (below - above);
    }
    FN_MEMBER float value_before(double y, double x, const Path& path) const {
        return value(pictures.before, y + path.ay, x + path.ax);
    }
    FN_MEMBER float value_after(double y, double x, const Path& path) const {
        return value(pictures.after, y + path.by, x + path.bx);
    }
    // Difference of both pictures where a path leads to.
    FN_MEMBER float difference(double y, double x, const Path& path) const {
        return size_of<float>(value_before(y, x, path) - value_after(y, x, path));
    }
    // Difference of what two paths show, in the frame where it is less.
    FN_MEMBER float contrast(double y, double x, const Path& path, const Path& other) const {
        const float before = value_before(y, x, path) - value_before(y, x, other);
        const float after = value_after(y, x, path) - value_after(y, x, other);
        return smaller<float>(size_of<float>(after), size_of<float>(before));
    }
};

// Mean difference of two windows.
FN float window_difference(const Window& before, const Window& after) {
    const Lines<Eight, ROWS> one(before), other(after);
    Eight sum = magnitude(one.row[0] - other.row[0]);
    UNROLL for (int j = 1; j < ROWS; j++) sum += magnitude(one.row[j] - other.row[j]);
    return total(sum * taper()) / COUNT;
}

// Sums of squares of the slopes, across and down: of the difference of two windows, and of their
// sum.
struct Detail {
    float apart, common;
};
FN float sum_of_slopes(const Eight (&rows)[ROWS], const Eight (&beside)[ROWS]) {
    FUSED;
    const Eight first = rows[1] - rows[0], second = rows[2] - rows[1];
    Eight sum = first * first + second * second;
    UNROLL for (int j = 2; j + 1 < ROWS; j++) {
        const Eight slope = rows[j + 1] - rows[j];
        sum = sum + slope * slope;
    }
    UNROLL for (int j = 0; j < ROWS; j++) {
        const Eight slope = beside[j] - rows[j];
        sum = sum + slope * slope;
    }
    return total(sum * taper());
}
FN Detail window_detail(const Window& before, const Window& after) {
    Window next_before = before, next_after = after;
    next_before.at++;
    next_after.at++;
    const Lines<Eight, ROWS> one(before), other(after), right(next_before), beside(next_after);
    Eight apart[ROWS], apart_beside[ROWS], common[ROWS], common_beside[ROWS];
    UNROLL for (int j = 0; j < ROWS; j++) {
        apart[j] = one.row[j] - other.row[j];
        apart_beside[j] = right.row[j] - beside.row[j];
        common[j] = one.row[j] + other.row[j];
        common_beside[j] = right.row[j] + beside.row[j];
    }
    return {sum_of_slopes(apart, apart_beside), sum_of_slopes(common, common_beside)};
}

// Mean difference of both pictures around the places that a path leads to; -1 where one is not in
// its picture.
static inline float misfit(const Toned& of, double y, double x, const Path& path) {
    if (!of.has(y, x, path)) return -1.0f;
    return window_difference(of.before(y, x, path), of.after(y, x, path));
}

// Share of what both pictures show that is not noise (Wiener), 0 to 1. noise: misfit of paths that
// are right.
FN float share_of(const Detail& found, float noise) {
    const float apart = smaller<float>(MOST_NOISE * noise * noise * SLOPES, found.apart);
    const float share = larger<float>(0.0f, 1.0f - apart / found.common);
    return found.common > 0.0f ? share : 1.0f;
}

// The same around the places of a path. It is 1 where a path leads out of a picture or only one
// shows it, as nothing is known, and where most of what stands still is detail, as pixels meet
// pixels there.
static inline float sharpness(const Toned& of, double y, double x, const Path& path, float noise) {
    if (path.first + path.last < 2.0f || !of.has(y, x, path)) return 1.0f;
    const Detail found = window_detail(of.before(y, x, path), of.after(y, x, path));
    const float share = share_of(found, noise);
    return share > MOSTLY && path.is_still() ? 1.0f : share;
}

// Two paths' largest difference, of which the first is in cells of `scale` pixels.
FN float most_apart(const float* side, const float* own, float scale) {
    FUSED;
    return largest_of(magnitude(load<Four>(side) * scale - load<Four>(own)));
}

// The largest difference of a cell's path to those of two others.
FN float most_changed(const float* own, const float* beside, const float* below) {
    const Four here = load<Four>(own);
    return largest_of(most_of<Four>(magnitude(here - load<Four>(beside)),
                                    magnitude(here - load<Four>(below))));
}

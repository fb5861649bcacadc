// Patches of two pictures, which motion is estimated by: they are compared without their means.
#pragma once
#include "lanes.h"

constexpr int PATCH = 8;  // pixels along a patch's side
constexpr int STRIDE = 4;  // pixels from one patch to the next
constexpr int MARGIN = 10;  // pixels around a picture that is searched: its edges, repeated
constexpr int STEPS = 8;  // Gauss-Newton steps of a patch
constexpr float COUNT = PATCH * PATCH;

// Two pictures of the same size, with margins.
struct Searched {
    const float *one, *other;
    Long h, w;

    FN_MEMBER Long stride() const { return w + 2 * MARGIN; }
    FN_MEMBER const float* patch(Long top, Long left) const {
        return one + (top + MARGIN) * stride() + left + MARGIN;
    }
    // Places that are further out show the same, the edge.
    FN_MEMBER Window at(float y, float x) const {
        constexpr float FIRST = -PATCH - 1;
        y = smaller<float>(float(h), larger<float>(FIRST, y));
        x = smaller<float>(float(w), larger<float>(FIRST, x));
        const Long j = floor_to_whole(y), i = floor_to_whole(x);
        return {other + (j + MARGIN) * stride() + i + MARGIN, stride(), x - float(i), y - float(j)};
    }
};

// Sum of rows, number by number, and of their products; of the first two of those the FIRST is not
// rounded before it is added.
template <int ROWS> FN float sum_of(const Eight (&rows)[ROWS]) {
    Eight sum = rows[0];
    UNROLL for (int j = 1; j < ROWS; j++) sum += rows[j];
    return total(sum);
}
template <int FIRST = 0, int ROWS>
FN float sum_of_products(const Eight (&rows)[ROWS], const Eight (&others)[ROWS]) {
    FUSED;
    Eight sum = rows[FIRST] * others[FIRST] + rows[1 - FIRST] * others[1 - FIRST];
    UNROLL for (int j = 2; j < ROWS; j++) sum = sum + rows[j] * others[j];
    return total(sum);
}

// Differences of a window's rows to a patch.
struct Apart {
    Eight row[PATCH];

    FN_MEMBER Apart(const float* patch, const Window& window) {
        const Lines<Eight, PATCH> there(window);
        UNROLL for (int j = 0; j < PATCH; j++) {
            row[j] = there.row[j] - load<Eight>(patch + j * window.stride);
        }
    }
};

// Slopes of a patch's rows, to the right and down.
struct Slopes {
    Eight right[PATCH], down[PATCH];

    FN_MEMBER Slopes(const float* patch, Long stride) {
        UNROLL for (int j = 0; j < PATCH; j++) {
            const float* row = patch + j * stride;
            right[j] = (load<Eight>(row + 1) - load<Eight>(row - 1)) * 0.5f;
            down[j] = (load<Eight>(row + stride) - load<Eight>(row - stride)) * 0.5f;
        }
    }
};

// Mean square of a patch's difference to where it would have been, without the mean difference.
static inline float misfit(const Searched& of, Long top, Long left, double u, double v) {
    const Window there = of.at(float(double(top) + v), float(double(left) + u));
    const Apart apart(of.patch(top, left), there);
    const float mean = sum_of(apart.row) / COUNT;
    return sum_of_products(apart.row, apart.row) / COUNT - mean * mean;
}

// A motion, in pixels, and how well it fits.
struct Found {
    double u, v;
    float misfit;
};

// Gauss-Newton steps from a motion to one that fits better (inverse compositional; Baker and
// Matthews 2004).
static inline Found descend(const Searched& of, Long top, Long left, const Found& from) {
    constexpr float DAMPED = 1e-4f * COUNT, SMALL = 0.01f;  // pixels of a step that is the last
    const float* patch = of.patch(top, left);
    const Slopes slopes(patch, of.stride());
    const float sx = sum_of(slopes.right), sy = sum_of(slopes.down);
    const float xx = sum_of_products(slopes.right, slopes.right) - sx * sx / COUNT + DAMPED;
    const float xy = sum_of_products(slopes.right, slopes.down) - sx * sy / COUNT;
    const float yy = sum_of_products(slopes.down, slopes.down) - sy * sy / COUNT + DAMPED;
    const float area = xx * yy - xy * xy;
    double p = from.u, q = from.v;
    for (int step = 0; step < STEPS; step++) {
        const Window there = of.at(float(double(top) + q), float(double(left) + p));
        const Apart apart(patch, there);
        const float sum = sum_of(apart.row);
        const float gx = sum_of_products(slopes.right, apart.row) - sum * sx / COUNT;
        const float gy = sum_of_products<1>(slopes.down, apart.row) - sum * sy / COUNT;
        const float du = (yy * gx - xy * gy) / area, dv = (xx * gy - xy * gx) / area;
        p -= du;
        q -= dv;
        if (size_of(p - from.u) > PATCH || size_of(q - from.v) > PATCH) return from;
        if (size_of<float>(du) + size_of<float>(dv) < SMALL) break;
    }
    if (!(size_of(p - from.u) <= PATCH && size_of(q - from.v) <= PATCH)) return from;  // NaN
    const float fit = misfit(of, top, left, p, q);
    return fit < from.misfit ? Found{p, q, fit} : from;
}

// The centres before and after that of a pixel of a larger row, and how far it is from the first to
// the second.
FN Beside centre_between(Long position, Long count, Long size) {
    const double place = (double(position) + 0.5) * double(count) / double(size) - 0.5;
    const float at = smaller<float>(float(count - 1), larger<float>(0.0f, float(place)));
    const Long first = smaller<Long>(Long(at), larger<Long>(count - 2, 0));
    return {first, smaller<Long>(first + 1, count - 1), at - double(first)};
}

// Motion between four centres.
FN WideTwo motion_between(const Field& flow, const Beside& down, const Beside& across) {
    const double u = across.share, v = down.share;
    const float *upper = flow(down.first), *lower = flow(down.second);
    const Long left = 2 * across.first, right = 2 * across.second;
    const WideTwo above = two_at(upper + left) * (1.0 - u) + two_at(upper + right) * u;
    const WideTwo below = two_at(lower + left) * (1.0 - u) + two_at(lower + right) * u;
    return above * (1.0 - v) + below * v;
}

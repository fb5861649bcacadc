// Means of windows along the rows or the columns of pictures, of those of their pixels that are in
// the picture.
#pragma once
#include "rows.h"

struct WindowMeans {
    Long planes, height, width, radius;  // of the windows, 2 radius + 1 pixels long
    bool is_down;                        // whether windows lie along columns
    const float* from;
    float* to;

    Long rows() const { return planes * height; }
    Long room() const { return 2 * (width + 2 * radius); }

    // One row of all planes; `sums` has `room()` numbers.
    void make(Long row, float* sums) const {
        if (is_down) make_down(row, sums);
        else make_across(row, sums);
    }

private:
    void make_down(Long row, float* sums) const {
        const Long y = row % height;
        const Long first = larger<Long>(y - radius, 0) - y;
        const Long last = smaller(y + radius, height - 1) - y;
        const float* at = from + (row + first) * width;
        for (Long x = 0; x < width; x++) sums[x] = at[x];
        for (Long i = first + 1; i <= last; i++) {
            at += width;
            for (Long x = 0; x < width; x++) sums[x] += at[x];
        }
        divide(sums, 0, width, last - first + 1, to + row * width);
    }

    void make_across(Long row, float* sums) const {
        float* padded = sums + width;  // with zeros around the row
        fill(padded, 0, radius, 0.0f);
        __builtin_memcpy(padded + radius, from + row * width, sizeof(float) * width);
        fill(padded, radius + width, 2 * radius + width, 0.0f);
        fill(sums, 0, width, 0.0f);
        for (Long i = 0; i <= 2 * radius; i++)
            for (Long x = 0; x < width; x++) sums[x] += padded[x + i];
        float* out = to + row * width;
        const Long inside = smaller(radius, width), end = larger(width - radius, inside);
        for (Long x = 0; x < inside; x++) divide(sums, x, x + 1, count_at(x), out);
        divide(sums, inside, end, 2 * radius + 1, out);
        for (Long x = end; x < width; x++) divide(sums, x, x + 1, count_at(x), out);
    }

    Long count_at(Long x) const { return smaller(x, radius) + smaller(width - 1 - x, radius) + 1; }

    static void divide(const float* sums, Long first, Long end, Long count, float* out) {
        for (Long x = first; x < end; x++) out[x] = sums[x] / float(count);
    }
};

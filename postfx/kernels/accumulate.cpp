// Accumulation at output size along the motion, which a denoiser of single frames is compared with.
#include "rows.h"

#pragma clang fp contract(off)  // a place that is rounded otherwise may be another pixel

constexpr float LONGEST = 10.0f;  // frames that are averaged, at most
constexpr float DEPTH_STEP = 0.1f;  // relative difference in depth of one surface
constexpr float FACING = 0.8f;  // cosine of the angle between normals of one surface

// The render pixel that holds an output pixel's centre.
FN Long centre(Long position, Long size, Long out_size) {
    return (2 * position + 1) * size / (2 * out_size);
}

// Depth and normals of a frame, at its own size; pixels without a normal agree with any.
struct Surface {
    Picture depth, normal;
    typedef Arrays<Picture, Picture> Members;
};
struct Pixel {
    Long y, x;
};
FN bool same_surface(const Surface& now, const Pixel& here, const Surface& past,
                     const Pixel& there) {
    const float depth = *now.depth(here.y, here.x);
    const float off = size_of<float>(*past.depth(there.y, there.x) - depth);
    const float *one = now.normal(here.y, here.x), *other = past.normal(there.y, there.x);
    float dot = 0.0f, square = 0.0f, past_square = 0.0f;
    for (int c = 0; c < 3; c++) {
        dot += one[c] * other[c];
        square += one[c] * one[c];
        past_square += other[c] * other[c];
    }
    return off < DEPTH_STEP * depth
        && (dot > FACING * root_of(square * past_square) || square + past_square == 0.0f);
}

// Colour and the count of frames in it; the history is the last output.
static void accumulate_row(Long y, Picture current, Picture history, Picture motion, Surface now,
                           Surface past, View<float, 3> output) {
    const Long height = current.size[0], width = current.size[1];
    const Long h = motion.size[0], w = motion.size[1];
    const Long row = centre(y, h, height);
    for (Long x = 0; x < width; x++) {
        const Pixel here = {row, centre(x, w, width)};
        const float* moved = motion(here.y, here.x);
        const float v = float(y) + moved[1] * float(height) / float(h);
        const float u = float(x) + moved[0] * float(width) / float(w);
        const bool inside = v > -0.5f && double(v) < double(height) - 0.5 && u > -0.5f
                         && double(u) < double(width) - 0.5;
        float count = 1.0f;
        if (inside) {
            const Long near_y = Long(floor_of(v + 0.5f)), near_x = Long(floor_of(u + 0.5f));
            const Pixel there = {centre(near_y, h, height), centre(near_x, w, width)};
            if (same_surface(now, here, past, there)) {
                count = smaller<float>(LONGEST, history(near_y, near_x)[3] + 1.0f);
            }
        }
        const float* own = current(y, x);
        float* out = output(y, x);
        for (int c = 0; c < 3; c++) out[c] = own[c];
        out[3] = count;
        if (!(count > 1.0f)) continue;
        const float top = floor_of(v), left = floor_of(u), down = v - top, right = u - left;
        const Long upper = clip(Long(top), height), lower = clip(Long(top) + 1, height);
        const Long before = clip(Long(left), width), after = clip(Long(left) + 1, width);
        for (int c = 0; c < 3; c++) {
            const float above = history(upper, before)[c] * (1.0f - right)
                              + history(upper, after)[c] * right;
            const float below = history(lower, before)[c] * (1.0f - right)
                              + history(lower, after)[c] * right;
            const float mean = above * (1.0f - down) + below * down;
            out[c] = mean + (own[c] - mean) / count;
        }
    }
}
EXPORT(accumulate_past, accumulate_row)

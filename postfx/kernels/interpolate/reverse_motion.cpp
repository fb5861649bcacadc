// Motion that is turned round, and for how many frames each pixel has been visible.
#include "between.h"

constexpr float FAR = 1e30f;  // stands for an unknown depth or a larger one
constexpr float ALIKE = 0.03f;  // relative difference in depth of neighbours on one surface
constexpr float SAME = 0.05f;  // the same of one point between two frames

typedef View<const byte, 2> Lengths;

// Rows `first` to `last` - 1 and columns likewise, of the 3x3 pixels around one that lie in a
// plane.
struct Around {
    Long top, end, left, right;
    Around(Long y, Long x, Long h, Long w)
        : top(larger<Long>(0, y - 1)), end(smaller<Long>(h, y + 2)), left(larger<Long>(0, x - 1)),
          right(smaller<Long>(w, x + 2)) {}
};

// Writes each pixel's inverse motion to the place it came from; the nearest of several wins. Both
// frames may have other sizes.
static void splat_row(Long y, Field motion, Field depth, NewPlane nearest, NewField inverse) {
    const Long height = nearest.size[0], width = nearest.size[1], w = motion.size[1];
    const float tall = float(double(height) / double(motion.size[0]));
    const float wide = float(double(width) / double(w));
    for (Long x = 0; x < w; x++) {
        const float* moved = motion(y, x);
        const float right = moved[0] * wide, down = moved[1] * tall;
        const double u = (double(x) + 0.5) * wide + right;
        const double v = (double(y) + 0.5) * tall + down;
        const bool inside = u >= 0.0 && u < double(width) && v >= 0.0 && v < double(height);
        if (!inside) continue;  // NaN is not, either
        const Long i = Long(u), j = Long(v);
        const float z = smaller<float>(*depth(y, x), FAR);
        if (!(z < nearest(j)[i])) continue;
        nearest(j)[i] = z;
        inverse(j, i)[0] = -right;
        inverse(j, i)[1] = -down;
    }
}
EXPORT(reverse_splat, splat_row)

// Fills pixels where nothing arrived with the motion of the 3x3 neighbour of most similar depth,
// and marks them. Only such pixels change, so their order does not matter.
static void crack_row(Long y, Plane nearest, Field depth, NewField inverse, View<bool, 2> filled) {
    const Long h = nearest.size[0], w = nearest.size[1];
    for (Long x = 0; x < w; x++) {
        filled(y)[x] = false;
        if (nearest(y)[x] <= FAR) continue;
        const Around around(y, x, h, w);
        float best = ALIKE;
        for (Long j = around.top; j < around.end; j++) {
            for (Long i = around.left; i < around.right; i++) {
                const float unlike = size_of<float>(*depth(j, i) / *depth(y, x) - 1.0f);
                if (!(nearest(j)[i] <= FAR && unlike < best)) continue;
                best = unlike;
                filled(y)[x] = true;
                inverse(y, x)[0] = inverse(j, i)[0];
                inverse(y, x)[1] = inverse(j, i)[1];
            }
        }
    }
}
EXPORT(reverse_fill_cracks, crack_row)

// Each pixel's history length: one more than at the place its motion points to, at most `most`. A
// point is the same if a pixel in the 3x3 around that place has its depth.
static void history_row(Long y, Field motion, Field depth, Field before, Lengths known, Places most,
                        View<byte, 2> length) {
    const Long height = known.size[0], width = known.size[1], w = length.size[1];
    const float tall = float(double(height) / double(length.size[0]));
    const float wide = float(double(width) / double(w));
    const int longest = int(*most.at);
    for (Long x = 0; x < w; x++) {
        length(y)[x] = 1;
        const double u = (double(x) + 0.5 + motion(y, x)[0]) * wide;
        const double v = (double(y) + 0.5 + motion(y, x)[1]) * tall;
        const bool inside = u >= 0.0 && u < double(width) && v >= 0.0 && v < double(height);
        if (!inside) continue;
        const Long column = Long(u), row = Long(v);
        const Around around(row, column, height, width);
        bool is_same = false;
        for (Long j = around.top; j < around.end; j++) {
            for (Long i = around.left; i < around.right; i++) {
                const float unlike = size_of<float>(*before(j, i) / *depth(y, x) - 1.0f);
                is_same = is_same || unlike < SAME;
            }
        }
        if (is_same) length(y)[x] = byte(smaller<int>(known(row)[column] + 1, longest));
    }
}
EXPORT_ALONE(reverse_extend_history, history_row)

// The later frames' share of a result, back / (ahead + back), averaged over 3x3.
static void share_row(Long y, Lengths ahead, Lengths back, NewPlane share) {
    const Long h = share.size[0], w = share.size[1];
    for (Long x = 0; x < w; x++) {
        const Around around(y, x, h, w);
        float total = 0.0f;
        for (Long j = around.top; j < around.end; j++) {
            for (Long i = around.left; i < around.right; i++) {
                total += float(back(j)[i]) / float(ahead(j)[i] + back(j)[i]);
            }
        }
        const Long places = (around.end - around.top) * (around.right - around.left);
        share(y)[x] = float(double(total) / double(places));
    }
}
EXPORT_ALONE(reverse_share_by_length, share_row)

// Premultiplied RGBA: colour times a share, which is also its alpha. The share is interpolated
// between pixel centres, so that its coarser pixels are not visible.
static void premultiply_row(Long y, Plane share, Field colour, NewField later) {
    const Long h = share.size[0], w = share.size[1], width = later.size[1];
    const float tall = float(double(h) / double(later.size[0]));
    const float wide = float(double(w) / double(width));
    const double v = larger<double>(0.0, (double(y) + 0.5) * tall - 0.5);
    const Long upper = smaller<Long>(Long(v), h - 1), lower = smaller<Long>(upper + 1, h - 1);
    const double down = v - double(upper);
    for (Long x = 0; x < width; x++) {
        const double u = larger<double>(0.0, (double(x) + 0.5) * wide - 0.5);
        const Long left = smaller<Long>(Long(u), w - 1), right = smaller<Long>(left + 1, w - 1);
        const double along = u - double(left);
        const double above = share(upper)[left] * (1.0 - along) + share(upper)[right] * along;
        const double below = share(lower)[left] * (1.0 - along) + share(lower)[right] * along;
        const double weight = above * (1.0 - down) + below * down;
        float* out = later(y, x);
        for (int c = 0; c < 3; c++) out[c] = float(colour(y, x)[c] * weight);
        out[3] = float(weight);
    }
}
EXPORT_ALONE(reverse_premultiply, premultiply_row)

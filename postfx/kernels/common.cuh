// What the CUDA kernels of postfx share beside view.cuh: positions and small functions. Constants
// such as MAX_COLOUR come before: postfx/runtime/cuda.py prints them.

#include "number.cuh"
#include "denoise/light.h"

[[maybe_unused]] const float LARGEST_FLOAT = 3.402823466e38f;

struct Colour {
    float r, g, b;
};

FN Colour operator*(const Colour& light, float by) {
    return {light.r * by, light.g * by, light.b * by};
}

FN Colour operator*(const Colour& light, const Colour& by) {
    return {light.r * by.r, light.g * by.g, light.b * by.b};
}

FN void add(Colour& sum, const Colour& light, float weight) {
    sum = {sum.r + weight * light.r, sum.g + weight * light.g, sum.b + weight * light.b};
}

// A colour beside one another in memory, or a step apart, as in planes.
FN Colour three(const float* at, size_t step = 1) {
    return {at[0], at[step], at[2 * step]};
}

FN void put(float* to, const Colour& light, size_t step = 1) {
    to[0] = light.r;
    to[step] = light.g;
    to[2 * step] = light.b;
}

// Within [low, high], which holds 0 or lies above it; a NaN becomes the value nearest to 0.
FN float clamped(float value, float low, float high) {
    return fminf(fmaxf(low, value == value ? value : 0.0f), high);
}

// How much of the history a render pixel of the part uses; `keep` has one number for all of them,
// or one for each.
FN float share_of(const View& keep, int row, int column) {
    return keep.at[clip(row, keep.size[0]) * keep.size[1] + clip(column, keep.size[1])];
}

// Which part of the frame the kernels work on: first row and column at render size, the frame's
// size, and both at output size. A part may end beyond the frame.
struct Window {
    int top, left, h, w, out_top, out_left, height, width;
};

FN Window window_of(const View& view) {
    const float* at = view.at;
    return {int(at[TOP]), int(at[LEFT]), int(at[HEIGHT]), int(at[WIDTH]),
            int(at[OUT_TOP]), int(at[OUT_LEFT]), int(at[OUT_HEIGHT]), int(at[OUT_WIDTH])};
}

// Whether both sides are twice the render's.
FN bool is_doubled(const Window& part) {
    return part.width == 2 * part.w && part.height == 2 * part.h;
}

// The render pixel that holds an output pixel's centre; `offset` becomes the centre's offset from
// it in [-0.5, 0.5).
FN int centre(int position, int size, int out_size, float& offset) {
    const long long at = (2LL * position + 1) * size;  // in units of 1 / (2 out_size): exact
    const int index = int(at / (2LL * out_size));
    offset = float(double(at - index * (2LL * out_size)) / (2.0 * out_size) - 0.5);
    return index;
}

// How near a render pixel is to what is worked on, by cells (cells, cells), or by one number for
// all.
FN float nearness(const View& near, int y, int x) {
    return near.at[size_t(min(y / NEAR_CELL, near.size[0] - 1)) * near.size[1]
                   + min(x / NEAR_CELL, near.size[1] - 1)];
}

// Mean of alpha's samples (2 h, 2 w, 1) in a render pixel.
FN float pixel_mean(const View& samples, int at_y, int at_x, int w) {
    const float* const upper = samples.at + 4 * size_t(at_y) * w + 2 * at_x;
    return (upper[0] + upper[1] + upper[2 * w] + upper[2 * w + 1]) * 0.25f;
}

// Reflectance that colour is divided by at a pixel (y, x) of albedos (h, w, 3).
FN Colour demodulation(const View& diffuse, const View& specular, int y, int x) {
    const int at = 3 * (y * diffuse.size[1] + x);
    const float *const some = diffuse.at + at, *const others = specular.at + at;
    const Tint<float> found = tinted<float>(some[0] + others[0], some[1] + others[1],
                                            some[2] + others[2]);
    return {found.red, found.green, found.blue};
}

// A pixel's light without its reflectance `by`.
FN Light<float> light_without(const float* rgb, const Colour& by, float exposure) {
    return light_of<float>({rgb[0], rgb[1], rgb[2]}, {by.r, by.g, by.b}, exposure);
}

// The two of some cells along a side that a place lies between, which is held within them, and how
// far it is from the first to the second one.
struct Between {
    int first, second;
    float share;
};

FN Between between_cells(float place, int count) {
    const float at = fminf(fmaxf(place, 0.0f), float(count - 1));
    const int first = int(at);
    return {first, min(first + 1, count - 1), at - first};
}

// Two or four neighbouring floats, read or written in one transfer.
struct alignas(8) Pair {
    float x, y;
};

struct alignas(16) Four {
    float x, y, z, w;
};

FN Four operator*(const Four& value, float by) {
    return {value.x * by, value.y * by, value.z * by, value.w * by};
}

FN void add(Four& sum, const Four& value, float weight) {
    sum = {sum.x + weight * value.x, sum.y + weight * value.y, sum.z + weight * value.z,
           sum.w + weight * value.w};
}

// The floats of a tensor from 2 * index or 4 * index on; tensors begin at multiples of 256 bytes.
FN Pair& pair(const View& view, size_t index) { return reinterpret_cast<Pair*>(view.at)[index]; }

FN Four& four(const View& view, size_t index) { return reinterpret_cast<Four*>(view.at)[index]; }

// The frame before's state at a pixel, zero where it is not `valid`, and the depth of the nearest
// pixel.
struct Recalled {
    Four mean, first, second;  // colour and count, then the hidden channels
    float depth, valid;
};

// Bilinear between four numbers, or those of a plane.
FN float between(float a, float b, float c, float d, float tx, float ty) {
    const float top = a + (b - a) * tx, bottom = c + (d - c) * tx;
    return top + (bottom - top) * ty;
}

FN float between(const View& plane, const Between& row, const Between& column) {
    const float* const top = plane.at + row.first * plane.size[1];
    const float* const bottom = plane.at + row.second * plane.size[1];
    return between(top[column.first], top[column.second], bottom[column.first],
                   bottom[column.second], column.share, row.share);
}

// Four channels of the state, bilinear between the pixels at four indices of such groups.
FN Four recalled_four(const View& state, size_t a, size_t b, size_t c, size_t d, float tx,
                      float ty) {
    const Four p = four(state, a), q = four(state, b), r = four(state, c), s = four(state, d);
    return {between(p.x, q.x, r.x, s.x, tx, ty), between(p.y, q.y, r.y, s.y, tx, ty),
            between(p.z, q.z, r.z, s.z, tx, ty), between(p.w, q.w, r.w, s.w, tx, ty)};
}

// Whether the history lacks more than a trace of a pixel, by the counts of its neighbours and their
// weights.
FN bool is_unknown(float a, float b, float c, float d, float tx, float ty) {
    const float lacking = between(a <= 0.0f, b <= 0.0f, c <= 0.0f, d <= 0.0f, tx, ty);
    return lacking > UNKNOWN;
}

FN Recalled recall(const View& state, const View& last_depth, float px, float py, float share) {
    const int h = last_depth.size[0], w = last_depth.size[1];
    const bool held = px >= -0.5f && px <= float(w) - 0.5f && py >= -0.5f && py <= float(h) - 0.5f;
    if (!held || share == 0.0f) return {{}, {}, {}, 1.0f, 0.0f};
    const float depth = last_depth.at[clip(int(rintf(py)), h) * w + clip(int(rintf(px)), w)];
    px = fminf(fmaxf(px, 0.0f), float(w - 1));
    py = fminf(fmaxf(py, 0.0f), float(h - 1));
    const int x0 = int(px), y0 = int(py), x1 = min(x0 + 1, w - 1), y1 = min(y0 + 1, h - 1);
    const float tx = px - float(x0), ty = py - float(y0);
    const size_t upper = size_t(y0) * w, lower = size_t(y1) * w;
    const size_t a = 3 * (upper + x0), b = 3 * (upper + x1), c = 3 * (lower + x0),
                 d = 3 * (lower + x1);
    if (is_unknown(four(state, a).w, four(state, b).w, four(state, c).w, four(state, d).w, tx, ty))
        return {{0.0f, 0.0f, 0.0f, -1.0f}, {}, {}, 1.0f, 0.0f};
    Four mean = recalled_four(state, a, b, c, d, tx, ty);
    mean.w *= share;  // the mean colour is what it is, but counts less
    return {mean, recalled_four(state, a + 1, b + 1, c + 1, d + 1, tx, ty) * share,
            recalled_four(state, a + 2, b + 2, c + 2, d + 2, tx, ty) * share, depth, share};
}

// Eight neighbouring numbers in half precision, as their bits, read or written in one transfer.
struct alignas(16) Halves {
    unsigned short at[8];
};

// A tensor in half precision, by eights.
FN Halves* halves(const View& view) { return reinterpret_cast<Halves*>(view.at); }

// On the host tests put their own in place of the GPU's instructions.
#ifdef __CUDACC_RTC__
FN float from_half(unsigned short bits) {
    float value;
    asm("cvt.f32.f16 %0, %1;" : "=f"(value) : "h"(bits));
    return value;
}

FN unsigned short to_half(float value) {
    unsigned short bits;
    asm("cvt.rn.f16.f32 %0, %1;" : "=h"(bits) : "f"(value));
    return bits;
}

// A GPU's own functions, one instruction each, to about 2^-22; of log2_of absolute, between 1
// and 2.
FN float log2_of(float value) {
    float result;
    asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(value));
    return result;
}

FN float exp2_of(float value) {
    float result;
    asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(value));
    return result;
}

FN float over_one(float value) {
    float result;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(value));
    return result;
}

// What is so many numbers behind another one; the compiler does not know where, so it adds instead
// of multiplying anew.
template <class T>
FN const T* behind(const T* at, size_t count) {
    at += count;
    asm("" : "+l"(at));
    return at;
}
#endif

// log(1 + x) and exp(x) - 1 of what is finite and not below 0, to 3e-6: of small numbers by their
// series.
const float SMALL_NUMBER = 0.0625f, LOG2_E = 1.44269504f;

FN float log1p_of(float x) {
    const float series = x * (1.0f - x * (0.5f - x * (0.333333333f - x * (0.25f - x * 0.2f))));
    return x < SMALL_NUMBER ? series : log2_of(1.0f + x) * (1.0f / LOG2_E);
}

FN float expm1_of(float x) {
    const float series = x * (1.0f + x * (0.5f + x * (0.166666667f + x * 0.0416666667f)));
    return x < SMALL_NUMBER ? series : exp2_of(x * LOG2_E) - 1.0f;
}

// log(1 + x) of an exposed colour in [0, 1e4].
FN float log_encode(float exposed) { return log1p_of(fminf(fmaxf(0.0f, exposed), MAX_COLOUR)); }

// Threads of a block, across and down, of kernels whose threads make pixels: PIXELS in
// postfx/runtime/cuda.py.
[[maybe_unused]] const int ACROSS = 32;
[[maybe_unused]] const int DOWN = 8;

// Three numbers, or pairs of them, of each thread of a row, into a picture's row `to`, of which
// `count` are left. A warp writes them side by side, as memory takes whole sectors faster than
// parts of them. All its threads come here.
const bool stages = true;

template <class T>
FN void put_row(T (&staged)[3 * ACROSS], const T (&own)[3], T* to, int count) {
    if (!stages) {
        for (int i = 0; i < 3; i++)
            if (3 * int(threadIdx.x) + i < count) to[3 * threadIdx.x + i] = own[i];
        return;
    }
    UNROLL for (int i = 0; i < 3; i++) staged[3 * threadIdx.x + i] = own[i];
    __syncwarp();
    UNROLL for (int i = 0; i < 3; i++) {
        const int at = i * ACROSS + threadIdx.x;
        if (at < count) to[at] = staged[at];
    }
    __syncwarp();
}

// Two pixels beside each other, from an even one on, at (y, x) of a picture (height, width, 3).
FN void put_beside(const float (&light)[6], const View& picture, int y, int x) {
    const int width = picture.size[1];
    const size_t at = 3 * (size_t(y) * width + x);
    UNROLL for (int i = 0; i < 6; i += 2) {
        if (width % 2 == 0) pair(picture, (at + i) / 2) = {light[i], light[i + 1]};
        else if (i < 3 || x + 1 < width) picture.at[at + i] = light[i];
        if (width % 2 && (i + 1 < 3 || x + 1 < width)) picture.at[at + i + 1] = light[i + 1];
    }
}

// The same of each thread of a row, whose first one has (y, first): a warp writes them side by
// side. The last threads may have what the one before them has.
FN void put_pixels(Pair (&staged)[3 * ACROSS], const float (&light)[6], const View& picture, int y,
                   int x, int first) {
    const int width = picture.size[1];
    if (width % 2) return put_beside(light, picture, y, x);
    const Pair own[3] = {{light[0], light[1]}, {light[2], light[3]}, {light[4], light[5]}};
    put_row(staged, own, &pair(picture, 3 * (size_t(y) * width + first) / 2),
            3 * (width - first) / 2);
}

// Heads are numbers in single precision, or bits of half precision. Of a kernel that is a template
// of `Number`, `read_source` in postfx/kernels/__init__.py makes both: `name` and `name_half`.
typedef unsigned short Half;

FN float as_float(float number) { return number; }

FN float as_float(Half bits) { return from_half(bits); }

template <class Number>
FN const Number* numbers(const View& view) { return reinterpret_cast<const Number*>(view.at); }

// Activations of the network's heads: of filter weights, and of shares. NaN stays NaN.
FN float weight_of(float logit) {
    return expf(logit < -STEEPEST ? -STEEPEST : logit > STEEPEST ? STEEPEST : logit);
}

FN float gate_of(float logit) { return 1.0f / (1.0f + expf(-logit)); }

// postfx/kernels/colour.py: a matrix, then log2(1 + exposure * x / toe) * scale within [0, 1].
struct Shaper {
    float gain, most, scale;
    float matrix[9];
};

FN Shaper shaper(const View& params, const View& matrix) {
    const float *const p = params.at, *const m = matrix.at;
    return {p[0] / p[1], exp2f(fminf(126.0f, 1.0f / p[2])) - 1.0f, p[2],
            {m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]}};
}

FN Colour shaped(const Shaper& by, const float* colour) {
    const float r = clamped(colour[0], -BRIGHTEST, BRIGHTEST),
                g = clamped(colour[1], -BRIGHTEST, BRIGHTEST);
    const float b = clamped(colour[2], -BRIGHTEST, BRIGHTEST), *const m = by.matrix;
    const Colour light = {fmaxf(m[0] * r + m[1] * g + m[2] * b, 0.0f) * by.gain,
                          fmaxf(m[3] * r + m[4] * g + m[5] * b, 0.0f) * by.gain,
                          fmaxf(m[6] * r + m[7] * g + m[8] * b, 0.0f) * by.gain};
    const float fit = by.most / fmaxf(fmaxf(light.r, light.g), fmaxf(light.b, by.most));
    return {fminf(log2_of(light.r * fit + 1.0f) * by.scale, 1.0f),
            fminf(log2_of(light.g * fit + 1.0f) * by.scale, 1.0f),
            fminf(log2_of(light.b * fit + 1.0f) * by.scale, 1.0f)};
}

// postfx/kernels/colour.py: tetrahedral look-up of a shaped colour, clipped to [0, 1], in a cube
// (size, size, size, 3), or with fours of NUMBERS, which are read at once.
template <int NUMBERS = 3>
FN Colour looked_up(const View& cube, const Colour& shaped) {
    const int size = cube.size[0], end = size - 2, red = size * size, green = size, blue = 1;
    float r = clamped(shaped.r, 0.0f, 1.0f) * (size - 1),
          g = clamped(shaped.g, 0.0f, 1.0f) * (size - 1);
    float b = clamped(shaped.b, 0.0f, 1.0f) * (size - 1);
    const int i = min(int(r), end), j = min(int(g), end), k = min(int(b), end);
    r -= i;
    g -= j;
    b -= k;
    const int step = r >= g && r >= b ? red : (g >= b ? green : blue);
    const int last = r >= b && g >= b ? blue : (r >= g ? green : red);
    const float high = fmaxf(fmaxf(r, g), b), low = fminf(fminf(r, g), b);
    const float middle = fmaxf(fminf(r, g), fminf(fmaxf(r, g), b));
    const int first = i * red + j * green + k * blue, fourth = first + red + green + blue;
    const int corners[4] = {first, first + step, fourth - last, fourth};
    const float weights[4] = {1.0f - high, high - middle, middle - low, low};
    Colour found[4];
    UNROLL for (int n = 0; n < 4; n++) {
        const float* const at = cube.at + NUMBERS * corners[n];
        if (NUMBERS == 4) {
            const Four all = four(cube, corners[n]);
            found[n] = {all.x, all.y, all.z};
        } else {
            found[n] = {__ldg(at), __ldg(at + 1), __ldg(at + 2)};
        }
    }
    const auto mixed = [&](float a, float b, float c, float d) {
        return weights[0] * a + weights[1] * b + (weights[2] * c + weights[3] * d);
    };
    return {mixed(found[0].r, found[1].r, found[2].r, found[3].r),
            mixed(found[0].g, found[1].g, found[2].g, found[3].g),
            mixed(found[0].b, found[1].b, found[2].b, found[3].b)};
}

// How much a sample says about an output pixel at a distance in render pixels.
FN float gauss(float distance) { return exp2_of(-2.0f * LOG2_E * distance * distance); }

// A head's value at an output pixel from its first of four planes, one for each quarter-pixel
// corner of a render pixel, linear between them, `right` and `lower` from the first.
template <class Number>
FN float between_corners(const Number* first, size_t plane, float right, float lower) {
    const float above = as_float(first[0]), beside = as_float(first[plane]);
    const float before = above + (as_float(first[2 * plane]) - above) * lower;
    const float after = beside + (as_float(first[3 * plane]) - beside) * lower;
    return before + (after - before) * right;
}

// The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default.
FN Four cubic_weights(float t) {
    const float a = -0.75f, u = t + 1.0f, v = 1.0f - t, s = 2.0f - t;
    return {((a * u - 5.0f * a) * u + 8.0f * a) * u - 4.0f * a,
            ((a + 2.0f) * t - (a + 3.0f)) * t * t + 1.0f,
            ((a + 2.0f) * v - (a + 3.0f)) * v * v + 1.0f,
            ((a * s - 5.0f * a) * s + 8.0f * a) * s - 4.0f * a};
}

// Four rows, weighted.
FN Colour column_of(const Colour& first, const Colour& second, const Colour& third,
                    const Colour& last, const Four& weights) {
    Colour sum = first * weights.x;
    add(sum, second, weights.y);
    add(sum, third, weights.z);
    add(sum, last, weights.w);
    return sum;
}

// Four pixels of a row, weighted; `columns` are those of their first channels.
FN Colour row_of(const float* row, const int (&columns)[4], const Four& weights) {
    return column_of(three(row + columns[0]), three(row + columns[1]), three(row + columns[2]),
                     three(row + columns[3]), weights);
}

// Where a pixel was in a picture before: by how much it moved, and the first row and column of its
// 4x4 taps.
struct Before {
    float right, down;
    int top, left;
};

// The same of a pixel of the frame's output.
FN Before before_of(int y, int x, const Window& part, const View& moved) {
    const int height = part.height, width = part.width;
    const unsigned h = part.h, w = part.w, v = unsigned(y), u = unsigned(x);
    // The render pixel that holds this pixel's centre.
    const bool doubled = is_doubled(part);
    const int from_y = doubled ? y / 2 : int((2u * v + 1u) * h / (2u * height));
    const int from_x = doubled ? x / 2 : int((2u * u + 1u) * w / (2u * width));
    const int row = clip(from_y - part.top, moved.size[0]),
              column = clip(from_x - part.left, moved.size[1]);
    const Pair motion = pair(moved, size_t(row) * moved.size[1] + column);
    const float right = motion.x * (float(width) / float(w)),
                down = motion.y * (float(height) / float(h));
    return {right, down, y + int(floorf(down)) - 1, x + int(floorf(right)) - 1};
}

struct Size {
    int height, width;
};

// A picture (height, width, 3) where a pixel was before, bicubic, edge repeated.
FN Colour moved_picture(const float* picture, const Size& size, const Before& before) {
    const int height = size.height, width = size.width, top = before.top, left = before.left;
    const int columns[4] = {3 * clip(left, width), 3 * clip(left + 1, width),
                            3 * clip(left + 2, width), 3 * clip(left + 3, width)};
    const size_t line = 3 * size_t(width);
    const Four across = cubic_weights(before.right - floorf(before.right));
    return column_of(row_of(picture + clip(top, height) * line, columns, across),
                     row_of(picture + clip(top + 1, height) * line, columns, across),
                     row_of(picture + clip(top + 2, height) * line, columns, across),
                     row_of(picture + clip(top + 3, height) * line, columns, across),
                     cubic_weights(before.down - floorf(before.down)));
}

// What is not finite counts as 0.
FN float finite(float value) { return fabsf(value) <= LARGEST_FLOAT ? value : 0.0f; }

struct Cubic {
    float weight[4];
    int index[4];
};

// The four taps around a position and their weights (Keys 1981, a = -0.5); only their constant
// indices are used.
FN Cubic cubic(float position, int size) {
    const float first = floorf(position), t = position - first;
    const int before = int(first) - 1;
    return {{((-0.5f * t + 1.0f) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1.0f,
             ((-1.5f * t + 2.0f) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t},
            {clip(before, size), clip(before + 1, size), clip(before + 2, size),
             clip(before + 3, size)}};
}

// One pixel of an image (h, w, channels) by cubic interpolation, held within the four nearest
// samples.
FN void resampled(const View& image, int channels, const Cubic& down, const Cubic& across,
                  float* result) {
    const float* row[4];
    UNROLL for (int j = 0; j < 4; j++)
        row[j] = image.at + size_t(down.index[j]) * image.size[1] * channels;
    for (int k = 0; k < channels; k++) {
        float sum = 0.0f, least = LARGEST_FLOAT, most = -LARGEST_FLOAT;
        UNROLL for (int i = 0; i < 4; i++) {
            const int at = across.index[i] * channels + k;
            const float before = finite(row[0][at]), upper = finite(row[1][at]),
                        lower = finite(row[2][at]);
            sum += across.weight[i]
                   * (down.weight[0] * before + down.weight[1] * upper + down.weight[2] * lower
                      + down.weight[3] * finite(row[3][at]));
            if (i == 0 || i == 3) continue;
            least = fminf(least, fminf(upper, lower));
            most = fmaxf(most, fmaxf(upper, lower));
        }
        result[k] = fminf(fmaxf(sum, least), most);  // edges do not ring and nothing turns negative
    }
}

// Light in front, premultiplied by its coverage, over what is behind.
FN float over(float front, float alpha, float behind) {
    return finite(front) + (1.0f - alpha) * finite(behind);
}

// postfx/interpolate: a path leads from a cell to its place in the frame before (a) and in the one
// after (b), in pixels; whether each of them shows the point, 0 or 1.
struct Path {
    float ax, ay, bx, by, first, last;
};

FN Path path_of(const View& cells, int cell) {
    const Four p = four(cells, 2 * size_t(cell));
    const Pair q = pair(cells, 4 * size_t(cell) + 2);
    return {p.x, p.y, p.z, p.w, q.x, q.y};
}

FN void put_path(const View& cells, int cell, const Path& path) {
    four(cells, 2 * size_t(cell)) = {path.ax, path.ay, path.bx, path.by};
    pair(cells, 4 * size_t(cell) + 2) = {path.first, path.last};
}

// Whether paths lead to other places, by so many pixels.
FN bool differ(const Path& one, const Path& other, float by) {
    return fabsf(one.ax - other.ax) > by || fabsf(one.ay - other.ay) > by
           || fabsf(one.bx - other.bx) > by || fabsf(one.by - other.by) > by;
}

// A path of one frame's side, in pixels: that frame shows it, the other one if most paths that
// arrived are seen.
FN Path side_path(const Four& path, float is_seen, bool is_last, float scale) {
    return {scale * path.x, scale * path.y,           scale * path.z,
            scale * path.w, is_last ? is_seen : 1.0f, is_last ? 1.0f : is_seen};
}

FN float most_apart(const Path& one, const Path& other) {
    return fmaxf(fmaxf(fabsf(one.ax - other.ax), fabsf(one.ay - other.ay)),
                 fmaxf(fabsf(one.bx - other.bx), fabsf(one.by - other.by)));
}

// Whether a place is in a picture.
FN bool is_inside(int h, int w, float y, float x) {
    return x > -0.5f && y > -0.5f && x < float(w) - 0.5f && y < float(h) - 0.5f;
}

// Sum over eight lanes that work on one thing, in all of them.
FN float sum_of_eight(float value) {
    for (int mask = 4; mask; mask /= 2)
        value += __shfl_xor_sync(0xffu << (threadIdx.x & 24), value, mask);
    return value;
}

// What the lane to the left of eight has.
FN float left_lane(float value) { return __shfl_up_sync(0xffu << (threadIdx.x & 24), value, 1, 8); }

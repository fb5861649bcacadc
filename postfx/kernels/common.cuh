// What the CUDA kernels of postfx share beside view.cuh: positions and the small functions of
// postfx/kernels/numeric.py. Constants such as MAX_COLOUR come before: postfx/runtime/cuda.py prints them.

[[maybe_unused]] const float LARGEST_FLOAT = 3.402823466e38f;

struct Colour {
    float r, g, b;
};

// Within [low, high], which holds 0 or lies above it; a NaN becomes the value nearest to 0.
__device__ inline float clamped(float value, float low, float high) {
    return fminf(fmaxf(low, value == value ? value : 0.0f), high);
}

__device__ inline int within(int index, int size) {
    return min(max(index, 0), size - 1);
}

// How much of the history a render pixel of the part uses; `keep` has one number for all of them, or one for each.
__device__ inline float share_of(const View& keep, int row, int column) {
    return keep.at[within(row, keep.size[0]) * keep.size[1] + within(column, keep.size[1])];
}

// Which part of the frame the kernels work on: first row and column at render size, the frame's size, and both at
// output size. A part may end beyond the frame.
struct Window {
    int top, left, h, w, out_top, out_left, height, width;
};

__device__ inline Window window_of(const View& view) {
    const float* at = view.at;
    return {int(at[TOP]), int(at[LEFT]), int(at[HEIGHT]), int(at[WIDTH]),
            int(at[OUT_TOP]), int(at[OUT_LEFT]), int(at[OUT_HEIGHT]), int(at[OUT_WIDTH])};
}

// The render pixel that holds an output pixel's centre; `offset` becomes the centre's offset from it in [-0.5, 0.5).
__device__ inline int centre(int position, int size, int out_size, float& offset) {
    const long long at = (2LL * position + 1) * size;  // in units of 1 / (2 out_size): exact
    const int index = int(at / (2LL * out_size));
    offset = float(double(at - index * (2LL * out_size)) / (2.0 * out_size) - 0.5);
    return index;
}

// How near a render pixel is to what is worked on, by cells (cells, cells), or by one number for all.
__device__ inline float nearness(const View& near, int y, int x) {
    return near.at[size_t(min(y / NEAR_CELL, near.size[0] - 1)) * near.size[1] + min(x / NEAR_CELL, near.size[1] - 1)];
}

// Mean of alpha's samples (2 h, 2 w, 1) in a render pixel.
__device__ inline float pixel_mean(const View& samples, int at_y, int at_x, int w) {
    const float* const upper = samples.at + 4 * size_t(at_y) * w + 2 * at_x;
    return (upper[0] + upper[1] + upper[2 * w] + upper[2 * w + 1]) * 0.25f;
}

// What no picture can have (NaN, infinity) is no motion.
__device__ inline float possible_motion(float value) {
    return value > -MOST_MOTION && value < MOST_MOTION ? value : 0.0f;
}

// log(1 + x) of an exposed colour in [0, 1e4].
__device__ inline float log_encode(float exposed) {
    return log1pf(fminf(fmaxf(0.0f, exposed), MAX_COLOUR));
}

// Reflectance that colour is divided by at a pixel (y, x) of albedos (h, w, 3).
__device__ inline Colour demodulation(const View& diffuse, const View& specular, int y, int x) {
    const int at = 3 * (y * diffuse.size[1] + x);
    const float r = clamped(diffuse.at[at] + specular.at[at], 0.0f, MOST_REFLECTANCE);
    const float g = clamped(diffuse.at[at + 1] + specular.at[at + 1], 0.0f, MOST_REFLECTANCE);
    const float b = clamped(diffuse.at[at + 2] + specular.at[at + 2], 0.0f, MOST_REFLECTANCE);
    const float peak = fmaxf(r, fmaxf(g, b)), floor = LEAST_TINT * peak;
    if (peak < EMITTER) return {1.0f, 1.0f, 1.0f};
    return {fmaxf(r, floor) + ADDED, fmaxf(g, floor) + ADDED, fmaxf(b, floor) + ADDED};
}

// Two or four neighbouring floats, read or written in one transfer.
struct alignas(8) Pair {
    float x, y;
};

struct alignas(16) Four {
    float x, y, z, w;
};

// The floats of a tensor from 2 * index or 4 * index on; tensors begin at multiples of 256 bytes.
__device__ inline Pair& pair(const View& view, size_t index) {
    return reinterpret_cast<Pair*>(view.at)[index];
}

__device__ inline Four& four(const View& view, size_t index) {
    return reinterpret_cast<Four*>(view.at)[index];
}

// Eight neighbouring numbers in half precision, as their bits, read or written in one transfer.
struct alignas(16) Halves {
    unsigned short at[8];
};

// A tensor in half precision, by eights.
__device__ inline Halves* halves(const View& view) {
    return reinterpret_cast<Halves*>(view.at);
}

#ifdef __CUDACC_RTC__
__device__ inline float from_half(unsigned short bits) {
    float value;
    asm("cvt.f32.f16 %0, %1;" : "=f"(value) : "h"(bits));
    return value;
}

__device__ inline unsigned short to_half(float value) {
    unsigned short bits;
    asm("cvt.rn.f16.f32 %0, %1;" : "=h"(bits) : "f"(value));
    return bits;
}
#else
inline float from_half(unsigned short bits) {
    return __builtin_bit_cast(_Float16, bits);
}

inline unsigned short to_half(float value) {
    return __builtin_bit_cast(unsigned short, _Float16(value));
}
#endif

// Heads are numbers in single precision, or bits of half precision.
typedef unsigned short Half;

__device__ inline float as_float(float number) {
    return number;
}

__device__ inline float as_float(Half bits) {
    return from_half(bits);
}

template <class Number>
__device__ inline const Number* numbers(const View& view) {
    return reinterpret_cast<const Number*>(view.at);
}

// Activations of the network's heads: of filter weights, and of shares.
__device__ inline float weight_of(float logit) {
    return expf(fminf(fmaxf(logit, -STEEPEST), STEEPEST));
}

__device__ inline float gate_of(float logit) {
    return 1.0f / (1.0f + expf(-logit));
}

// postfx/kernels/colour.py: a matrix, then log2(1 + exposure * x / toe) * scale within [0, 1].
struct Shaper {
    float gain, most, scale;
    float matrix[9];
};

__device__ inline Shaper shaper(const View& params, const View& matrix) {
    const float *const p = params.at, *const m = matrix.at;
    return {p[0] / p[1], exp2f(fminf(126.0f, 1.0f / p[2])) - 1.0f, p[2],
            {m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]}};
}

__device__ inline Colour shaped(const Shaper& by, const float* colour) {
    const float r = clamped(colour[0], -BRIGHTEST, BRIGHTEST), g = clamped(colour[1], -BRIGHTEST, BRIGHTEST);
    const float b = clamped(colour[2], -BRIGHTEST, BRIGHTEST), *const m = by.matrix;
    const Colour light = {fmaxf(m[0] * r + m[1] * g + m[2] * b, 0.0f) * by.gain,
                          fmaxf(m[3] * r + m[4] * g + m[5] * b, 0.0f) * by.gain,
                          fmaxf(m[6] * r + m[7] * g + m[8] * b, 0.0f) * by.gain};
    const float fit = by.most / fmaxf(fmaxf(light.r, light.g), fmaxf(light.b, by.most));
    return {fminf(log2f(light.r * fit + 1.0f) * by.scale, 1.0f), fminf(log2f(light.g * fit + 1.0f) * by.scale, 1.0f),
            fminf(log2f(light.b * fit + 1.0f) * by.scale, 1.0f)};
}

// postfx/kernels/colour.py: tetrahedral look-up of a shaped colour, clipped to [0, 1], in a cube (size, size, size, 3).
__device__ inline Colour looked_up(const View& cube, const Colour& shaped) {
    const int size = cube.size[0], end = size - 2, red = size * size, green = size, blue = 1;
    float r = clamped(shaped.r, 0.0f, 1.0f) * (size - 1), g = clamped(shaped.g, 0.0f, 1.0f) * (size - 1);
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
    const float* const corners[4] = {cube.at + 3 * first, cube.at + 3 * (first + step), cube.at + 3 * (fourth - last),
                                     cube.at + 3 * fourth};
    const float w0 = 1.0f - high, w1 = high - middle, w2 = middle - low;
    float found[3];
#pragma unroll
    for (int c = 0; c < 3; c++)
        found[c] = w0 * __ldg(corners[0] + c) + w1 * __ldg(corners[1] + c)
            + (w2 * __ldg(corners[2] + c) + low * __ldg(corners[3] + c));
    return {found[0], found[1], found[2]};
}

// An output pixel before the history: log-encoded colour, sharpened, and how much of the history it keeps.
struct Enlarged {
    Colour colour;
    float kept;
};

// How much a sample says about an output pixel at a distance in render pixels.
__device__ inline float gauss(float distance) {
    return expf(-2.0f * distance * distance);
}

// Normalised weights of the samples at -1, 0 and 1 plus `offset` for the softened picture.
__device__ inline void wide_gauss(float offset, float weights[3]) {
    const float before = expf(-0.5f * (offset - 1.0f) * (offset - 1.0f)), here = expf(-0.5f * offset * offset);
    const float after = expf(-0.5f * (offset + 1.0f) * (offset + 1.0f)), share = 1.0f / (before + here + after);
    weights[0] = before * share;
    weights[1] = here * share;
    weights[2] = after * share;
}

// A head's value at an output pixel from its first of four planes, one for each quarter-pixel corner of a render pixel:
// at one of them if DOUBLED, else linear between them, `right` and `lower` from the first.
template <bool DOUBLED, class Number>
__device__ inline float at_corner(const Number* first, size_t plane, int corner, float right, float lower) {
    if (DOUBLED) return as_float(first[corner * plane]);
    const float above = as_float(first[0]), beside = as_float(first[plane]);
    const float before = above + (as_float(first[2 * plane]) - above) * lower;
    const float after = beside + (as_float(first[3 * plane]) - beside) * lower;
    return before + (after - before) * right;
}

// What guides say of an output pixel's reflectance, and how far they are trusted.
struct Guide {
    Colour factor;
    float trust;
};

// An output pixel from 3x3 samples by predicted weight and distance; DOUBLED where both sides are twice the render's.
// The four weights of cubic convolution with a = -0.75, the ONNX GridSample and OpenCV default.
__device__ inline Four cubic_weights(float t) {
    const float a = -0.75f, u = t + 1.0f, v = 1.0f - t, s = 2.0f - t;
    return {((a * u - 5.0f * a) * u + 8.0f * a) * u - 4.0f * a, ((a + 2.0f) * t - (a + 3.0f)) * t * t + 1.0f,
            ((a + 2.0f) * v - (a + 3.0f)) * v * v + 1.0f, ((a * s - 5.0f * a) * s + 8.0f * a) * s - 4.0f * a};
}

// Four pixels of a row, weighted, added to a sum; `columns` are those of their first channels.
__device__ inline void add_taps(const float* row, const int (&columns)[4], const Four& weights, float weight,
                                Colour& sum) {
    const float* p = row + columns[0];
    const float* q = row + columns[1];
    const float* r = row + columns[2];
    const float* s = row + columns[3];
    sum.r += weight * (weights.x * p[0] + weights.y * q[0] + weights.z * r[0] + weights.w * s[0]);
    sum.g += weight * (weights.x * p[1] + weights.y * q[1] + weights.z * r[1] + weights.w * s[1]);
    sum.b += weight * (weights.x * p[2] + weights.y * q[2] + weights.z * r[2] + weights.w * s[2]);
}

// A picture (height, width, 3) where the pixel of the frame's output was before, bicubic, edge repeated.
__device__ inline Colour moved_picture(const float* picture, int y, int x, const Window& part, const View& moved) {
    const int height = part.height, width = part.width;
    const unsigned h = part.h, w = part.w, v = unsigned(y), u = unsigned(x);
    // The render pixel that holds this pixel's centre.
    const int from_y = int((2u * v + 1u) * h / (2u * height)), from_x = int((2u * u + 1u) * w / (2u * width));
    const int row = within(from_y - part.top, moved.size[0]), column = within(from_x - part.left, moved.size[1]);
    const Pair motion = pair(moved, size_t(row) * moved.size[1] + column);
    const float right = motion.x * (float(width) / float(w)), down = motion.y * (float(height) / float(h));
    const float whole_right = floorf(right), whole_down = floorf(down);
    const Four wx = cubic_weights(right - whole_right), wy = cubic_weights(down - whole_down);
    const int left = x + int(whole_right) - 1, top = y + int(whole_down) - 1;
    const int columns[4] = {3 * within(left, width), 3 * within(left + 1, width), 3 * within(left + 2, width),
                            3 * within(left + 3, width)};
    const size_t line = 3 * size_t(width);
    Colour sum = {0.0f, 0.0f, 0.0f};
    add_taps(picture + within(top, height) * line, columns, wx, wy.x, sum);
    add_taps(picture + within(top + 1, height) * line, columns, wx, wy.y, sum);
    add_taps(picture + within(top + 2, height) * line, columns, wx, wy.z, sum);
    add_taps(picture + within(top + 3, height) * line, columns, wx, wy.w, sum);
    return sum;
}

// Radiance that is multiplied BY something is without reflectance, then with that of the render size.
enum Multiplied { BY_NOTHING, BY_GUIDES, BY_OWN };

// LINEAR light is neither sharpened nor encoded.
template <bool DOUBLED, class Number, Multiplied BY, bool LINEAR>
__device__ inline Enlarged enlarged(int x, int y, const Window& part, const View& radiance, const View& fine,
                                    const View& moved, const View& past, const View& params, const View& keep,
                                    const Guide& guide) {
    const int w = part.w, h = part.h, width = part.width, height = part.height;
    float u = x % 2 ? 0.25f : -0.25f, v = y % 2 ? 0.25f : -0.25f;
    const int frame_column = DOUBLED ? x / 2 : centre(x, w, width, u);
    const int frame_row = DOUBLED ? y / 2 : centre(y, h, height, v);
    const int column = within(frame_column - part.left, moved.size[1]);
    const int row = within(frame_row - part.top, moved.size[0]);
    const float right = fminf(fmaxf(2.0f * u + 0.5f, 0.0f), 1.0f), lower = fminf(fmaxf(2.0f * v + 0.5f, 0.0f), 1.0f);
    const int corner = 2 * (y % 2) + x % 2;
    u = params.at[JITTER_X] - u;
    v = params.at[JITTER_Y] - v;
    float wide_x[3], wide_y[3];
    wide_gauss(u, wide_x);
    wide_gauss(v, wide_y);
    const size_t plane = size_t(fine.size[2]) * fine.size[3];  // 80 of them may hold more than 2^31 numbers
    const Number* const head = numbers<Number>(fine) + size_t(row) * fine.size[3] + column;
    const int picture = radiance.size[1] * radiance.size[2];
    const float* const samples = radiance.at + row * radiance.size[2] + column;
    const float narrow[3] = {gauss(u - 1.0f), gauss(u), gauss(u + 1.0f)};
    Colour sum = {0.0f, 0.0f, 0.0f}, soft = {0.0f, 0.0f, 0.0f};
    float total = TINY;
#pragma unroll
    for (int j = 0; j < 3; j++) {
        const float across = gauss(j - 1 + v);
#pragma unroll
        for (int i = 0; i < 3; i++) {
            const Number* const tap = head + (TAP_WEIGHTS + 4 * (3 * j + i)) * plane;
            const float weight = at_corner<DOUBLED>(tap, plane, corner, right, lower) * (across * narrow[i]);
            const float even = wide_y[j] * wide_x[i];
            const float* const sample = samples + j * radiance.size[2] + i;
            Colour light = {sample[0], sample[picture], sample[2 * picture]};
            if (BY == BY_GUIDES) {
                const Colour own = {sample[3 * picture], sample[4 * picture], sample[5 * picture]};
                light = {own.r + (light.r * guide.factor.r - own.r) * guide.trust,
                         own.g + (light.g * guide.factor.g - own.g) * guide.trust,
                         own.b + (light.b * guide.factor.b - own.b) * guide.trust};
            }
            if (BY == BY_OWN)
                light = {light.r * guide.factor.r, light.g * guide.factor.g, light.b * guide.factor.b};
            total += weight;
            sum = {sum.r + weight * light.r, sum.g + weight * light.g, sum.b + weight * light.b};
            soft = {soft.r + even * light.r, soft.g + even * light.g, soft.b + even * light.b};
        }
    }
    const float blend = at_corner<DOUBLED>(head + BLEND * plane, plane, corner, right, lower);
    const int at = row * moved.size[1] + column;
    const float px = x + moved.at[2 * at] * (float(width) / w), py = y + moved.at[2 * at + 1] * (float(height) / h);
    const bool inside = px >= -0.5f && px <= width - 0.5f && py >= -0.5f && py <= height - 0.5f;  // not if NaN
    const bool held = inside && past.at[4 * at + 3] >= 0.0f;
    const float kept = held ? share_of(keep, row, column) * (1.0f - blend) : 0.0f;
    if (LINEAR) return {{sum.r / total, sum.g / total, sum.b / total}, kept};
    const float sharpen = at_corner<DOUBLED>(head + SHARPEN * plane, plane, corner, right, lower);
    const Colour sharp = {log_encode(sum.r / total), log_encode(sum.g / total), log_encode(sum.b / total)};
    return {{fmaxf(sharp.r + sharpen * (sharp.r - log_encode(soft.r)), 0.0f),
             fmaxf(sharp.g + sharpen * (sharp.g - log_encode(soft.g)), 0.0f),
             fmaxf(sharp.b + sharpen * (sharp.b - log_encode(soft.b)), 0.0f)},
            kept};
}

// The same at any scale; x and y count the frame's output pixels.
template <class Number, Multiplied BY = BY_NOTHING, bool LINEAR = false>
__device__ inline Enlarged enlarged(int x, int y, const Window& part, const View& radiance, const View& fine,
                                    const View& moved, const View& past, const View& params, const View& keep,
                                    const Guide& guide = {}) {
    if (part.width == 2 * part.w && part.height == 2 * part.h)
        return enlarged<true, Number, BY, LINEAR>(x, y, part, radiance, fine, moved, past, params, keep, guide);
    return enlarged<false, Number, BY, LINEAR>(x, y, part, radiance, fine, moved, past, params, keep, guide);
}

// Blends one channel with the reprojected history and decodes it; `at` counts floats.
__device__ inline void blend_history(float current, float kept, size_t at, float darken, const View& warped,
                                     const View& output, const View& history) {
    const float now = current <= MOST_LOG ? current : 0.0f, mixed = now + (warped.at[at] - now) * kept;
    const float blended = mixed <= MOST_LOG ? fmaxf(mixed, 0.0f) : now;  // rounding makes no light negative
    history.at[at] = blended;
    output.at[at] = expm1f(blended) * darken;
}

// The same for all channels of an output pixel.
__device__ inline void blend_pixel(const Enlarged& found, size_t pixel, const View& params, const View& warped,
                                   const View& output, const View& history) {
    const float darken = 1.0f / params.at[EXPOSURE];
    const size_t at = 3 * pixel;
    blend_history(found.colour.r, found.kept, at, darken, warped, output, history);
    blend_history(found.colour.g, found.kept, at + 1, darken, warped, output, history);
    blend_history(found.colour.b, found.kept, at + 2, darken, warped, output, history);
}

// What is not finite counts as 0.
__device__ inline float known(float value) {
    return fabsf(value) <= LARGEST_FLOAT ? value : 0.0f;
}

struct Cubic {
    float weight[4];
    int index[4];
};

// The four taps around a position and their weights (Keys 1981, a = -0.5); only their constant indices are used.
__device__ inline Cubic cubic(float position, int size) {
    const float first = floorf(position), t = position - first;
    const int before = int(first) - 1;
    return {{((-0.5f * t + 1.0f) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1.0f,
             ((-1.5f * t + 2.0f) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t},
            {within(before, size), within(before + 1, size), within(before + 2, size), within(before + 3, size)}};
}

// One pixel of an image (h, w, channels) by cubic interpolation, held within the four nearest samples.
__device__ inline void resampled(const View& image, int channels, const Cubic& down, const Cubic& across,
                                 float* result) {
    const float* row[4];
#pragma unroll
    for (int j = 0; j < 4; j++) row[j] = image.at + size_t(down.index[j]) * image.size[1] * channels;
    for (int k = 0; k < channels; k++) {
        float sum = 0.0f, least = LARGEST_FLOAT, most = -LARGEST_FLOAT;
#pragma unroll
        for (int i = 0; i < 4; i++) {
            const int at = across.index[i] * channels + k;
            const float before = known(row[0][at]), upper = known(row[1][at]), lower = known(row[2][at]);
            sum += across.weight[i] * (down.weight[0] * before + down.weight[1] * upper + down.weight[2] * lower
                                       + down.weight[3] * known(row[3][at]));
            if (i == 0 || i == 3) continue;
            least = fminf(least, fminf(upper, lower));
            most = fmaxf(most, fmaxf(upper, lower));
        }
        result[k] = fminf(fmaxf(sum, least), most);  // edges do not ring and nothing turns negative
    }
}

// Light in front, premultiplied by its coverage, over what is behind.
__device__ inline float over(float front, float alpha, float behind) {
    return known(front) + (1.0f - alpha) * known(behind);
}

// postfx/interpolate: a path leads from a cell to its place in the frame before (a) and in the one after (b), in pixels;
// whether each of them shows the point, 0 or 1.
struct Path {
    float ax, ay, bx, by, first, last;
};

__device__ inline Path path_of(const View& cells, int cell) {
    const Four p = four(cells, 2 * size_t(cell));
    const Pair q = pair(cells, 4 * size_t(cell) + 2);
    return {p.x, p.y, p.z, p.w, q.x, q.y};
}

__device__ inline void put_path(const View& cells, int cell, const Path& path) {
    four(cells, 2 * size_t(cell)) = {path.ax, path.ay, path.bx, path.by};
    pair(cells, 4 * size_t(cell) + 2) = {path.first, path.last};
}

// Whether paths lead to other places, by so many pixels.
__device__ inline bool differ(const Path& one, const Path& other, float by) {
    return fabsf(one.ax - other.ax) > by || fabsf(one.ay - other.ay) > by || fabsf(one.bx - other.bx) > by
        || fabsf(one.by - other.by) > by;
}

// A path of one frame's side, in pixels: that frame shows it, the other one if most paths that arrived are seen.
__device__ inline Path side_path(const Four& path, float is_seen, bool is_last, float scale) {
    return {scale * path.x, scale * path.y, scale * path.z, scale * path.w, is_last ? is_seen : 1.0f,
            is_last ? 1.0f : is_seen};
}

__device__ inline float most_apart(const Path& one, const Path& other) {
    return fmaxf(fmaxf(fabsf(one.ax - other.ax), fabsf(one.ay - other.ay)),
                 fmaxf(fabsf(one.bx - other.bx), fabsf(one.by - other.by)));
}

// Whether a place is in a picture.
__device__ inline bool is_inside(int h, int w, float y, float x) {
    return x > -0.5f && y > -0.5f && x < float(w) - 0.5f && y < float(h) - 0.5f;
}

// Sum over eight lanes that work on one thing, in all of them.
__device__ inline float sum_of_eight(float value) {
    for (int mask = 4; mask; mask /= 2) value += __shfl_xor_sync(0xffu << (threadIdx.x & 24), value, mask);
    return value;
}

// What the lane to the left of eight has.
__device__ inline float left_lane(float value) {
    return __shfl_up_sync(0xffu << (threadIdx.x & 24), value, 1, 8);
}

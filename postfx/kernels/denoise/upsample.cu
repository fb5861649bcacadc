// An output pixel before the history: log-encoded colour, sharpened, and how much of the history it
// keeps.
struct Enlarged {
    Colour colour;
    float kept;
};

// What is enlarged, and what it is blended with.
struct Enlarging {
    Window part;
    View radiance, fine, moved, past, warped, params, keep, output, history;
};

// What guides say of an output pixel's reflectance, and how far they are trusted.
struct Guide {
    Colour factor;
    float trust;
};

// Normalised weights of the samples at -1, 0 and 1 plus `offset` for the softened picture.
FN void wide_gauss(float offset, float weights[3]) {
    const float scale = -0.5f * LOG2_E, before = exp2_of(scale * (offset - 1.0f) * (offset - 1.0f));
    const float here = exp2_of(scale * offset * offset),
                after = exp2_of(scale * (offset + 1.0f) * (offset + 1.0f));
    const float share = over_one(before + here + after);
    weights[0] = before * share;
    weights[1] = here * share;
    weights[2] = after * share;
}

// Radiance that is multiplied BY something is without reflectance, then with that of the render
// size.
enum Multiplied { BY_NOTHING, BY_GUIDES, BY_OWN };

// A sample's light at an output pixel; `plane` is the size of a channel.
template <Multiplied BY>
FN Colour light_at(const float* sample, int plane, const Guide& guide) {
    const Colour light = three(sample, plane);
    if (BY == BY_NOTHING) return light;
    const Colour whole = light * guide.factor;
    if (BY == BY_OWN) return whole;
    const Colour own = three(sample + 3 * plane, plane);
    return {own.r + (whole.r - own.r) * guide.trust, own.g + (whole.g - own.g) * guide.trust,
            own.b + (whole.b - own.b) * guide.trust};
}

// The mean of light, sharpened and encoded, which LINEAR light is not; and how much of the history
// it keeps.
template <bool LINEAR>
FN Enlarged finished(const Colour& sum, const Colour& soft, float total, float sharpen,
                     float kept) {
    const Colour mean = sum * over_one(total);
    if (LINEAR) return {mean, kept};
    const Colour sharp = {log_encode(mean.r), log_encode(mean.g), log_encode(mean.b)};
    return {{fmaxf(sharp.r + sharpen * (sharp.r - log_encode(soft.r)), 0.0f),
             fmaxf(sharp.g + sharpen * (sharp.g - log_encode(soft.g)), 0.0f),
             fmaxf(sharp.b + sharpen * (sharp.b - log_encode(soft.b)), 0.0f)},
            kept};
}

// Whether a pixel of the output was in the frame before; not if the place is NaN.
FN bool was_inside(float x, float y, const Window& part) {
    return x >= -0.5f && x <= part.width - 0.5f && y >= -0.5f && y <= part.height - 0.5f;
}

// An output pixel at any scale, from 3x3 samples by predicted weight and distance; x and y count
// the frame's pixels.
template <class Number, Multiplied BY = BY_NOTHING, bool LINEAR = false>
FN Enlarged enlarged(int x, int y, const Enlarging& of, const Guide& guide = {}) {
    const Window& part = of.part;
    const View &radiance = of.radiance, &fine = of.fine, &moved = of.moved, &params = of.params;
    const int w = part.w, h = part.h, width = part.width, height = part.height;
    float u, v;
    const int column = clip(centre(x, w, width, u) - part.left, moved.size[1]);
    const int row = clip(centre(y, h, height, v) - part.top, moved.size[0]);
    const float right = fminf(fmaxf(2.0f * u + 0.5f, 0.0f), 1.0f),
                lower = fminf(fmaxf(2.0f * v + 0.5f, 0.0f), 1.0f);
    u = params.at[JITTER_X] - u;
    v = params.at[JITTER_Y] - v;
    float wide_x[3], wide_y[3];
    wide_gauss(u, wide_x);
    wide_gauss(v, wide_y);
    // 80 of them may hold more than 2^31 numbers
    const size_t plane = size_t(fine.size[2]) * fine.size[3];
    const Number* const head = numbers<Number>(fine) + size_t(row) * fine.size[3] + column;
    const int picture = radiance.size[1] * radiance.size[2];
    const float* const samples = radiance.at + row * radiance.size[2] + column;
    const float narrow[3] = {gauss(u - 1.0f), gauss(u), gauss(u + 1.0f)};
    Colour sum = {0.0f, 0.0f, 0.0f}, soft = {0.0f, 0.0f, 0.0f};
    float total = TINY;
    UNROLL for (int j = 0; j < 3; j++) {
        const float across = gauss(j - 1 + v);
        UNROLL for (int i = 0; i < 3; i++) {
            const Number* const tap = head + (TAP_WEIGHTS + 4 * (3 * j + i)) * plane;
            const float weight = between_corners(tap, plane, right, lower) * (across * narrow[i]);
            const Colour light = light_at<BY>(samples + j * radiance.size[2] + i, picture, guide);
            total += weight;
            add(sum, light, weight);
            add(soft, light, wide_y[j] * wide_x[i]);
        }
    }
    const float blend = between_corners(head + BLEND * plane, plane, right, lower);
    const float sharpen = between_corners(head + SHARPEN * plane, plane, right, lower);
    const int at = row * moved.size[1] + column;
    const float px = x + moved.at[2 * at] * (float(width) / w),
                py = y + moved.at[2 * at + 1] * (float(height) / h);
    const bool held = was_inside(px, py, part) && of.past.at[4 * at + 3] >= 0.0f;
    return finished<LINEAR>(sum, soft, total, sharpen,
                            held ? share_of(of.keep, row, column) * (1.0f - blend) : 0.0f);
}

// The four output pixels of a render pixel then, from that at (y, x) on, row by row: the same with
// each pixel's own weights.
template <class Number, Multiplied BY = BY_NOTHING, bool LINEAR = false>
FN void enlarged_four(int x, int y, const Enlarging& of, const Guide (&guides)[4],
                      Enlarged (&found)[4]) {
    const Window& part = of.part;
    const View &radiance = of.radiance, &fine = of.fine, &moved = of.moved, &params = of.params;
    const int column = clip(x / 2 - part.left, moved.size[1]),
              row = clip(y / 2 - part.top, moved.size[0]);
    const size_t plane = size_t(fine.size[2]) * fine.size[3];
    const Number* const head = numbers<Number>(fine) + size_t(row) * fine.size[3] + column;
    const int picture = radiance.size[1] * radiance.size[2];
    const float* const samples = radiance.at + row * radiance.size[2] + column;
    float narrow_x[2][3], narrow_y[2][3], wide_x[2][3], wide_y[2][3];
    UNROLL for (int k = 0; k < 2; k++) {
        const float offset = k ? 0.25f : -0.25f, u = params.at[JITTER_X] - offset,
                    v = params.at[JITTER_Y] - offset;
        wide_gauss(u, wide_x[k]);
        wide_gauss(v, wide_y[k]);
        UNROLL for (int i = 0; i < 3; i++) {
            narrow_x[k][i] = gauss(i - 1 + u);
            narrow_y[k][i] = gauss(i - 1 + v);
        }
    }
    Colour sum[4] = {}, soft[4] = {};
    float total[4] = {TINY, TINY, TINY, TINY};
    UNROLL for (int i = 0; i < 9; i++) {
        const Number* const tap = head + (TAP_WEIGHTS + 4 * i) * plane;
        const float* const sample = samples + i / 3 * radiance.size[2] + i % 3;
        UNROLL for (int k = 0; k < 4; k++) {
            const float weight = as_float(tap[k * plane])
                                 * (narrow_y[k / 2][i / 3] * narrow_x[k % 2][i % 3]);
            const Colour light = light_at<BY>(sample, picture, guides[k]);
            total[k] += weight;
            add(sum[k], light, weight);
            add(soft[k], light, wide_y[k / 2][i / 3] * wide_x[k % 2][i % 3]);
        }
    }
    const int at = row * moved.size[1] + column;
    const Pair motion = pair(moved, at);
    const bool was_held = of.past.at[4 * at + 3] >= 0.0f;
    const float share = share_of(of.keep, row, column);
    UNROLL for (int k = 0; k < 4; k++) {
        const float blend = as_float(head[(BLEND + k) * plane]),
                    sharpen = as_float(head[(SHARPEN + k) * plane]);
        const bool held =
            was_held && was_inside(x + k % 2 + motion.x * 2.0f, y + k / 2 + motion.y * 2.0f, part);
        found[k] = finished<LINEAR>(sum[k], soft[k], total[k], sharpen,
                                    held ? share * (1.0f - blend) : 0.0f);
    }
}

// Log-encoded light blended with the reprojected history.
FN float blended(float current, float kept, float before) {
    const float now = current <= MOST_LOG ? current : 0.0f, mixed = now + (before - now) * kept;
    return mixed <= MOST_LOG ? fmaxf(mixed, 0.0f) : now;  // rounding makes no light negative
}

// A pixel blended with the history, which is kept, and decoded.
FN void blend_pixel(const Enlarged& found, size_t pixel, const Enlarging& of) {
    const float darken = 1.0f / of.params.at[EXPOSURE],
                current[3] = {found.colour.r, found.colour.g, found.colour.b};
    UNROLL for (int c = 0; c < 3; c++) {
        const size_t at = 3 * pixel + c;
        const float light = blended(current[c], found.kept, of.warped.at[at]);
        of.history.at[at] = light;
        of.output.at[at] = expm1_of(light) * darken;
    }
}

// Two pixels beside each other in every thread of a row: the first thread's begin at `first`, an
// even pixel, from where on the row has `left` ones.
FN void blend_two(const Enlarged& one, const Enlarged& two, size_t first, int left,
                  const Enlarging& of, Pair (&staged)[3 * ACROSS]) {
    const float darken = 1.0f / of.params.at[EXPOSURE];
    const float current[6] = {one.colour.r, one.colour.g, one.colour.b,
                              two.colour.r, two.colour.g, two.colour.b};
    // others read what the last one reads, and write nothing
    const int place = min(2 * int(threadIdx.x), left - 2);
    Pair light[3], shown[3];
    UNROLL for (int i = 0; i < 3; i++) light[i] = pair(of.warped, 3 * (first + place) / 2 + i);
    UNROLL for (int i = 0; i < 3; i++) {
        light[i] = {blended(current[2 * i], 2 * i < 3 ? one.kept : two.kept, light[i].x),
                    blended(current[2 * i + 1], 2 * i + 1 < 3 ? one.kept : two.kept, light[i].y)};
        shown[i] = {expm1_of(light[i].x) * darken, expm1_of(light[i].y) * darken};
    }
    put_row(staged, light, &pair(of.history, 3 * first / 2), 3 * left / 2);
    put_row(staged, shown, &pair(of.output, 3 * first / 2), 3 * left / 2);
}

// A thread makes 2x2 pixels of the output, of which `guide_at` tells what guides say: at once where
// they have a render pixel in common.
template <class Number, Multiplied BY, class GuideAt>
FN void resolve(const Enlarging& of, GuideAt guide_at) {
    __shared__ Pair staged[DOWN][3 * ACROSS];
    const Window& part = of.part;
    const int height = of.output.size[0], width = of.output.size[1];
    const int start = 2 * ACROSS * blockIdx.x;
    const int y = 2 * (blockIdx.y * DOWN + threadIdx.y), x = start + 2 * threadIdx.x;
    if (y >= height) return;
    if (is_doubled(part)) {
        const int v = min(part.out_top + y, part.height - 2),
                  u = min(part.out_left + x, part.width - 2);
        const Guide guides[4] = {guide_at(v, u), guide_at(v, u + 1), guide_at(v + 1, u),
                                 guide_at(v + 1, u + 1)};
        Enlarged found[4];
        enlarged_four<Number, BY>(u, v, of, guides, found);
        const size_t first = size_t(y) * width + start;
        Pair(&own)[3 * ACROSS] = staged[threadIdx.y];
        blend_two(found[0], found[1], first, width - start, of, own);
        blend_two(found[2], found[3], first + width, width - start, of, own);
        return;
    }
    AS_IT_IS for (int k = 0; k < 4; k++) {
        const int j = y + k / 2, i = x + k % 2;
        if (j >= height || i >= width) continue;
        const int v = min(part.out_top + j, part.height - 1),
                  u = min(part.out_left + i, part.width - 1);
        blend_pixel(enlarged<Number, BY>(u, v, of, guide_at(v, u)), size_t(j) * width + i, of);
    }
}

// Enlarges, sharpens and blends with the past: radiance (3, th + 2, tw + 2), fine (1, 80, hp, wp),
// moved (th, tw, 2), past (th, tw, 4), warped (out_th, out_tw, 3), params (4,), window (8,),
// keep -> output, next_history (out_th, out_tw, 3).
template <class Number>
__global__ void __launch_bounds__(256, 2)
    denoise_upsample(View radiance, View fine, View moved, View past, View warped, View params,
                     View window, View keep, View output, View next_history) {
    resolve<Number, BY_NOTHING>({window_of(window), radiance, fine, moved, past, warped, params,
                                 keep, output, next_history},
                                [](int, int) { return Guide{}; });
}

// Enlarges radiance without reflectance times the guides', as far as these are trusted, and for the
// rest with that of the render size; sharpens it and blends with the past: radiance (6, th + 2,
// tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2), past (th, tw, 4), warped (out_th, out_tw, 3),
// guide_diffuse_albedo, guide_specular_albedo (height, width, 3), trust (cells, cells, 1), params
// (4,), window (8,), keep -> output, next_history (out_th, out_tw, 3).

// Where an output pixel's centre lies among the cells along a side, from centre to centre.
FN Between cells_at(int position, int size, int out_size, int first, int count) {
    float offset;
    const int at = clip(centre(position, size, out_size, offset) - first, count);
    return between_cells((at + offset + 0.5f) / TRUST_CELL - 0.5f,
                         (min(count, size - first) - 1) / TRUST_CELL + 1);
}

template <class Number>
__global__ void __launch_bounds__(256, 2)
    denoise_upsample_guided(View radiance, View fine, View moved, View past, View warped,
                            View guide_diffuse_albedo, View guide_specular_albedo, View trust,
                            View params, View window, View keep, View output, View next_history) {
    const Window part = window_of(window);
    const auto guide_at = [&](int v, int u) -> Guide {
        return {demodulation(guide_diffuse_albedo, guide_specular_albedo, v, u),
                between(trust, cells_at(v, part.h, part.height, part.top, moved.size[0]),
                        cells_at(u, part.w, part.width, part.left, moved.size[1]))};
    };
    resolve<Number, BY_GUIDES>(
        {part, radiance, fine, moved, past, warped, params, keep, output, next_history}, guide_at);
}

// At the render size, where samples lie at the centres of the output's pixels: radiance without
// reflectance, which is multiplied after they are weighed, so that texture of one pixel is not
// resampled; else radiance that already holds it. radiance (6, th + 2, tw + 2), fine (1, 80, hp,
// wp), moved (th, tw, 2), past (th, tw, 4), warped (out_th, out_tw, 3), factor (th, tw, 3), params
// (4,), window (8,), keep -> output, next_history (out_th, out_tw, 3).
template <class Number>
__global__ void denoise_upsample_unscaled(View radiance, View fine, View moved, View past,
                                          View warped, View factor, View params, View window,
                                          View keep, View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1),
              u = min(part.out_left + x, part.width - 1);
    const bool centred = params.at[JITTER_X] == 0.0f && params.at[JITTER_Y] == 0.0f;
    const size_t own = size_t(clip(v - part.top, factor.size[0])) * factor.size[1]
                       + clip(u - part.left, factor.size[1]);
    const Guide guide = {centred ? three(factor.at + 3 * own) : Colour{1.0f, 1.0f, 1.0f}, 1.0f};
    Enlarging of = {part, radiance, fine, moved, past, warped, params, keep, output, next_history};
    if (!centred) of.radiance.at += 3 * size_t(radiance.size[1]) * radiance.size[2];
    blend_pixel(enlarged<Number, BY_OWN>(u, v, of, guide), y * width + x, of);
}

// A picture that the network gives itself, blended with the past: picture (1, 3, hp, wp),
// log-encoded, controls (1, 11, hp, wp), of which the first is the picture's share, moved (th, tw,
// 2), past (th, tw, 4), warped (out_th, out_tw, 3), params (4,), window (8,), keep -> output,
// next_history (out_th, out_tw, 3).
extern "C" __global__ void denoise_blend_picture(View picture, View controls, View moved, View past,
                                                 View warped, View params, View window, View keep,
                                                 View output, View next_history) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int v = min(part.out_top + y, part.height - 1),
              u = min(part.out_left + x, part.width - 1);
    const int row = clip(v - part.top, moved.size[0]), column = clip(u - part.left, moved.size[1]);
    const size_t plane = size_t(picture.size[2]) * picture.size[3],
                 at = size_t(row) * picture.size[3] + column;
    const float* const motion = moved.at + 2 * (row * moved.size[1] + column);
    const bool held = was_inside(u + motion[0], v + motion[1], part)
                      && past.at[4 * (row * moved.size[1] + column) + 3] >= 0.0f;
    const float kept = held ? share_of(keep, row, column) * (1.0f - controls.at[at]) : 0.0f;
    const Enlarged found = {{fmaxf(picture.at[at], 0.0f), fmaxf(picture.at[plane + at], 0.0f),
                             fmaxf(picture.at[2 * plane + at], 0.0f)}, kept};
    blend_pixel(found, size_t(y) * width + x,
                {part, {}, {}, moved, past, warped, params, keep, output, next_history});
}

// Enlarges light of n parts of the picture and blends it with the last outputs, where their pixels
// are now, all linear: radiance (3 n, th + 2, tw + 2), fine (1, 80, hp, wp), moved (th, tw, 2),
// past (th, tw, 4), last (n, height, width, 3), params (4,), window (8,), keep, out_rows (out_th,),
// out_columns (out_tw,) -> light (n, out_th, out_tw, 3).
FN float blended_light(float current, float kept, float before, float darken) {
    const float now = current <= MAX_FLOAT ? current * darken : 0.0f,
                held = before < 0.0f ? 0.0f : before;
    const float mixed = now + (held - now) * kept;  // NaN, which is not below 0, is recognised
    return mixed <= MAX_FLOAT ? fmaxf(mixed, 0.0f) : now;
}

// One pixel of a part; `to` is the part's first one.
FN void blend_light(const Enlarged& found, int v, int u, const Window& part, const float* picture,
                    const View& moved, float darken, float* to) {
    Colour before = {0.0f, 0.0f, 0.0f};
    if (found.kept > 0.0f)
        before = moved_picture(picture, {part.height, part.width}, before_of(v, u, part, moved));
    to[0] = blended_light(found.colour.r, found.kept, before.r, darken);
    to[1] = blended_light(found.colour.g, found.kept, before.g, darken);
    to[2] = blended_light(found.colour.b, found.kept, before.b, darken);
}

// A thread makes 2x2 pixels: at once where they have a render pixel in common.
template <class Number>
__global__ void __launch_bounds__(256, 2)
    denoise_upsample_light(View radiance, View fine, View moved, View past, View last, View params,
                           View window, View keep, View out_rows, View out_columns, View light) {
    const int height = light.size[1], width = light.size[2];
    const int y = 2 * (blockIdx.y * blockDim.y + threadIdx.y),
              x = 2 * (blockIdx.x * blockDim.x + threadIdx.x);
    if (y >= height || x >= width) return;
    const Window part = window_of(window);
    const float darken = 1.0f / params.at[EXPOSURE];
    const bool doubled = is_doubled(part);
    Enlarging of = {part, radiance, fine, moved, past, {}, params, keep, {}, {}};
    for (int k = 0; k < light.size[0]; k++) {
        of.radiance.at = radiance.at + size_t(3) * k * radiance.size[1] * radiance.size[2];
        const float* const picture = last.at + size_t(3) * k * part.height * part.width;
        float* const to = light.at + 3 * ((size_t(k) * height + y) * width + x);
        if (doubled) {
            const int v = min(int(out_rows.at[y]), part.height - 2),
                      u = min(int(out_columns.at[x]), part.width - 2);
            Enlarged found[4];
            enlarged_four<Number, BY_NOTHING, true>(u, v, of, {}, found);
            UNROLL for (int i = 0; i < 4; i++)
                blend_light(found[i], v + i / 2, u + i % 2, part, picture, moved, darken,
                            to + 3 * (size_t(i / 2) * width + i % 2));
            continue;
        }
        AS_IT_IS for (int i = 0; i < 4; i++) {
            if (y + i / 2 >= height || x + i % 2 >= width) continue;
            const int v = int(out_rows.at[y + i / 2]), u = int(out_columns.at[x + i % 2]);
            const Enlarged found = enlarged<Number, BY_NOTHING, true>(u, v, of);
            blend_light(found, v, u, part, picture, moved, darken,
                        to + 3 * (size_t(i / 2) * width + i % 2));
        }
    }
}

// Rows that spread pictures as a renderer's pixel filter does, and undo it; `postfx.pixel_filter`
// says how.
#include "rows.h"

constexpr float MOST = 1e30f;  // numbers beyond count as this, so that sums stay finite

// Sums of the pixels around each in both directions, by weights that are the same on both sides: of
// the pixel itself, of those beside it, and so on. Beyond the edges lie the pixels at the edge.
struct Weighed {
    Picture image;
    Places weights;
    Long reach, channels, count;
    Room<float> room;

    Weighed(const Picture& image, const Places& weights)
        : image(image), weights(weights), reach(weights.size[0] - 1), channels(image.size[2]),
          count(image.size[1] * image.size[2]), room(count + 2 * reach * channels) {}
    explicit operator bool() const { return bool(room); }

    template <class F> FN_MEMBER F number(Long row, Long i) const {
        return within<F>(load<F>(image(clip(row, image.size[0])) + i), -MOST, MOST);
    }
    void down(Long y, float* line) const {
        across(0, count, EACH(F, Long i) {
            F sum = weights.at[0] * number<F>(y, i);
            for (Long far = 1; far <= reach; far++) {
                sum += weights.at[far] * (number<F>(y - far, i) + number<F>(y + far, i));
            }
            store<F>(line + i, sum);
        });
        for (Long i = 1; i <= reach * channels; i++) {
            line[-i] = line[(channels - i % channels) % channels];
            line[count - 1 + i] = line[count - channels + (i - 1) % channels];
        }
    }
    // The sums of a row: pixels(F(), i, sums) takes those from number i on.
    template <class Pixels> void row(Long y, const Pixels& pixels) const {
        float* line = room.at + reach * channels;
        down(y, line);
        across(0, count, EACH(F, Long i) {
            F sum = weights.at[0] * load<F>(line + i);
            for (Long far = 1; far <= reach; far++) {
                const Long apart = far * channels;
                sum += weights.at[far] * (load<F>(line + i - apart) + load<F>(line + i + apart));
            }
            pixels(F(), i, sum);
        });
    }
};

// Rows of numbers made of the sums: make(F(), y, i, sum) gives those from i on.
template <class Make>
FN Status each_sum(Long first, Long last, const Picture& image, const Places& weights,
                   const NewPicture& output, const Make& make) {
    const Weighed sums(image, weights);
    if (!sums) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        sums.row(y, EACH(F, Long i, F sum) { store<F>(output(y) + i, make(F(), y, i, sum)); });
    }
    return DONE;
}

static Status spread_rows(Long first, Long last, Picture plane, Places weights, NewPicture output) {
    const auto kept = EACH(F, Long, Long, F sum) { return sum; };
    return each_sum(first, last, plane, weights, output, kept);
}
EXPORT(spread_plane, spread_rows)

// The same where no light is below 0 that was not, nor farther below.
static Status undo_rows(Long first, Long last, Picture light, Places weights, NewPicture output) {
    return each_sum(first, last, light, weights, output, EACH(F, Long y, Long i, F sum) {
        return larger<F>(sum, smaller<F>(load<F>(light(y) + i), 0.0f));
    });
}
EXPORT(undo_spread, undo_rows)

// Light that comes nearer to what gives the given light when it is spread.
static Status approach_rows(Long first, Long last, Picture light, Picture undone, Places weights,
                            NewPicture output) {
    return each_sum(first, last, undone, weights, output, EACH(F, Long y, Long i, F sum) {
        const F wanted = load<F>(light(y) + i);
        const F found = load<F>(undone(y) + i) + (wanted - sum);
        return larger<F>(found, smaller<F>(wanted, 0.0f));
    });
}
EXPORT(approach_spread, approach_rows)

// The most light of a pixel and the eight around it, of a row of a picture of three channels.
static void brightest_around(const Picture& picture, Long y, float* column, float* output) {
    const Long width = picture.size[1];
    across(0, width, EACH(F, Long x) {
        F most = -MOST;
        for (Long row = y - 1; row <= y + 1; row++) {
            const float* at = picture(clip(row, picture.size[0])) + 3 * x;
            most = larger<F>(most, pick<F, 3>(at) + pick<F, 3>(at + 1) + pick<F, 3>(at + 2));
        }
        store<F>(column + 1 + x, most);
    });
    repeat_edges(column, width);
    across(0, width, EACH(F, Long x) {
        const F beside = larger<F>(load<F>(column + x), load<F>(column + x + 2));
        store<F>(output + x, larger<F>(beside, load<F>(column + x + 1)));
    });
}

// Denoised light, spread, and as much of what undoing lost as the denoised picture is as bright
// there as the noisy one: all of it at a lamp, little at a firefly.
static Status finish_rows(Long first, Long last, Picture light, Picture undone, Picture denoised,
                          Places weights, NewPicture output) {
    const Weighed sums(denoised, weights), noisy(undone, weights);
    const Long width = output.size[1], count = 3 * width;
    const Room<float> room(count + 3 * width + 2);
    if (!sums || !noisy || !room) return NO_MEMORY;
    float *lost = room.at, *clean = lost + count, *most = clean + width, *column = most + width;
    for (Long y = first; y < last; y++) {
        const float* given = light(y);
        float* out = output(y);
        noisy.row(y, EACH(F, Long i, F sum) { store<F>(lost + i, load<F>(given + i) - sum); });
        sums.row(y, EACH(F, Long i, F sum) { store<F>(out + i, sum); });
        brightest_around(denoised, y, column, clean);
        brightest_around(undone, y, column, most);
        for (Long x = 0; x < width; x++) {
            const float share = most[x] > 0.0f ? within<float>(clean[x] / most[x], 0.0f, 1.0f)
                                               : 0.0f;
            for (int c = 0; c < 3; c++) out[3 * x + c] += share * lost[3 * x + c];
        }
    }
    return DONE;
}
EXPORT(finish_spread, finish_rows)

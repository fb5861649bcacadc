// Heads of the network in the layout of the other kernels: of floats, of integer sums, of codes.
#include "fine_codes.h"
#include "../half.h"
#include "store.h"

typedef View<const int, 4> Products;
typedef View<const half, 4> Halves;
typedef View<float, 4> Heads;

// A channel's row of a head: logit(F(), x) gives its numbers from x on. Of the fine head, a row has
// two of them in turn.
template <class Logit>
FN void open_row(Meaning meaning, Long count, float* out, const Logit& logit) {
    with_meaning(meaning, PIXELS(auto meaning) {
        across(0, count, EACH(F, Long x) {
            store<F>(out + x, opened<F, meaning.is>(logit(F(), x)));
        });
    });
}
template <class Left, class Right>
FN void open_pairs(Meaning meaning, Long count, float* out, const Left& left, const Right& right) {
    with_meaning(meaning, PIXELS(auto meaning) {
        across(0, count, EACH(F, Long x) {
            const F a = left(F(), x), b = right(F(), x);
            store_pairs<F>(out + 2 * x, opened<F, meaning.is>(a), opened<F, meaning.is>(b));
        });
    });
}

// In half precision, with all channels of a pixel together: two of them are one word.
constexpr int HALVES = 2;

// Planes, and zeros for further channels.
static Status pack_rows(Long first, Long last, View<const float, 4> planes, View<half, 4> packed) {
    const Long w = packed.size[2], channels = planes.size[1], words = packed.size[3] / HALVES;
    const Room<int> turned(words * w);
    if (!turned) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        for (Long k = 0; k < words; k++) {
            const Long low = HALVES * k, high = low + 1;
            int* to = turned.at + k * w;
            across(0, w, EACH(F, Long x) {
                typename Of<F>::Int word = {};
                if (low < channels) word = to_half<F>(load<F>(planes(0, low, y) + x));
                if (high < channels) word |= to_half<F>(load<F>(planes(0, high, y) + x)) << 16;
                store_int<F>(to + x, word);
            });
        }
        turn_words<0>(turned.at, words, w, (int*)packed(0, y));
    }
    return DONE;
}
EXPORT_ALONE(denoise_pack, pack_rows)

// Words of pixels, which lie a step apart, as rows of words.
FN void turn_pixels(const half* pixels, Long step, Long words, Long count, int* turned) {
    for (Long x = 0; x < count; x++) {
        for (Long k = 0; k < words; k++) {
            __builtin_memcpy(turned + k * count + x, pixels + x * step + HALVES * k, sizeof(int));
        }
    }
}
template <class F> FN F channel_of(const int* turned, Long channel, Long count, Long x) {
    const typename Of<F>::Int word = load_int<F>(turned + channel / HALVES * count + x);
    return from_half<F>(channel % HALVES ? (word >> 16) & 0xFFFF : word & 0xFFFF);
}

// Of a level: weights of its filters and its mix, which means nothing at the coarsest level.
static Status open_rows(Long first, Long last, Halves raw, Heads heads) {
    const Long w = heads.size[3], channels = heads.size[1], step = raw.size[3];
    const Room<int> turned(step / HALVES * w);
    if (!turned) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        turn_pixels(raw(0, y), step, step / HALVES, w, turned.at);
        for (Long channel = 0; channel < channels; channel++) {
            open_row(level_meaning(channel), w, heads(0, channel, y), EACH(F, Long x) {
                return channel_of<F>(turned.at, channel, w, x);
            });
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_open, open_rows)

// Of the fine head, whose four phases of 2x2 pixels lie one after the other.
static Status open_fine_rows(Long first, Long last, Halves raw, Heads fine) {
    const Long w = raw.size[2], step = raw.size[3], words = FINE / HALVES;
    const Room<int> turned(2 * words * w);
    if (!turned) return NO_MEMORY;
    int *const left = turned.at, *const right = left + words * w;
    for (Long y = first; y < last; y++) {
        const half* from = raw(0, y / 2) + 2 * (y % 2) * FINE;
        turn_pixels(from, step, words, w, left);
        turn_pixels(from + FINE, step, words, w, right);
        for (Long channel = 0; channel < FINE; channel++) {
            open_pairs(fine_meaning(channel), w, fine(0, channel, y),
                       EACH(F, Long x) { return channel_of<F>(left, channel, w, x); },
                       EACH(F, Long x) { return channel_of<F>(right, channel, w, x); });
        }
    }
    return DONE;
}
EXPORT_ALONE(denoise_open_fine, open_fine_rows)

// In float32.

// Of the fine head, each channel has its four phases of 2x2 pixels one after the other.

static void open_phased_rows(Long first, Long last, View<const float, 4> phased, Heads fine) {
    for (Long channel = 0; channel < FINE; channel++) {
        for (Long y = first; y < last; y++) {
            const Long phase = 4 * channel + 2 * (y % 2);
            const float *left = phased(0, phase, y / 2), *right = phased(0, phase + 1, y / 2);
            open_pairs(fine_meaning(channel), phased.size[3], fine(0, channel, y),
                       EACH(F, Long x) { return load<F>(left + x); },
                       EACH(F, Long x) { return load<F>(right + x); });
        }
    }
}
EXPORT_ALONE(denoise_open_phased, open_phased_rows)

// The expected squared error of a part's pixels; of one that is unknown, the largest.
static void open_error_row(Long y, View<const float, 4> log_error, Places, Places,
                           View<float, 3> error) {
    const float* from = log_error(0, 0, y);
    float* to = error(y);
    across(0, error.size[1], EACH(F, Long x) {
        const F log = known<F>(load<F>(from + x));
        store<F>(to + x, exp_of<F>(within<F>(log, LEAST_LOG_ERROR, MOST_LOG_ERROR)));
    });
}
EXPORT_ALONE(denoise_open_error, open_error_row)

static void open_channels(Long first, Long last, const Products& products, const Scaling& scaling,
                          Long begin, const Heads& fine) {
    for (Long k = 0; k < fine.size[1]; k++) {
        for (Long y = first; y < last; y++) {
            const Long channel = begin + k, phase = 2 * (y % 2);
            const Scale even = scale_of(scaling, 4 * channel + phase);
            const Scale odd = scale_of(scaling, 4 * channel + phase + 1);
            const int* left = products(0, 4 * k + phase, y / 2);
            const int* right = products(0, 4 * k + phase + 1, y / 2);
            open_pairs(fine_meaning(channel), products.size[3], fine(0, k, y),
                       EACH(F, Long x) { return logit_of<F>(load_int<F>(left + x), even); },
                       EACH(F, Long x) { return logit_of<F>(load_int<F>(right + x), odd); });
        }
    }
}

static void open_fine_products_rows(Long first, Long last, Products products, Scaling scaling,
                                    Heads fine) {
    open_channels(first, last, products, scaling, 0, fine);
}
EXPORT_ALONE(denoise_open_fine_products, open_fine_products_rows)

static void open_some_products_rows(Long first, Long last, Products products, Scaling scaling,
                                    View<const float, 1> begin, Heads fine) {
    open_channels(first, last, products, scaling, Long(begin.at[0]), fine);
}
EXPORT_ALONE(denoise_open_some_products, open_some_products_rows)

// Weights of a level's filters and its mix, which the coarsest level lacks.

static void open_products_rows(Long first, Long last, Products products, Scaling scaling,
                               Heads heads) {
    for (Long channel = 0; channel < heads.size[1]; channel++) {
        for (Long y = first; y < last; y++) {
            const Scale scale = scale_of(scaling, channel);
            const int* sums = products(0, channel, y);
            open_row(level_meaning(channel), heads.size[3], heads(0, channel, y),
                     EACH(F, Long x) { return logit_of<F>(load_int<F>(sums + x), scale); });
        }
    }
}
EXPORT_ALONE(denoise_open_products, open_products_rows)

static Status open_codes_rows(Long first, Long last, Codes codes, Factors factors, Scaling scaling,
                              Heads heads) {
    const Long w = heads.size[3], channels = heads.size[1];
    const Room<int> turned(room_for(codes));
    if (!turned) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        multiply_row(codes(0, y), w, codes.size[3], factors.at, 0, (channels + 3) / 4, turned.at,
                     PIXELS(Long k, Long x, const WideInt(&sums)[4]) {
            UNROLL for (int j = 0; j < 4; j++) {
                const Long channel = 4 * k + j;
                if (channel >= channels) continue;
                with_meaning(level_meaning(channel), PIXELS(auto meaning) {
                    const Wide logit = logit_of<Wide>(sums[j], scale_of(scaling, channel));
                    const Wide found = opened<Wide, meaning.is>(logit);
                    float* out = heads(0, channel, y) + x;
                    if (x + WIDE <= w) store<Wide>(out, found);
                    else AS_IT_IS for (int i = 0; i < w - x; i++) out[i] = found[i];
                });
            }
        });
    }
    return DONE;
}
EXPORT_ALONE(denoise_open_codes, open_codes_rows)

// The last channels of the fine head, or all of them.
static Status open_fine_codes_rows(Long first, Long last, Codes codes, Factors factors,
                                   Scaling scaling, View<float, 5> fine) {
    const Long begin = FINE - fine.size[1], step = fine.size[2] * fine.size[3] * fine.size[4];
    const Room<int> turned(room_for(codes));
    if (!turned) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        open_fine_row(codes, y, factors, scaling, begin, FINE, turned.at, fine(0, 0, y), step);
    }
    return DONE;
}
EXPORT_ALONE(denoise_open_fine_codes, open_fine_codes_rows)

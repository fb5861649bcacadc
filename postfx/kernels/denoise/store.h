// Planes in 8 bits, all channels of a pixel together, for a network of integers.
#pragma once
#include "../rows.h"

// codes that are put together as one whole number, the first in its lowest bits
constexpr int WORD = 4;

// Each channel's factor and its code of zero.
typedef View<const float, 2> CodingOf;

// NaN gets the code of zero. The product is rounded before the sum, as the portable definition
// does.
template <class F> FN typename Of<F>::Int code_of(F value, float scale, float zero) {
    _Pragma("clang fp contract(off)");
    return whole(within<F>(known<F>(value) * scale + zero + 0.5f, 0.0f, 255.0f));
}
FN int zero_word(const CodingOf& coding, Long first) {
    int word = 0;
    for (int i = 0; i < WORD; i++) word |= int(coding(1)[first + i]) << 8 * i;
    return word;
}

// Codes of zero for all channels of pixels.
FN void store_zeros(const CodingOf& coding, Long count, int* pixels) {
    const Long words = coding.size[1] / WORD;
    for (Long k = 0; k < words; k++) {
        const int word = zero_word(coding, WORD * k);
        for (Long x = 0; x < count; x++) pixels[words * x + k] = word;
    }
}

// Words of one to four planes of a row, which lie a step apart; codes of zero stand in `nothing`.
template <int PLANES>
FN void store_word(const float* planes, Long step, const float* scales, const float* zeros,
                   int nothing, Long count, int* to) {
    across(0, count, EACH(F, Long x) {
        typename Of<F>::Int word = typename Of<F>::Int(PLANES < WORD ? nothing & -1 << 8 * PLANES
                                                                     : 0);
        UNROLL for (int i = 0; i < PLANES; i++) {
            word |= code_of<F>(load<F>(planes + i * step + x), scales[i], zeros[i]) << 8 * i;
        }
        store_int<F>(to + x, word);
    });
}

// Rows of words as pixels of words.
template <int WORDS> FN void turn_words(const int* turned, Long words, Long count, int* pixels) {
    const Long some = WORDS > 0 ? WORDS : words;
    for (Long x = 0; x < count; x++) {
        for (Long k = 0; k < some; k++) pixels[some * x + k] = turned[k * count + x];
    }
}

// Codes of a row of planes, which lie a step apart; further channels get codes of zero. `turned`
// has room for a word of each pixel's channels.
FN void store_codes(const float* planes, Long step, Long channels, const CodingOf& coding,
                    Long count, int* turned, int* pixels) {
    const Long words = coding.size[1] / WORD;
    for (Long k = 0; k < words; k++) {
        const Long first = WORD * k, left = channels - first;
        const float *from = planes + first * step, *scales = coding(0) + first,
                    *zeros = coding(1) + first;
        const int nothing = zero_word(coding, first);
        int* to = turned + k * count;
        if (left >= 4) store_word<4>(from, step, scales, zeros, nothing, count, to);
        else if (left == 3) store_word<3>(from, step, scales, zeros, nothing, count, to);
        else if (left == 2) store_word<2>(from, step, scales, zeros, nothing, count, to);
        else if (left == 1) store_word<1>(from, step, scales, zeros, nothing, count, to);
        else for (Long x = 0; x < count; x++) to[x] = nothing;
    }
    if (words == 9) turn_words<9>(turned, words, count, pixels);  // features
    else if (words == 11) turn_words<11>(turned, words, count, pixels);  // guides
    else turn_words<0>(turned, words, count, pixels);
}

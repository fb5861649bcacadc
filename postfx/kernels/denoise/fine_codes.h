// The fine head of codes, for the kernels that make it as they go.
#pragma once
#include "codes.h"
#include "network_io.h"
#include "../rows.h"

typedef View<const byte, 4> Codes;
typedef View<const sbyte, 2> Factors;
typedef View<const float, 2> Scaling;

FN Scale scale_of(const Scaling& scaling, Long channel) {
    return {scaling(0)[channel], scaling(1)[channel]};
}

// How many whole numbers `turn_codes` needs.
FN Long room_for(const Codes& codes) { return codes.size[3] / 4 * COLUMNS; }

// Channels `first` to `last` - 1 of the fine head, of a row of codes: the two rows of a channel lie
// one after the other at fine + (channel - first) * step.
FN void open_fine_row(const Codes& codes, Long row, const Factors& factors, const Scaling& scaling,
                      Long first, Long last, int* turned, float* fine, Long step) {
    const Long w = codes.size[2];
    multiply_row(codes(0, row), w, codes.size[3], factors.at, first, last, turned,
                 PIXELS(Long channel, Long x, const WideInt(&sums)[4]) {
        float* out = fine + (channel - first) * step + 2 * x;
        with_meaning(fine_meaning(channel), PIXELS(auto meaning) {
            UNROLL for (int lower = 0; lower < 2; lower++) {
                const Scale left = scale_of(scaling, 4 * channel + 2 * lower);
                const Scale right = scale_of(scaling, 4 * channel + 2 * lower + 1);
                const Wide even = opened<Wide, meaning.is>(logit_of<Wide>(sums[2 * lower], left));
                const Wide odd =
                    opened<Wide, meaning.is>(logit_of<Wide>(sums[2 * lower + 1], right));
                float* to = out + lower * 2 * w;
                if (x + WIDE <= w) {
                    store_pairs<Wide>(to, even, odd);
                } else {
                    for (int i = 0; i < w - x; i++) to[2 * i] = even[i], to[2 * i + 1] = odd[i];
                }
            }
        });
    });
}

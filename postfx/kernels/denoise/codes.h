// Products of 8-bit codes and 7-bit factors, by the instructions that a level has for them.
#pragma once
#include "../number.h"

// vectors of columns at once: sums fill half of the registers
constexpr int BLOCK = WIDE == 16 ? 4 : 2;
constexpr int COLUMNS = BLOCK * WIDE;
#if defined(__AVX512F__)
#define EACH_OF_BLOCK AS_IT_IS
#else
#define EACH_OF_BLOCK UNROLL  // two of them are worth their code
#endif

#if defined(__AVX2__)
typedef char Bytes __attribute__((vector_size(4 * WIDE)));
typedef short Shorts __attribute__((vector_size(4 * WIDE)));
typedef int Ints __attribute__((vector_size(4 * WIDE)));
#endif

// total + the four products of unsigned codes and signed factors in each number. Factors are at
// most 64: without VNNI, two products are added in 16 bits.
FN WideInt add_products(WideInt total, WideInt codes, WideInt factors) {
#if defined(__AVX512VNNI__)
    return (WideInt)__builtin_ia32_vpdpbusd512((Ints)total, __builtin_bit_cast(Bytes, codes),
                                               __builtin_bit_cast(Bytes, factors));
#elif defined(__AVX512BW__)
    const Shorts ones = Shorts{} + 1;
    const Shorts twos = __builtin_ia32_pmaddubsw512(__builtin_bit_cast(Bytes, codes),
                                                    __builtin_bit_cast(Bytes, factors));
    return total + __builtin_bit_cast(WideInt, __builtin_ia32_pmaddwd512(twos, ones));
#elif defined(__AVX2__)
    const Shorts ones = Shorts{} + 1;
    const Shorts twos = __builtin_ia32_pmaddubsw256(__builtin_bit_cast(Bytes, codes),
                                                    __builtin_bit_cast(Bytes, factors));
    return total + __builtin_bit_cast(WideInt, __builtin_ia32_pmaddwd256(twos, ones));
#else
    for (int i = 0; i < 4; i++) {
        total += ((codes >> 8 * i) & 255) * ((factors << (24 - 8 * i)) >> 24);
    }
    return total;
#endif
}

// Codes of a row (w, channels) from column x on, as columns of four codes: (channels / 4, COLUMNS).
FN void turn_codes(const byte* codes, Long x, Long w, Long channels, int* turned) {
    const Long count = w - x < COLUMNS ? w - x : COLUMNS;
    for (Long n = 0; n < count; n++) {
        const byte* pixel = codes + (x + n) * channels;
        for (Long group = 0; group < channels / 4; group++) {
            __builtin_memcpy(turned + group * COLUMNS + n, pixel + 4 * group, 4);
        }
    }
}

// Sums of four rows of factors, for a row's codes: use(k, x, sums) for each four from `first` on
// and each vector of columns.
template <class Use>
FN void multiply_row(const byte* codes, Long w, Long channels, const sbyte* factors, Long first,
                     Long last, int* turned, const Use& use) {
    for (Long x = 0; x < w; x += COLUMNS) {
        turn_codes(codes, x, w, channels, turned);
        for (Long k = first; k < last; k++) {
            WideInt sums[4][BLOCK] = {};
            for (Long group = 0; group < channels / 4; group++) {
                UNROLL for (int j = 0; j < 4; j++) {
                    int four;
                    __builtin_memcpy(&four, factors + (4 * k + j) * channels + 4 * group, 4);
                    UNROLL for (int b = 0; b < BLOCK; b++) {
                        const int* seen = turned + group * COLUMNS + b * WIDE;
                        sums[j][b] = add_products(sums[j][b], load_int<Wide>(seen), (WideInt)four);
                    }
                }
            }
            WideInt found[BLOCK][4];  // not those above, which stay in registers
            UNROLL for (int b = 0; b < BLOCK; b++) {
                UNROLL for (int j = 0; j < 4; j++) found[b][j] = sums[j][b];
            }
            EACH_OF_BLOCK for (int b = 0; b < BLOCK; b++) {
                if (x + b * WIDE < w) use(k, x + b * WIDE, found[b]);
            }
        }
    }
}

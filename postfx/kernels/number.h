// Numbers that pixel functions are written in: F is one float, or a vector of floats, as many as
// the processor takes at once. + - * / < and a ? b : c mean the same for both.
//
// Bits. a + b * c in one expression is one instruction wherever a processor has it, and sums are
// never put into another order: so AVX2, AVX-512, arm64 and Windows give the same bits.
//
// NaN and infinity. A comparison with NaN is false, and larger() and smaller() then give their
// second argument. So within() makes the low bound of NaN, and bounded() leaves it. Everything else
// carries NaN and infinity on, into the pixels that are made of them and into no others. The
// functions at the end take numbers within the bounds that they name; beyond them, only NaN stays
// what it is.
#pragma once

typedef long long Long;
typedef unsigned char byte;
typedef signed char sbyte;

#define FN static inline __attribute__((always_inline))
// Work of a row that several places ask for: compiled once.
#define ONCE static __attribute__((noinline))
#define FN_MEMBER __attribute__((always_inline))
#define UNROLL _Pragma("clang loop unroll(full)")
// A loop that few pixels or none pass: one copy of its body is enough.
#define AS_IT_IS _Pragma("clang loop vectorize(disable) interleave(disable) unroll(disable)")

#if defined(__AVX512F__)
constexpr int WIDE = 16;
#elif defined(__AVX2__)
constexpr int WIDE = 8;
#else
constexpr int WIDE = 4;
#endif
typedef float Wide __attribute__((ext_vector_type(WIDE)));
typedef int WideInt __attribute__((ext_vector_type(WIDE)));
// As many at every level.
typedef float Four __attribute__((ext_vector_type(4)));
typedef float Eight __attribute__((ext_vector_type(8)));
typedef float Sixteen __attribute__((ext_vector_type(16)));

template <class F> struct Of;
template <> struct Of<float> {
    typedef int Int;
    enum { COUNT = 1 };
};
template <> struct Of<Wide> {
    typedef WideInt Int;
    enum { COUNT = WIDE };
};

// Bits and whole numbers.

FN int bits(float x) { return __builtin_bit_cast(int, x); }
FN float from_bits(int x) { return __builtin_bit_cast(float, x); }
FN int whole(float x) { return int(x); }
FN float number(int x) { return float(x); }
FN float floor_of(float x) { return __builtin_floorf(x); }

FN float nearest_of(float x) { return __builtin_rintf(x); }
FN float root_of(float x) { return __builtin_sqrtf(x); }

FN WideInt bits(Wide x) { return __builtin_bit_cast(WideInt, x); }
FN Wide from_bits(WideInt x) { return __builtin_bit_cast(Wide, x); }
FN WideInt whole(Wide x) { return __builtin_convertvector(x, WideInt); }
FN Wide number(WideInt x) { return __builtin_convertvector(x, Wide); }
FN Wide floor_of(Wide x) { return __builtin_elementwise_floor(x); }
FN Wide nearest_of(Wide x) { return __builtin_elementwise_rint(x); }
FN Wide root_of(Wide x) { return __builtin_elementwise_sqrt(x); }

// Memory: numbers beside one another, every STEP-th of them, and each of them twice.

template <class F> FN F load(const void* at) {
    F x;
    __builtin_memcpy(&x, at, sizeof x);
    return x;
}
template <class F> FN void store(void* at, F x) { __builtin_memcpy(at, &x, sizeof x); }
// The same past the caches, where it can be, for pictures that are larger than they are. Other
// threads see it after `settle`.
template <class F> FN void store_past(float* at, F x) {
    if ((__UINTPTR_TYPE__)at % sizeof x) store<F>(at, x);
    else __builtin_nontemporal_store(x, (F*)at);
}
FN void settle() {
#if defined(__x86_64__)
    __builtin_ia32_sfence();
#endif
}

// Places in a vector, which a compiler that knows them turns into few instructions.
template <class T, T... PLACE> struct List {};
typedef __make_integer_seq<List, int, WIDE> Lanes;
#define TWO_OF(a, b, ...) __builtin_shufflevector(a, b, (__VA_ARGS__)...)

template <int STEP, int... I> FN Wide pick_wide(const float* at, List<int, I...>) {
    constexpr int LAST = STEP * (WIDE - 1) + 1 - WIDE;  // nothing is read behind the last number
    if constexpr (STEP == 2) {
        const Wide a = load<Wide>(at), b = load<Wide>(at + LAST);
        return TWO_OF(a, b, 2 * I < WIDE ? 2 * I : 2 * I - LAST + WIDE);
    } else if constexpr (STEP == 3) {
        const Wide a = load<Wide>(at), b = load<Wide>(at + WIDE), c = load<Wide>(at + LAST);
        const Wide ab = TWO_OF(a, b, 3 * I < 2 * WIDE ? 3 * I : 0);
        return TWO_OF(ab, c, 3 * I < 2 * WIDE ? I : 3 * I - LAST + WIDE);
    } else {
        static_assert(STEP == 4);
        const Wide a = load<Wide>(at), b = load<Wide>(at + WIDE);
        const Wide c = load<Wide>(at + 2 * WIDE), d = load<Wide>(at + LAST);
        const Wide ab = TWO_OF(a, b, 4 * I < 2 * WIDE ? 4 * I : 0);
        const Wide cd = TWO_OF(c, d, 4 * I < 2 * WIDE ? 0
                               : 4 * I < 3 * WIDE ? 4 * I - 2 * WIDE : 4 * I - LAST + WIDE);
        return TWO_OF(ab, cd, I < WIDE / 2 ? I : I + WIDE);
    }
}
template <class F, int STEP> FN F pick(const float* at) {
    if constexpr (Of<F>::COUNT == 1 || STEP == 1) {
        return load<F>(at);
    } else {
        return pick_wide<STEP>(at, Lanes());
    }
}
template <int STEP, class F> FN void spread(float* at, F x) {
    if constexpr (Of<F>::COUNT == 1) {
        *at = x;
    } else {
        for (int i = 0; i < Of<F>::COUNT; i++) at[STEP * i] = x[i];
    }
}

typedef float Half __attribute__((ext_vector_type(WIDE / 2)));
template <int... I> FN Wide twice_wide(Half x, List<int, I...>) { return TWO_OF(x, x, I / 2); }
template <class F> FN F each_twice(const float* at) {
    if constexpr (Of<F>::COUNT == 1) {
        return *at;
    } else {
        return twice_wide(load<Half>(at), Lanes());
    }
}

// Two rows as one of pairs.
template <int... I> FN void store_wide_pairs(float* at, Wide even, Wide odd, List<int, I...>) {
    store<Wide>(at, TWO_OF(even, odd, I / 2 + I % 2 * WIDE));
    store<Wide>(at + WIDE, TWO_OF(even, odd, WIDE / 2 + I / 2 + I % 2 * WIDE));
}
template <class F> FN void store_pairs(float* at, F even, F odd) {
    if constexpr (Of<F>::COUNT == 1) {
        at[0] = even;
        at[1] = odd;
    } else {
        store_wide_pairs(at, even, odd, Lanes());
    }
}

// Three rows as one of triples.
template <int FIRST, int... I>
FN Wide triples_from(Wide a, Wide b, Wide c, List<int, I...>) {
    const Wide ab = TWO_OF(a, b, (FIRST + I) % 3 == 1 ? WIDE + (FIRST + I) / 3 : (FIRST + I) / 3);
    return TWO_OF(ab, c, (FIRST + I) % 3 == 2 ? WIDE + (FIRST + I) / 3 : I);
}
template <class F> FN void store_triples(float* at, F a, F b, F c) {
    if constexpr (Of<F>::COUNT == 1) {
        at[0] = a;
        at[1] = b;
        at[2] = c;
    } else {
        store<Wide>(at, triples_from<0>(a, b, c, Lanes()));
        store<Wide>(at + WIDE, triples_from<WIDE>(a, b, c, Lanes()));
        store<Wide>(at + 2 * WIDE, triples_from<2 * WIDE>(a, b, c, Lanes()));
    }
}

// Two rows of triples as one, a triple of each in turn, stored past the caches.
constexpr int place_in_turn(int i) { return i / 6 * 3 + i % 3; }
constexpr int first_in_turn(int i) {
    const int own = place_in_turn(i), next = place_in_turn(i + 3 - i % 3);
    const int first = own < next ? own : next;
    return first < 2 * WIDE ? first : 2 * WIDE;  // nothing is read behind the last number
}
template <int FIRST, int... I>
FN Wide triples_in_turn(const float* even, const float* odd, List<int, I...>) {
    constexpr int SKIPPED = first_in_turn(FIRST);
    const Wide a = load<Wide>(even + SKIPPED), b = load<Wide>(odd + SKIPPED);
    return TWO_OF(a, b, place_in_turn(FIRST + I) - SKIPPED + (FIRST + I) / 3 % 2 * WIDE);
}
template <int... J> FN void store_in_turn(float* at, const float* even, const float* odd,
                                          List<int, J...>) {
    (store_past<Wide>(at + J * WIDE, triples_in_turn<J * WIDE>(even, odd, Lanes())), ...);
}
template <class F> FN void interleave_triples(float* at, const float* even, const float* odd) {
    if constexpr (Of<F>::COUNT == 1) {
        for (int i = 0; i < 6; i++) at[i] = (i < 3 ? even : odd)[i % 3];
    } else {
        store_in_turn(at, even, odd, __make_integer_seq<List, int, 6>());
    }
}

// Four rows as one of quadruples, which begin a step apart.
template <int FIRST, int... I> FN Wide pairs_from(Wide a, Wide b, List<int, I...>) {
    return TWO_OF(a, b, FIRST + I / 2 + I % 2 * WIDE);
}
template <int FIRST, int... I> FN Wide quads_from(Wide ab, Wide cd, List<int, I...>) {
    return TWO_OF(ab, cd, FIRST + I / 4 * 2 + I % 2 + I % 4 / 2 * WIDE);
}
template <int STEP, int PIXEL> FN void store_quads(float* at, Wide quads) {
    float four[WIDE];
    store<Wide>(four, quads);
    for (int i = 0; i < WIDE / 4; i++)
        __builtin_memcpy(at + STEP * (PIXEL + i), four + 4 * i, sizeof(Four));
}
template <int STEP, class F> FN void spread_four(float* at, F a, F b, F c, F d) {
    if constexpr (Of<F>::COUNT == 1) {
        at[0] = a;
        at[1] = b;
        at[2] = c;
        at[3] = d;
    } else {
        constexpr int HALF = WIDE / 2;
        const Wide low_ab = pairs_from<0>(a, b, Lanes()), high_ab = pairs_from<HALF>(a, b, Lanes());
        const Wide low_cd = pairs_from<0>(c, d, Lanes()), high_cd = pairs_from<HALF>(c, d, Lanes());
        store_quads<STEP, 0>(at, quads_from<0>(low_ab, low_cd, Lanes()));
        store_quads<STEP, WIDE / 4>(at, quads_from<HALF>(low_ab, low_cd, Lanes()));
        store_quads<STEP, HALF>(at, quads_from<0>(high_ab, high_cd, Lanes()));
        store_quads<STEP, HALF + WIDE / 4>(at, quads_from<HALF>(high_ab, high_cd, Lanes()));
    }
}

// Every STEP-th number from places that are given.
template <class F, int STEP = 1> FN F gather(const float* at, const int* places) {
    if constexpr (Of<F>::COUNT == 1) {
        return at[STEP * *places];
    } else {
        F x;
        for (int i = 0; i < Of<F>::COUNT; i++) x[i] = at[STEP * places[i]];
        return x;
    }
}

// first, first + step, first + 2 step ...
template <class F> FN F ramp(float first, float step) {
    if constexpr (Of<F>::COUNT == 1) {
        return first;
    } else {
        F x;
        for (int i = 0; i < Of<F>::COUNT; i++) x[i] = first + step * i;
        return x;
    }
}

template <class F> FN F larger(F x, F other) { return x > other ? x : other; }
template <class F> FN F smaller(F x, F other) { return x < other ? x : other; }
template <class F> FN F within(F x, float low, float high) {
    return smaller<F>(larger<F>(x, F(low)), F(high));
}
template <class F> FN F bounded(F x, float low, float high) {
    return smaller<F>(F(high), larger<F>(F(low), x));
}
template <class F> FN F size_of(F x) { return from_bits(bits(x) & 0x7FFFFFFF); }
template <class F> FN F known(F x) { return x == x ? x : F(0.0f); }
FN int clip(Long x, Long size) { return int(x < 0 ? 0 : x >= size ? size - 1 : x); }

template <class F> FN typename Of<F>::Int load_int(const int* at) {
    return load<typename Of<F>::Int>(at);
}
template <class F> FN void store_int(int* at, typename Of<F>::Int x) { store(at, x); }

// Functions: polynomials of Cephes (Moshier).

// log(x) of a normal x > 0, absolute error below 3e-7.
template <class F> FN F log_of(F x) {
    typedef typename Of<F>::Int I;
    const I all = bits(x);
    const I exponent = (all - 0x3F3504F3) >> 23;
    const F m = from_bits(all - (exponent << 23)) - 1.0f;
    F p = m * 7.0376836292e-2f - 1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m - 1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m - 1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m - 2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    return p * m * m * m - 0.5f * m * m + m + number(exponent) * 0.6931471805599453f;
}

// log2(x) of a normal x > 0, absolute error below 3e-7, in fewer steps: the series of atanh.
template <class F> FN F log2_of(F x) {
    typedef typename Of<F>::Int I;
    const I all = bits(x);
    const I exponent = (all - 0x3F3504F3) >> 23;
    const F m = from_bits(all - (exponent << 23));
    const F z = (m - 1.0f) / (m + 1.0f), q = z * z;
    const F series = z * (1.0f + q * (1 / 3.0f + q * (0.2f + q * (1 / 7.0f))));
    return number(exponent) + 2.885390081777927f * series;
}

// log(1 + x) for x >= 0, relative error below 3e-6: a series below 0.03, where 1 + x would round.
template <class F> FN F log1p_of(F x) {
    const F third = 1 / 3.0f - x * (0.25f - x * 0.2f);
    const F series = x * (1.0f - x * (0.5f - x * third));
    return x < 0.03f ? series : log_of<F>(1.0f + x);
}

// exp(x) = (1 + more) power, for -80 <= x <= 80.
template <class F> struct Exponential {
    F more, power;
};
template <class F> FN Exponential<F> exp_parts(F x) {
    const F n = floor_of(x * 1.4426950408889634f + 0.5f);
    const F r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
    F p = r * 1.9875691500e-4f + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    return {p * r * r + r, from_bits((whole(n) + 127) << 23)};
}

// Relative errors below 2e-7; exp(x) - 1 for x >= 0.
template <class F> FN F exp_of(F x) {
    const Exponential<F> e = exp_parts<F>(x);
    return (e.more + 1.0f) * e.power;
}
template <class F> FN F expm1_of(F x) {
    const Exponential<F> e = exp_parts<F>(x);
    return e.more * e.power + (e.power - 1.0f);
}

// 2^x for -126 <= x <= 127, relative error below 2e-7; exact for whole numbers.
template <class F> FN F exp2_of(F x) {
    const F n = floor_of(x + 0.5f);
    return exp_of<F>((x - n) * 0.6931471805599453f) * from_bits((whole(n) + 127) << 23);
}

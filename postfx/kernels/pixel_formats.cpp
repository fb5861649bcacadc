// Pixels as files hold them: half floats, 8 bits with dither, bytes as PNG and OpenEXR compress
// them. Products and sums are rounded apart, so that files are the same bytes on every processor.
#include "rows.h"
#pragma clang fp contract(off)

typedef unsigned short Word16;
typedef unsigned long long Word64;
typedef byte WideByte __attribute__((ext_vector_type(WIDE)));
typedef Word16 WideWord16 __attribute__((ext_vector_type(WIDE)));

// Half floats.

constexpr int LARGEST = 0x477FE000;  // bits in float32 of 65504, the largest half float
constexpr int INFINITE = 0x7F800000, LEAST_NORMAL = 0x38800000, REBIAS = 0x38000000;
constexpr int SIZE = 0x7FFFFFFF, HALF_SIZE = 0x7FFF, HALF_SIGN = 0x8000;
constexpr int HALF_NAN = 0x7E00, HALF_INFINITE = 0x7C00, HALF_NORMAL = 0x400;
// those below the least normal one are whole numbers over this
constexpr float SUBNORMALS = 1 << 24;

FN void store_words(Word16* at, int x) { *at = Word16(x); }
FN void store_words(Word16* at, WideInt x) {
    const WideWord16 words = __builtin_convertvector(x, WideWord16);
    store(at, words);
}
template <class F> FN typename Of<F>::Int load_words(const Word16* at) {
    if constexpr (Of<F>::COUNT == 1) {
        return *at;
    } else {
        WideWord16 words;
        __builtin_memcpy(&words, at, sizeof words);
        return __builtin_convertvector(words, WideInt);
    }
}

// Bits of the nearest half float, ties to even, cut to +-65504. NaN stays NaN.
template <class F> FN typename Of<F>::Int half_of(F light) {
    typedef typename Of<F>::Int I;
    const I all = bits(light), size = all & SIZE, cut = size < LARGEST ? size : I(LARGEST);
    const I normal = (cut + 0xFFF + ((cut >> 13) & 1) - REBIAS) >> 13;
    const I small = whole(nearest_of(smaller<F>(size_of<F>(light), 1.0f) * SUBNORMALS));
    const I half = cut >= LEAST_NORMAL ? normal : small;
    return (size <= INFINITE ? half : I(HALF_NAN)) | ((all >> 16) & HALF_SIGN);
}

// The float that equals a half float.
template <class F> FN F float_of(typename Of<F>::Int half) {
    typedef typename Of<F>::Int I;
    const I size = half & HALF_SIZE, normal = (size << 13) + REBIAS;
    const I small = bits(F(number(size) * (1.0f / SUBNORMALS)));
    const I finite = size >= HALF_NORMAL ? normal : small;
    const I found = size < HALF_INFINITE ? finite : (size << 13) | INFINITE;
    return from_bits(I(found | (half & HALF_SIGN) << 16));
}

// Pixels of some channels beside one another, as half floats of one channel after the other.
template <int COUNT>
FN void halve_some(Long first, Long last, const float* values, View<Word16, 2> halves) {
    across(first, last, EACH(F, Long x) {
        for (int c = 0; c < COUNT; c++) {
            store_words(halves(c) + x, half_of<F>(pick<F, COUNT>(values + COUNT * x + c)));
        }
    });
}
static void halve_pixels(Long first, Long last, View<const float, 1> values,
                         View<Word16, 2> halves) {
    const Long count = halves.size[0];
    if (count == 1) return halve_some<1>(first, last, values.at, halves);
    if (count == 2) return halve_some<2>(first, last, values.at, halves);
    if (count == 3) return halve_some<3>(first, last, values.at, halves);
    if (count == 4) return halve_some<4>(first, last, values.at, halves);
    for (Long c = 0; c < count; c++) {
        for (Long x = first; x < last; x++) {
            store_words(halves(c) + x, half_of<float>(values.at[count * x + c]));
        }
    }
}
EXPORT(halve_pixels, halve_pixels)

enum Stored { HALVES = 1, FLOATS = 2 };  // and how many words of 16 bits a number has

// Numbers of a channel that is stored as words of 16 bits.
template <class F> FN F stored_at(const Word16* words, Long kind, Long x) {
    if (kind == HALVES) return float_of<F>(load_words<F>(words + x));
    return load<F>((const float*)(words + 2 * x));
}

// Pixels of rows of words: of each channel its kind, and the column where it begins.
template <int COUNT, class F> FN void store_pixels(float* at, const F* numbers) {
    if constexpr (COUNT == 1) store<F>(at, numbers[0]);
    if constexpr (COUNT == 2) store_pairs<F>(at, numbers[0], numbers[1]);
    if constexpr (COUNT == 3) store_triples<F>(at, numbers[0], numbers[1], numbers[2]);
    if constexpr (COUNT == 4) spread_four<4, F>(at, numbers[0], numbers[1], numbers[2], numbers[3]);
}
template <int COUNT>
FN void widen_some(const Word16* words, View<const Long, 2> channels, Long width, float* out) {
    Long kinds[COUNT];
    const Word16* begin[COUNT];
    bool halves = true;
    for (int c = 0; c < COUNT; c++) {
        kinds[c] = *channels(c);
        begin[c] = words + channels(c)[1];
        halves &= kinds[c] == HALVES;
    }
    with_flag(halves, PIXELS(auto all_halves) {
        across(0, width, EACH(F, Long x) {
            F numbers[COUNT];
            for (int c = 0; c < COUNT; c++) {
                numbers[c] = stored_at<F>(begin[c], all_halves() ? HALVES : kinds[c], x);
            }
            store_pixels<COUNT, F>(out + COUNT * x, numbers);
        });
    });
}
static void widen_row(Long y, View<const Word16, 2> words, View<const Long, 2> channels,
                      View<float, 3> pixels) {
    const Long count = channels.size[0], width = pixels.size[1];
    float* out = pixels(y);
    if (count == 1) widen_some<1>(words(y), channels, width, out);
    else if (count == 2) widen_some<2>(words(y), channels, width, out);
    else if (count == 3) widen_some<3>(words(y), channels, width, out);
    else if (count == 4) widen_some<4>(words(y), channels, width, out);
    for (Long c = 0; count > 4 && c < count; c++) {
        const Word16* begin = words(y) + channels(c)[1];
        for (Long x = 0; x < width; x++) {
            out[count * x + c] = stored_at<float>(begin, *channels(c), x);
        }
    }
}
EXPORT(widen_rows, widen_row)

FN bool is_any(bool one) { return one; }
FN bool is_any(WideInt some) { return __builtin_reduce_or(some) != 0; }

// Values between the entries of a table, which lie evenly over codes from 0 to 1 and end with the
// last one twice; and whether all codes lie there.
static void look_up(Long first, Long last, View<const float, 1> codes, View<const float, 1> table,
                    View<float, 1> values, View<bool, 1> inside) {
    const float steps = float(table.size[0] - 2);
    bool all = true;
    across(first, last, EACH(F, Long x) {
        const F given = load<F>(codes.at + x), code = within<F>(given, 0.0f, 1.0f);
        const F place = code * steps;
        const typename Of<F>::Int entry = whole(place);
        int places[Of<F>::COUNT];
        store_int<F>(places, entry);
        const F low = gather<F>(table.at, places), high = gather<F>(table.at + 1, places);
        store<F>(values.at + x, low + (place - number(entry)) * (high - low));
        all &= !is_any(code != given);
    });
    *inside.at = all;
}
EXPORT_ALONE(look_up, look_up)

// 8 bits.

FN void store_bytes(byte* at, int x) { *at = byte(x); }
FN void store_bytes(byte* at, WideInt x) {
    const WideByte bytes = __builtin_convertvector(x, WideByte);
    store(at, bytes);
}

// The whole part of codes times the largest byte, cut to 0..1, plus a threshold of a pattern that
// is repeated.
static void dither_row(Long y, View<const float, 2> codes, Given<float> top,
                       View<const float, 2> pattern, View<byte, 2> bytes) {
    const Long width = codes.size[1], period = pattern.size[1];
    const float highest = *top;
    const float* thresholds = pattern(y % pattern.size[0]);
    for (Long start = 0; start < width; start += period) {
        const float* some = codes(y) + start;
        byte* out = bytes(y) + start;
        const Long size = smaller<Long>(period, width - start);
        const auto dither = EACH(F, Long x) {
            const F code = within<F>(load<F>(some + x), 0.0f, 1.0f);
            store_bytes(out + x, whole(F(code * highest + load<F>(thresholds + x))));
        };
        Long x = 0;
        for (; x + 4 * WIDE <= size; x += 4 * WIDE) {
            UNROLL for (int k = 0; k < 4; k++) dither(Wide(), x + k * WIDE);
        }
        across(x, size, dither);
    }
}
EXPORT_ALONE(dither_rows, dither_row)

// PNG's filter 4 (ISO/IEC 15948, 9.4) of rows, after its number; `above` is the row before.
FN int distance(int x, int other) { return x < other ? other - x : x - other; }
static void filter_row(Long y, View<const byte, 2> rows, View<const byte, 1> above,
                       View<const Long, 1> bytes_of_pixel, View<byte, 2> filtered) {
    const Long size = rows.size[1], step = *bytes_of_pixel.at;
    const byte* __restrict row = rows(y);
    const byte* __restrict up = y ? rows(y - 1) : above.at;
    byte* __restrict out = filtered(y) + 1;
    out[-1] = 4;
    for (Long i = 0; i < step; i++) out[i] = byte(row[i] - up[i]);
    for (Long i = step; i < size; i++) {
        const short a = row[i - step], b = up[i], c = up[i - step];
        const short to_left = short(distance(b, c)), to_up = short(distance(a, c));
        const short over = short(a + b - 2 * c), to_corner = short(over < 0 ? -over : over);
        const short nearer = to_up <= to_corner ? b : c;
        const bool left = to_left <= to_up && to_left <= to_corner;
        out[i] = byte(row[i] - (left ? a : nearer));
    }
}
EXPORT_ALONE(filter_rows, filter_row)

// Bytes as OpenEXR compresses them (ImfZip.cpp): those in even places before those in odd ones,
// each less the one before it, plus 128.

constexpr byte MIDDLE = 128;
static void predict_bytes(Long, Long, View<const byte, 1> plain, View<byte, 1> differences) {
    const Long half = plain.size[0] / 2;
    const byte* __restrict from = plain.at;
    byte* __restrict even = differences.at;
    byte* __restrict odd = differences.at + half;
    even[0] = from[0];
    odd[0] = byte(from[1] - from[2 * half - 2] + MIDDLE);
    for (Long i = 1; i < half; i++) even[i] = byte(from[2 * i] - from[2 * i - 2] + MIDDLE);
    for (Long i = 1; i < half; i++) odd[i] = byte(from[2 * i + 1] - from[2 * i - 1] + MIDDLE);
}
EXPORT(predict_bytes, predict_bytes)

// Back again, a vector of bytes at once.

constexpr int COUNT = 4 * WIDE;  // bytes of a vector
typedef byte Bytes __attribute__((ext_vector_type(COUNT)));
const __make_integer_seq<List, int, COUNT> BYTE_PLACES;

// The bytes STEP places later, after zeros.
template <int STEP, int... I> FN Bytes later(Bytes x, List<int, I...>) {
    return TWO_OF(Bytes(0), x, I < STEP ? I : COUNT + I - STEP);
}

// Each byte and those before it in the vector, added up modulo 256.
template <int STEP = 1> FN Bytes running_sums(Bytes x) {
    x += later<STEP>(x, BYTE_PLACES);
    if constexpr (2 * STEP < COUNT) return running_sums<2 * STEP>(x);
    return x;
}

// The last byte in all places.
template <int... I> FN Bytes last_of(Bytes x, List<int, I...>) {
    return TWO_OF(x, x, 0 * I + COUNT - 1);
}

// A half of the bytes of two vectors, in turn.
template <int FIRST, int... I> FN Bytes in_turn(Bytes low, Bytes high, List<int, I...>) {
    return TWO_OF(low, high, FIRST + I / 2 + I % 2 * COUNT);
}

static void unpredict_bytes(Long, Long, View<const byte, 1> differences, View<Word16, 1> words) {
    const Long half = words.size[0], whole = half / COUNT * COUNT;
    const byte* lower = differences.at;
    const byte* upper = differences.at + half;

    // The differences of the upper bytes go on where those of the lower ones end.
    Bytes sums = Bytes(0);
    for (Long i = 0; i < whole; i += COUNT) sums += load<Bytes>(lower + i) - MIDDLE;
    Bytes lows = Bytes(MIDDLE), highs = lows + last_of(running_sums(sums), BYTE_PLACES);
    for (Long i = whole; i < half; i++) highs += byte(lower[i] - MIDDLE);

    for (Long i = 0; i < whole; i += COUNT) {
        const Bytes own_lows = running_sums(load<Bytes>(lower + i) - MIDDLE);
        const Bytes own_highs = running_sums(load<Bytes>(upper + i) - MIDDLE);
        const Bytes a = own_lows + lows, b = own_highs + highs;
        const Bytes first = in_turn<0>(a, b, BYTE_PLACES);
        const Bytes second = in_turn<COUNT / 2>(a, b, BYTE_PLACES);
        store(words.at + i, first);
        store(words.at + i + COUNT / 2, second);
        lows += last_of(own_lows, BYTE_PLACES);
        highs += last_of(own_highs, BYTE_PLACES);
    }
    byte low = lows[0], high = highs[0];
    for (Long i = whole; i < half; i++) {
        low = byte(low + lower[i] - MIDDLE);
        high = byte(high + upper[i] - MIDDLE);
        words.at[i] = Word16(low | high << 8);
    }
}
EXPORT(unpredict_bytes, unpredict_bytes)

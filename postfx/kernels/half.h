// Numbers in half precision, by whole numbers alone: the same bits on every processor.
#pragma once
#include "rows.h"

struct half {
    unsigned short bits;
};
template <> constexpr const char* type_name<half>() { return "f2"; }

// A number of the lowest 16 bits.
template <class F> FN F from_half(typename Of<F>::Int low) {
    typedef typename Of<F>::Int I;
    const I size = (low & 0x7FFF) << 13, sign = (low & 0x8000) << 16;
    // by 2^112, which is between both exponents of 1
    const F scaled = from_bits(size) * 5.192296858534828e33f;
    const F beyond = from_bits(size | 0x7F800000);
    return from_bits(bits(size < 0x0F800000 ? scaled : beyond) | sign);
}

// The nearest number of 16 bits, of two the even one; infinity from 65520 on.
template <class F> FN typename Of<F>::Int to_half(F value) {
    typedef typename Of<F>::Int I;
    const I all = bits(value), sign = (all >> 16) & 0x8000, even = (all >> 13) & 1;
    const F size = size_of<F>(value);
    const I tiny = bits(size + 0.5f) - 0x3F000000;  // the sum's last bit is worth 2^-24
    const I normal = (bits(size) - 0x37FFF001 + even) >> 13;
    const I infinite = I{} + 0x7C00, unknown = I{} + 0x7E00;
    const I small = size < 6.103515625e-05f ? tiny : normal;
    const I known = size < 65536.0f ? small : infinite;
    return (size == size ? known : unknown) | sign;
}

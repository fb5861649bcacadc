// The highest level that this processor and its system have: its place in the levels of build.py.
// Written out, as the compiler's own __builtin_cpu_supports needs a library that is not linked.
#include "rows.h"

#if defined(__x86_64__)
enum { BASELINE, V3, V4, VNNI };

struct Registers {
    unsigned a, b, c, d;
};

FN Registers identify(unsigned leaf) {
    Registers found;
    __asm__("cpuid"
            : "=a"(found.a), "=b"(found.b), "=c"(found.c), "=d"(found.d)
            : "a"(leaf), "c"(0));
    return found;
}

// Which registers the system keeps for each of its threads.
FN unsigned kept_registers() {
    unsigned low, high;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

FN bool has(unsigned flags, unsigned wanted) { return (flags & wanted) == wanted; }

EXPORTED int best_level() {
    const unsigned fma = 1u << 12, movbe = 1u << 22, osxsave = 1u << 27, avx = 1u << 28,
                   f16c = 1u << 29;
    const unsigned bmi1 = 1u << 3, avx2 = 1u << 5, bmi2 = 1u << 8, lzcnt = 1u << 5;
    const unsigned avx512 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;  // F DQ CD BW VL
    const unsigned vnni = 1u << 11;
    const unsigned vectors = 0x6, masks = 0xe6;
    if (identify(0).a < 7) return BASELINE;
    const Registers basic = identify(1), more = identify(7), extended = identify(0x80000001);
    if (!has(basic.c, fma | movbe | osxsave | avx | f16c)) return BASELINE;
    if (!has(more.b, bmi1 | avx2 | bmi2) || !has(extended.c, lzcnt)) return BASELINE;
    if (!has(kept_registers(), vectors)) return BASELINE;
    if (!has(more.b, avx512) || !has(kept_registers(), masks)) return V3;
    return has(more.c, vnni) ? VNNI : V4;
}
#else
EXPORTED int best_level() { return 0; }
#endif

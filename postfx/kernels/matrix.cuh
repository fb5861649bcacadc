// Products of a warp's matrix units, with factors of 11 bits each; two of them make one of float32.
// On the host tests have a product of their own.
#pragma once

#ifdef __CUDACC__
// sums (16, 8) += left (16, 8) right (8, 8), spread over a warp. Of lane 4 g + q: sums of rows g
// and g + 8, columns 2 q and 2 q + 1; left of the same rows, columns q and q + 4; right of column
// g, rows q and q + 4.
FN void add_product(float (&sums)[4], const unsigned (&left)[4], const unsigned (&right)[2]) {
    asm("mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, "
        "{%8, %9}, "
        "{%0, %1, %2, %3};"
        : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
        : "r"(left[0]), "r"(left[1]), "r"(left[2]), "r"(left[3]), "r"(right[0]), "r"(right[1]));
}
#endif

union Bits {
    float number;
    unsigned bits;
};

// A number as the sum of two that tensor cores take, which have 11 bits.
FN void split(float value, unsigned& high, unsigned& low) {
    Bits whole, rest;
    whole.number = value;
    whole.bits = (whole.bits + 0x1000u) & ~0x1fffu;
    rest.number = value - whole.number;
    high = whole.bits;
    low = rest.bits;
}

// Products on tensor cores in half precision, copies into shared memory, and how groups of threads
// wait for each other: what postfx/kernels/convolution.cuh is made of. On the host tests put their
// own in place of the GPU's instructions.
//
// WARPGROUPS is defined where the warps of a group multiply together (compute capability 9.0).

typedef unsigned Two;  // numbers in half precision

const int GROUP = 128;

struct alignas(16) Eight {
    Two at[4];
};

#ifdef __CUDACC_RTC__
FN unsigned shared_at(const void* at) { return unsigned(__cvta_generic_to_shared(at)); }

// Begin to copy 16 bytes into the shared memory, zeros where there is nothing.
FN void copy_eight(char* to, const char* from, bool there) {
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;" ::"r"(shared_at(to)), "l"(from),
                 "r"(there ? 16 : 0)
                 : "memory");
}

FN void wait_for_copies() {
    asm volatile("cp.async.wait_all;" ::: "memory");
}

FN void meet_group(int group) {
    asm volatile("bar.sync %0, %1;" ::"r"(group + 1), "n"(GROUP) : "memory");
}

// The next group begins when the one before it has given it its turn.
FN void take_turn(int group) {
    asm volatile("bar.sync %0, %1;" ::"r"(group + 4), "n"(2 * GROUP) : "memory");
}

FN void give_turn(int group) {
    asm volatile("bar.arrive %0, %1;" ::"r"(group + 5), "n"(2 * GROUP) : "memory");
}

// A place in shared memory for a part of the weights: how often it has been filled, and how many
// warps are through.
struct alignas(16) Slot {
    unsigned long long filled;
    int through;
};

FN void empty(Slot& slot) {
    slot.through = 0;
    asm volatile("mbarrier.init.shared::cta.b64 [%0], 1;\nfence.mbarrier_init.release.cluster;\n"
                 "fence.proxy.async.shared::cta;"
                 ::"r"(shared_at(&slot.filled)) : "memory");
}

// Begin to copy a part; one thread does it.
FN void fill_slot(Slot& slot, char* to, const char* from, int bytes) {
    asm volatile(
        "mbarrier.arrive.expect_tx.shared::cta.b64 _, [%0], %1;\n"
        "cp.async.bulk.shared::cluster.global.mbarrier::complete_tx::bytes [%2], [%3], %1, [%0];" ::
            "r"(shared_at(&slot.filled)),
        "r"(bytes), "r"(shared_at(to)), "l"(from)
        : "memory");
}

// Wait until it has been filled more than `times` times.
FN void wait_for_slot(Slot& slot, int times) {
    asm volatile(
        "{\n.reg .pred p;\nagain:\nmbarrier.try_wait.parity.shared::cta.b64 p, [%0], %1;\n@!p bra "
        "again;\n}" ::"r"(shared_at(&slot.filled)),
        "r"(times & 1)
        : "memory");
}

// This warp is through with a part: whether it is the last one of so many.
FN bool leave_slot(Slot& slot, int warps) {
    __threadfence_block();
    const bool last = (atomicAdd(&slot.through, 1) + 1) % warps == 0;
    __threadfence_block();
    return last;
}

FN Two from_lane(Two value, int mask) { return __shfl_xor_sync(~0u, value, mask); }

// Four matrices of 8x8 halves; each thread says where one row begins.
FN void load_matrices(Two (&to)[4], const char* row) {
    asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0, %1, %2, %3}, [%4];"
                 : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
                 : "r"(shared_at(row))
                 : "memory");
}

// sums += left (16x16) * right (16x8) of a warp, added in single precision.
FN void add_product(float* sums, const Two (&left)[4], Two upper, Two lower) {
    asm volatile(
        "mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, "
        "{%8, %9}, "
        "{%0, %1, %2, %3};"
        : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
        : "r"(left[0]), "r"(left[1]), "r"(left[2]), "r"(left[3]), "r"(upper), "r"(lower));
}

FN float saturated(float x) { return __saturatef(x); }

FN Two rounded(float first, float second) {
    Two both;
    asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(second), "f"(first));
    return both;
}

FN Two sum(Two a, Two b) {
    Two both;
    asm("add.rn.f16x2 %0, %1, %2;" : "=r"(both) : "r"(a), "r"(b));
    return both;
}

FN Two larger(Two a, Two b) {
    Two both;
    asm("max.f16x2 %0, %1, %2;" : "=r"(both) : "r"(a), "r"(b));
    return both;
}

#ifdef WARPGROUPS
// Matrices of 8x8 halves in shared memory, 16 bytes a row: how far they are apart along the sum,
// and across.
typedef unsigned long long Matrices;

FN Matrices matrices(const char* at, int along, int across) {
    return Matrices(shared_at(at) >> 4 & 0x3fff) | Matrices(along >> 4) << 16
           | Matrices(across >> 4) << 32;
}

// sums += left (16x16 of each warp) * right (16 x 2 COUNT) of a group: see `multiply_source` of
// postfx/runtime/convolutions.py.
template <int COUNT>
__device__ void multiply(float (&sums)[COUNT], const Two (&left)[4], Matrices right);

// What this thread has put into shared memory is there for products.
FN void show_to_products() {
    asm volatile("fence.proxy.async.shared::cta;" ::: "memory");
}

FN void begin_products() {
    asm volatile("wgmma.fence.sync.aligned;" ::: "memory");
}

// Of products that have begun, wait for all but those since the last call: the factors before them
// can be loaded anew.
template <int STEPS>
FN void end_products_before(Two (&left)[STEPS][4]) {
    asm volatile("wgmma.commit_group.sync.aligned;\nwgmma.wait_group.sync.aligned 1;" ::: "memory");
    UNROLL for (int i = 0; i < 4 * STEPS; i++) {
        asm volatile("" : "+r"(left[i / 4][i % 4])::"memory");
    }
}

// Wait for all products: the sums are there.
template <int COUNT, int STEPS>
FN void end_products(float (&sums)[COUNT], Two (&left)[STEPS][4]) {
    asm volatile("wgmma.commit_group.sync.aligned;\nwgmma.wait_group.sync.aligned 0;" ::: "memory");
    UNROLL for (int i = 0; i < COUNT; i++) asm volatile("" : "+f"(sums[i])::"memory");
    UNROLL for (int i = 0; i < 4 * STEPS; i++) {
        asm volatile("" : "+r"(left[i / 4][i % 4])::"memory");
    }
}
#endif
#endif

#ifndef WARPGROUPS
struct Matrices {
    const char* at;
    int along, across;
};

FN Matrices matrices(const char* at, int along, int across) {
    return {at, along, across};
}

// sums += left (16x16 of each warp) * right (16 x 2 COUNT), in the layout that warpgroups have.
template <int COUNT>
FN void multiply(float (&sums)[COUNT], const Two (&left)[4], Matrices right) {
    const int lane = threadIdx.x % 32;
    Two b[4];
    UNROLL for (int i = 0; i < COUNT; i += 8) {
        load_matrices(
            b, right.at + (2 * i + lane / 16 * 8 + lane % 8) * 16 + lane / 8 % 2 * right.along);
        add_product(sums + i, left, b[0], b[1]);
        add_product(sums + i + 4, left, b[2], b[3]);
    }
}

FN void show_to_products() {}
FN void begin_products() {}
template <int STEPS>
FN void end_products_before(Two (&)[STEPS][4]) {}
template <int COUNT, int STEPS>
FN void end_products(float (&)[COUNT], Two (&)[STEPS][4]) {}
#endif

#ifdef __CUDACC_RTC__
#define SHARED_MEMORY extern __shared__ __align__(128) char shared[]
#endif

// Convolutions of a network in half precision, channels last, as products on tensor cores: see
// postfx/runtime/convolutions.py, which appends a kernel for each kind of layer that a network has.
//
// A block of threads keeps all weights of its N channels in shared memory. It is a few groups of four warps, each of
// which takes squares of 8x8 pixels one after the other for itself: it multiplies the square's pixels by all weights at
// one go, and writes the results from its registers while the next pixels come. Nothing but its own copies holds a
// group up, and meanwhile the others multiply. A square lies in shared memory with its border, by 8 channels; a tap's
// products begin at another pixel of it, so nothing is copied for them.
//
// WARPGROUPS is defined where the warps of a group multiply together (compute capability 9.0).

typedef unsigned Two;  // numbers in half precision

const int SQUARE = 8, GROUP = 128;

struct alignas(16) Eight {
    Two at[4];
};

#ifdef __CUDACC_RTC__
__device__ inline unsigned shared_at(const void* at) {
    return unsigned(__cvta_generic_to_shared(at));
}

// Begin to copy 16 bytes into the shared memory, zeros where there is nothing.
__device__ inline void copy_eight(char* to, const char* from, bool there) {
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;" ::"r"(shared_at(to)), "l"(from), "r"(there ? 16 : 0)
                 : "memory");
}

__device__ inline void wait_for_copies() {
    asm volatile("cp.async.wait_all;" ::: "memory");
}

__device__ inline void meet_group(int group) {
    asm volatile("bar.sync %0, %1;" ::"r"(group + 1), "n"(GROUP) : "memory");
}

__device__ inline Two from_lane(Two value, int mask) {
    return __shfl_xor_sync(~0u, value, mask);
}

// Four matrices of 8x8 halves; each thread says where one row begins.
__device__ inline void load_matrices(Two (&to)[4], const char* row) {
    asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0, %1, %2, %3}, [%4];"
                 : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
                 : "r"(shared_at(row))
                 : "memory");
}

// sums += left (16x16) * right (16x8) of a warp, added in single precision.
__device__ inline void add_product(float* sums, const Two (&left)[4], Two upper, Two lower) {
    asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
                 "{%0, %1, %2, %3};"
                 : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
                 : "r"(left[0]), "r"(left[1]), "r"(left[2]), "r"(left[3]), "r"(upper), "r"(lower));
}

__device__ inline float power_of_two(float x) {
    float y;
    asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
}

__device__ inline float inverse(float x) {
    float y;
    asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
    return y;
}

__device__ inline Two rounded(float first, float second) {
    Two both;
    asm("cvt.rn.f16x2.f32 %0, %1, %2;" : "=r"(both) : "f"(second), "f"(first));
    return both;
}

__device__ inline Two sum(Two a, Two b) {
    Two both;
    asm("add.rn.f16x2 %0, %1, %2;" : "=r"(both) : "r"(a), "r"(b));
    return both;
}

__device__ inline Two larger(Two a, Two b) {
    Two both;
    asm("max.f16x2 %0, %1, %2;" : "=r"(both) : "r"(a), "r"(b));
    return both;
}

#ifdef WARPGROUPS
// Matrices of 8x8 halves in shared memory, 16 bytes a row: how far they are apart along the sum, and across.
typedef unsigned long long Matrices;

__device__ inline Matrices matrices(const char* at, int along, int across) {
    return Matrices(shared_at(at) >> 4 & 0x3fff) | Matrices(along >> 4) << 16 | Matrices(across >> 4) << 32;
}

// sums += left (64x16) * right (16 x 2 COUNT) of a group: see `multiply_source` of postfx/runtime/convolutions.py.
template <int COUNT>
__device__ void multiply(float (&sums)[COUNT], Matrices left, Matrices right);

// What this thread has put into shared memory is there for products.
__device__ inline void show_to_products() {
    asm volatile("fence.proxy.async.shared::cta;" ::: "memory");
}

__device__ inline void begin_products() {
    asm volatile("wgmma.fence.sync.aligned;" ::: "memory");
}

template <int COUNT>
__device__ inline void end_products(float (&sums)[COUNT]) {
    asm volatile("wgmma.commit_group.sync.aligned;\nwgmma.wait_group.sync.aligned 0;" ::: "memory");
#pragma unroll
    for (int i = 0; i < COUNT; i++) asm volatile("" : "+f"(sums[i])::"memory");  // they are not read before
}
#endif
#endif

#ifndef WARPGROUPS
struct Matrices {
    const char* at;
    int along, across;
};

__device__ inline Matrices matrices(const char* at, int along, int across) {
    return {at, along, across};
}

// sums += left (64x16) * right (16 x 2 COUNT) of a group: each warp has 16 rows, in the layout that warpgroups have.
template <int COUNT>
__device__ inline void multiply(float (&sums)[COUNT], Matrices left, Matrices right) {
    const int warp = threadIdx.x % GROUP / 32, lane = threadIdx.x % 32;
    Two a[4], b[4];
    load_matrices(a, left.at + (2 * warp + lane / 8 % 2) * left.across + lane % 8 * 16 + lane / 16 * left.along);
#pragma unroll
    for (int i = 0; i < COUNT; i += 8) {
        load_matrices(b, right.at + (2 * i + lane / 16 * 8 + lane % 8) * 16 + lane / 8 % 2 * right.along);
        add_product(sums + i, a, b[0], b[1]);
        add_product(sums + i + 4, a, b[2], b[3]);
    }
}

__device__ inline void show_to_products() {}
__device__ inline void begin_products() {}
template <int COUNT>
__device__ inline void end_products(float (&)[COUNT]) {}
#endif

#ifdef __CUDACC_RTC__
#define SHARED_MEMORY extern __shared__ __align__(128) char shared[]
#endif

__device__ inline const Eight* eights(const View& view) {
    return reinterpret_cast<const Eight*>(view.at);
}

__device__ inline Eight sum(const Eight& a, const Eight& b) {
    return {{sum(a.at[0], b.at[0]), sum(a.at[1], b.at[1]), sum(a.at[2], b.at[2]), sum(a.at[3], b.at[3])}};
}

__device__ inline Eight larger(const Eight& a, const Eight& b) {
    return {{larger(a.at[0], b.at[0]), larger(a.at[1], b.at[1]), larger(a.at[2], b.at[2]), larger(a.at[3], b.at[3])}};
}

// A square of the picture, by its number.
struct Square {
    int number, wide, all, height, width;

    __device__ inline int row() const {
        return number / wide * SQUARE;
    }

    __device__ inline int column() const {
        return number % wide * SQUARE;
    }

    __device__ inline bool holds(int y, int x) const {
        return number < all && y >= 0 && x >= 0 && y < height && x < width;
    }
};

// Pixels along a side of a square with its border, and bytes of 8 channels of all of them: no bank twice at a time.
__device__ constexpr int side_of(int taps) {
    return SQUARE + taps - 1;
}

__device__ constexpr int pitch_of(int taps) {
    return 16 * (side_of(taps) * side_of(taps) + (taps == 3 ? 5 : taps == 1));
}

// Begin to copy a square with its border into shared memory, by 8 channels; a group does it together. Sums with what is
// enlarged are there at the end, a few of which are on their way at a time.
template <int TAPS, bool CELLS, bool COARSE, int CHUNKS>
__device__ inline void fill(char* left, int thread, const Square& square, const View& input, const View& coarse) {
    constexpr int SIDE = side_of(TAPS), BEFORE = TAPS == 3, EACH = CHUNKS / 4, ALL = SIDE * SIDE * CHUNKS, MANY = 3;
    const Eight* const pixels = eights(input);
    auto place = [&](int i) { return left + i % CHUNKS * pitch_of(TAPS) + 16 * (i / CHUNKS); };
    if constexpr (!COARSE) {
#pragma unroll 2
        for (int i = thread; i < ALL; i += GROUP) {
            const int chunk = i % CHUNKS, pixel = i / CHUNKS;
            const int y = square.row() + pixel / SIDE - BEFORE, x = square.column() + pixel % SIDE - BEFORE;
            bool there = square.holds(y, x);
            size_t from = (size_t(y) * square.width + x) * CHUNKS + chunk;
            if (CELLS) {
                const int v = 2 * y + chunk / (2 * EACH) - (TAPS == 2), u = 2 * x + chunk / EACH % 2 - (TAPS == 2);
                there = square.number < square.all && v >= 0 && u >= 0 && v < input.size[1] && u < input.size[2];
                from = (size_t(v) * input.size[2] + u) * EACH + chunk % EACH;
            }
            copy_eight(place(i), reinterpret_cast<const char*>(pixels + (there ? from : 0)), there);
        }
        return;
    }
#pragma unroll 1
    for (int first = thread; first < ALL; first += MANY * GROUP) {
        Eight own[MANY], more[MANY];
#pragma unroll
        for (int k = 0; k < MANY; k++) {
            const int i = first + k * GROUP, chunk = i % CHUNKS, pixel = i / CHUNKS;
            const int y = square.row() + pixel / SIDE - BEFORE, x = square.column() + pixel % SIDE - BEFORE;
            own[k] = more[k] = {{0, 0, 0, 0}};
            if (i >= ALL || !square.holds(y, x)) continue;
            own[k] = pixels[(size_t(y) * square.width + x) * CHUNKS + chunk];
            more[k] = eights(coarse)[(size_t(y / 2) * coarse.size[2] + x / 2) * CHUNKS + chunk];
        }
#pragma unroll
        for (int k = 0; k < MANY; k++)
            if (first + k * GROUP < ALL) *reinterpret_cast<Eight*>(place(first + k * GROUP)) = sum(own[k], more[k]);
    }
}

// What a layer is besides its tensors: size of the result, number of tiles, first of the `second` ones of its channels
// (0 if there are none), whether negative results become 0.
struct Options {
    int height, width, tiles, split, positive;
};

// Each of four lanes next to each other has two channels of four eights; the q-th one gets all of the q-th eight.
__device__ inline Eight whole_eight(const Two (&parts)[4], int q) {
    const bool odd = q % 2, late = q / 2;
    Two low[2], high[2];  // the first and the last half of eights q % 2 and q % 2 + 2
#pragma unroll
    for (int i = 0; i < 2; i++) {
        const Two first = parts[2 * i], second = parts[2 * i + 1];
        const Two own = odd ? second : first, other = from_lane(odd ? first : second, 1);
        low[i] = odd ? other : own, high[i] = odd ? own : other;
    }
    const Two first = from_lane(late ? low[0] : low[1], 2), second = from_lane(late ? high[0] : high[1], 2);
    return late ? Eight{{first, second, low[1], high[1]}} : Eight{{low[0], high[0], first, second}};
}

// The activation of a logit: weight_of and gate_of of common.cuh and tanh, as exact as half precision. The channel is
// one of the eight from `first` on, so it is mostly known when compiled which one.
template <int SHARES, int STATES>
__device__ inline float activated(float logit, int first, int channel) {
    const float to_two = 1.44269504f;  // exp(x) is 2 to the power of x * to_two
    if (first + 8 <= SHARES || (first < SHARES && channel < SHARES))
        return power_of_two(fminf(fmaxf(logit, -STEEPEST), STEEPEST) * to_two);
    if (first + 8 <= STATES || (first < STATES && channel < STATES))
        return inverse(1.0f + power_of_two(-logit * to_two));
    return 2.0f * inverse(1.0f + power_of_two(-2.0f * logit * to_two)) - 1.0f;
}

// A convolution of TAPS x TAPS pixels of `input` (1, h, w, C); or, with CELLS, of cells of 2x2 pixels of (1, 2 h, 2 w,
// C / 4), which begin a pixel before the first with two taps. With COARSE, `coarse` (1, h / 2, w / 2, C) is enlarged
// and added to the input. `weights` (tiles of N channels, steps, 4, N, 8) and `bias` (channels,) give `output`
// (1, h, w, channels), no less than 0 if `options` says so, plus `added` (channels,) if there is one. `second` may be
// the largest of 2x2 pixels (1, h / 2, w / 2, channels), or the channels from the `split`-th on.
//
// If OUT is not 0, `output` is planes after their activations (1, PLANES, OUT * h, OUT * w): first SHARES weights, then
// shares before STATES, then states. With OUT 2 a pixel's four parts are one after the other, top left first, and a
// tile has those of a row. With OUT 1 the planes are in the first tile.
template <int TAPS, bool CELLS, bool COARSE, int C, int N, int OUT, int PLANES, int SHARES, int STATES>
__device__ inline void convolve(const View& input, const View& coarse, const View& weights, const View& bias,
                                const View& added, const View& output, const View& second, const Options& options) {
    SHARED_MEMORY;
    constexpr int CHUNKS = C / 8, SIDE = side_of(TAPS), PITCH = pitch_of(TAPS), WEIGHTS = TAPS * TAPS * C * N * 2;
    const int tiles = options.tiles, blocks = gridDim.x / tiles, tile = blockIdx.x % tiles, groups = blockDim.x / GROUP;
    const int group = threadIdx.x / GROUP, thread = threadIdx.x % GROUP;
    const int warp = thread / 32, lane = thread % 32, q = lane % 4;
    const int wide = (options.width + SQUARE - 1) / SQUARE, high = (options.height + SQUARE - 1) / SQUARE;
    Square square = {group * blocks + int(blockIdx.x) / tiles, wide, wide * high, options.height, options.width};
    char* const left = shared + WEIGHTS + group * CHUNKS * PITCH;
    const char* const factors = reinterpret_cast<const char*>(weights.at) + size_t(tile) * WEIGHTS;
    for (int i = 16 * threadIdx.x; i < WEIGHTS; i += 16 * blockDim.x) copy_eight(shared + i, factors + i, true);
    fill<TAPS, CELLS, COARSE, CHUNKS>(left, thread, square, input, coarse);
    wait_for_copies();
    show_to_products();
    __syncthreads();
    const int begin = tile * N, split = options.split;
    while (square.number < square.all) {
        float sums[N / 2];
#pragma unroll
        for (int i = 0; i < N / 2; i++) sums[i] = 0.0f;
        begin_products();
        for (int tap = 0; tap < TAPS * TAPS; tap++) {
            const char* const pixels = left + 16 * (tap / TAPS * SIDE + tap % TAPS);
            const char* const now = shared + tap * CHUNKS * N * 16;
#pragma unroll
            for (int k = 0; k < CHUNKS; k += 2)
                multiply(sums, matrices(pixels + k * PITCH, PITCH, 16 * SIDE), matrices(now + k * N * 16, N * 16, 128));
        }
        end_products(sums);
        const Square done = square;
        square.number += blocks * groups;
        meet_group(group);
        if (square.number < square.all) fill<TAPS, CELLS, COARSE, CHUNKS>(left, thread, square, input, coarse);

        // A lane has channels 2 q and 2 q + 1 of each eight, of two pixels one below the other.
        const int x = done.column() + lane / 4, y = done.row() + 2 * warp;
        const bool there[2] = {done.holds(y, x), done.holds(y + 1, x)};
        const Pair* const offsets = reinterpret_cast<const Pair*>(bias.at) + begin / 2 + q;
        if constexpr (OUT > 0) {
            constexpr int RIGHT = OUT == 2 ? N / 16 : 0;  // eights from a pixel of a row to the next
            const int across = OUT * done.width;
            const size_t plane = size_t(across) * OUT * done.height;
            const int row = OUT * y + (OUT == 2 ? tile : 0);
            Half* const to = reinterpret_cast<Half*>(output.at) + size_t(row) * across + OUT * x;
#pragma unroll
            for (int n = 0; n < N / 8 / OUT && 8 * n < PLANES; n++) {
                const Pair one = offsets[4 * n], two = offsets[4 * (n + RIGHT)];
#pragma unroll
                for (int i = 0; i < 4; i++) {
                    const int e = i % 2, channel = 8 * n + 2 * q + e;
                    if (!there[i / 2] || channel >= PLANES || (OUT == 1 && tile)) continue;
                    Half* const place = to + channel * plane + size_t(OUT * (i / 2)) * across;
                    const float left = activated<SHARES, STATES>(sums[4 * n + i] + (e ? one.y : one.x), 8 * n, channel);
                    if (OUT == 1) {
                        *place = to_half(left);
                        continue;
                    }
                    const float logit = sums[4 * (n + RIGHT) + i] + (e ? two.y : two.x);
                    const float right = activated<SHARES, STATES>(logit, 8 * n, channel);
                    *reinterpret_cast<Two*>(place) = rounded(left, right);
                }
            }
        }
        if constexpr (OUT < 2) {
            Two results[2][N / 8];
#pragma unroll
            for (int n = 0; n < N / 8; n++) {
                const Pair offset = offsets[4 * n];
                Two last = 0;
                if (added.size[0]) last = rounded(added.at[begin + 8 * n + 2 * q], added.at[begin + 8 * n + 2 * q + 1]);
#pragma unroll
                for (int k = 0; k < 2; k++) {
                    const float one = sums[4 * n + 2 * k] + offset.x, two = sums[4 * n + 2 * k + 1] + offset.y;
                    const Two both = options.positive ? rounded(fmaxf(one, 0.0f), fmaxf(two, 0.0f)) : rounded(one, two);
                    results[k][n] = added.size[0] ? sum(both, last) : both;
                }
            }
            Eight *const to = reinterpret_cast<Eight*>(output.at), *const others = reinterpret_cast<Eight*>(second.at);
            const int all = split ? split / 8 : tiles * (N / 8), rest = second.size[3] / 8;
#pragma unroll
            for (int n = 0; n < N / 8; n += 4) {
                const int eight = begin / 8 + n + q;
                const bool own[2] = {there[0] && n + q < N / 8, there[1] && n + q < N / 8};
                if (OUT && (!split || begin + 8 * (n + 4) <= split)) continue;
#pragma unroll
                for (int k = 0; k < 2; k++) {
                    Two parts[4];
#pragma unroll
                    for (int i = 0; i < 4; i++) parts[i] = n + i < N / 8 ? results[k][n + i] : 0;
                    const Eight value = whole_eight(parts, q);
                    const size_t at = size_t(y + k) * done.width + x;
                    if (!own[k]) continue;
                    if (split && eight >= all) others[at * rest + eight - all] = value;
                    else if (!OUT) to[at * all + eight] = value;
                }
                if (split || !rest) continue;
                Two most[4];
#pragma unroll
                for (int i = 0; i < 4; i++) {
                    most[i] = n + i < N / 8 ? larger(results[0][n + i], results[1][n + i]) : 0;
                    most[i] = larger(most[i], from_lane(most[i], 4));
                }
                const Eight value = whole_eight(most, q);
                if (own[0] && x % 2 == 0 && done.holds(y + 1, x + 1))
                    others[(size_t(y / 2) * (done.width / 2) + x / 2) * all + eight] = value;
            }
        }
        wait_for_copies();
        show_to_products();
        meet_group(group);
    }
}

// Convolutions of a network in half precision, channels last, as products on tensor cores: see
// postfx/runtime/convolutions.py, which appends a kernel for each shape that a network has.
//
// A block of threads makes 64 * 2 * MB pixels, in squares of 8x8, times N channels. The squares with their border lie in
// shared memory, by 8 channels; a tap's products begin at another pixel of it, so nothing is copied for them. Weights
// come in steps of 32 channels, some steps ahead.

typedef unsigned Two;  // numbers in half precision

const int SQUARE = 8, STEP = 32, AHEAD = 3, THREADS = 256;

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

// What was begun since the last call is one batch.
__device__ inline void end_batch() {
    asm volatile("cp.async.commit_group;" ::: "memory");
}

// Wait until at most so many batches are not there yet.
template <int MOST>
__device__ inline void wait_for_batches() {
    asm volatile("cp.async.wait_group %0;" ::"n"(MOST) : "memory");
}

// Four matrices of 8x8 halves; each thread says where one row begins.
__device__ inline void load_matrices(Two (&to)[4], const char* row) {
    asm volatile("ldmatrix.sync.aligned.m8n8.x4.shared.b16 {%0, %1, %2, %3}, [%4];"
                 : "=r"(to[0]), "=r"(to[1]), "=r"(to[2]), "=r"(to[3])
                 : "r"(shared_at(row))
                 : "memory");
}

// sums += left (16x16) * right (16x8) of a warp, added in single precision.
__device__ inline void add_product(float (&sums)[4], const Two (&left)[4], Two upper, Two lower) {
    asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
                 "{%0, %1, %2, %3};"
                 : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
                 : "r"(left[0]), "r"(left[1]), "r"(left[2]), "r"(left[3]), "r"(upper), "r"(lower));
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

// Eight numbers, or as many as there are.
__device__ inline void put_eight(Half* to, const Eight& value, int count) {
    if (count >= 8 && size_t(to) % 16 == 0) {
        *reinterpret_cast<Eight*>(to) = value;
        return;
    }
    for (int i = 0; i < min(count, 8); i++) to[i] = Half(value.at[i / 2] >> 16 * (i % 2));
}

// Where the squares of a block of threads lie in the picture.
struct Squares {
    int first, wide, all, height, width;

    __device__ inline int row(int square) const {
        return (first + square) / wide * SQUARE;
    }

    __device__ inline int column(int square) const {
        return (first + square) % wide * SQUARE;
    }

    __device__ inline bool holds(int square, int y, int x) const {
        return first + square < all && y >= 0 && x >= 0 && y < height && x < width;
    }
};

// What a layer is besides its tensors: size of the result, number of tiles, first of the `second` ones of its channels
// (0 if there are none), whether negative results become 0. For heads that are written as planes after their
// activations also how many pixels of a side a result stands for (0 for other layers), how many planes there are, and
// which are the first ones of shares and of states, behind the filter weights.
struct Options {
    int height, width, tiles, split, positive, side, planes, shares, states;
};

__device__ inline Half activated(Half logit, int plane, const Options& options) {
    const float value = from_half(logit);
    return to_half(plane < options.shares ? weight_of(value) : plane < options.states ? gate_of(value) : tanhf(value));
}

// Eight pixels of a row of a plane from the results of a block of threads, a pixel a line in shared memory.
template <int SIDE>
__device__ inline Eight opened(const char* line, int pitch, int channel, int plane, const Options& options) {
    Eight value;
#pragma unroll
    for (int i = 0; i < 4; i++) {
        Half two[2];
#pragma unroll
        for (int k = 0; k < 2; k++) {
            const int at = 2 * i + k, shift = SIDE == 2 ? at % 2 * options.planes : 0;
            const char* const from = line + at / SIDE * pitch + 2 * (channel + shift);
            two[k] = activated(*reinterpret_cast<const Half*>(from), plane, options);
        }
        value.at[i] = two[0] | unsigned(two[1]) << 16;
    }
    return value;
}

// Writes the planes of which a tile of N channels from the `begin`-th on has results; with two pixels of a side the four
// of a result are one after the other, top left first, and a tile has those of a row.
template <int SIDE, int COUNT>
__device__ inline void open_planes(const Squares& squares, int begin, int N, int pitch, const char* results,
                                   const View& output, const Options& options) {
    const int planes = SIDE == 2 ? options.planes : min(options.planes - begin, N), width = SIDE * squares.width;
    const size_t plane = size_t(width) * SIDE * squares.height;
    Half* const to = reinterpret_cast<Half*>(output.at);
    for (int i = threadIdx.x; i < COUNT * SQUARE * SIDE * planes; i += THREADS) {
        const int part = i % SIDE, channel = i / SIDE % planes, row = i / (SIDE * planes), square = row / SQUARE;
        const int y = squares.row(square) + row % SQUARE, x = squares.column(square) + part * (SQUARE / SIDE);
        if (!squares.holds(square, y, x)) continue;
        const int first = SIDE == 2 ? channel : begin + channel;
        const char* const line = results + (row * SQUARE + part * (SQUARE / SIDE)) * pitch;
        const Eight value = opened<SIDE>(line, pitch, channel, first, options);
        const size_t at = first * plane + size_t(SIDE * y + (SIDE == 2 ? begin / N : 0)) * width + SIDE * x;
        put_eight(to + at, value, width - SIDE * x);
    }
}

// A convolution of TAPS x TAPS pixels of `input` (1, h, w, C); or, with CELLS, of cells of 2x2 pixels of (1, 2 h, 2 w,
// C / 4), which begin a pixel before the first with two taps. `coarse` (1, h / 2, w / 2, C), if there is one, is
// enlarged and added to the input. `weights` (tiles of N channels, steps, 4, N, 8) and `bias` (channels,) give `output`
// (1, h, w, channels), no less than 0 if `options` says so, plus `added` (channels,) if there is one; or planes
// (1, planes, side * h, side * w). `second` may be the largest of 2x2 pixels (1, h / 2, w / 2, channels), or the channels
// from the `split`-th on.
template <int TAPS, bool CELLS, int N, int MB>
__device__ inline void convolve(const View& input, const View& coarse, const View& weights, const View& bias,
                                const View& added, const View& output, const View& second, const Options& options) {
    SHARED_MEMORY;
    constexpr int SIDE = SQUARE + TAPS - 1, COUNT = 2 * MB, BEFORE = TAPS == 3, WEIGHTS = STEP * N * 2;
    constexpr int PITCH = 16 * (SIDE * SIDE + (TAPS == 3 ? 5 : TAPS == 1));  // no bank twice at a time
    const int tiles = options.tiles, height = options.height, width = options.width;
    const int channels = CELLS ? 4 * input.size[3] : input.size[3], chunks = channels / 8;
    const int tile = blockIdx.x % tiles;
    const int wide = (width + SQUARE - 1) / SQUARE, high = (height + SQUARE - 1) / SQUARE;
    const Squares squares = {int(blockIdx.x) / tiles * COUNT, wide, wide * high, height, width};
    const int thread = threadIdx.x, warp = thread / 32, lane = thread % 32;
    char *const left = shared, *const right = shared + COUNT * chunks * PITCH;
    const int groups = channels / STEP, steps = TAPS * TAPS * groups;
    const char* const factors = reinterpret_cast<const char*>(weights.at) + size_t(tile) * steps * WEIGHTS;
    auto fetch = [&](int step) {
        for (int i = 16 * thread; i < WEIGHTS && step < steps; i += 16 * THREADS)
            copy_eight(right + step % AHEAD * WEIGHTS + i, factors + size_t(step) * WEIGHTS + i, true);
        end_batch();
    };
    const Eight* const pixels = eights(input);
    for (int i = thread; i < COUNT * SIDE * SIDE * chunks; i += THREADS) {
        const int chunk = i % chunks, place = i / chunks, square = place / (SIDE * SIDE), pixel = place % (SIDE * SIDE);
        const int y = squares.row(square) + pixel / SIDE - BEFORE, x = squares.column(square) + pixel % SIDE - BEFORE;
        char* const to = left + (square * chunks + chunk) * PITCH + 16 * pixel;
        const bool inside = squares.holds(square, y, x);
        const size_t at = (size_t(y) * width + x) * chunks + chunk;
        if (CELLS) {
            const int each = chunks / 4, v = 2 * y + chunk / (2 * each) - (TAPS == 2), u = 2 * x + chunk / each % 2 - (TAPS == 2);
            const bool there = squares.first + square < squares.all && v >= 0 && u >= 0 && v < input.size[1] && u < input.size[2];
            const size_t from = (size_t(v) * input.size[2] + u) * each + chunk % each;
            copy_eight(to, reinterpret_cast<const char*>(pixels + (there ? from : 0)), there);
        } else if (!coarse.size[0]) {
            copy_eight(to, reinterpret_cast<const char*>(pixels + (inside ? at : 0)), inside);
        } else {
            Eight value = {{0, 0, 0, 0}};
            if (inside) value = sum(pixels[at], eights(coarse)[(size_t(y / 2) * coarse.size[2] + x / 2) * chunks + chunk]);
            *reinterpret_cast<Eight*>(to) = value;
        }
    }
    for (int step = 0; step < AHEAD - 1; step++) fetch(step);
    // A warp makes 16 pixels, two rows of a square, at a time, 2 * MB times, of half of the channels.
    float sums[2 * MB][N / 16][4];
#pragma unroll
    for (int i = 0; i < 2 * MB; i++)
#pragma unroll
        for (int n = 0; n < N / 16; n++) sums[i][n][0] = sums[i][n][1] = sums[i][n][2] = sums[i][n][3] = 0.0f;
    const int part = warp / 2 * 2 * MB, half = warp % 2 * (N / 2);
    for (int step = 0; step < steps; step++) {
        wait_for_batches<AHEAD - 2>();
        __syncthreads();
        fetch(step + AHEAD - 1);
        const int tap = step / groups, first = step % groups * (STEP / 8), moved = 16 * (tap / TAPS * SIDE + tap % TAPS);
        const char* const now = right + step % AHEAD * WEIGHTS;
#pragma unroll
        for (int k = 0; k < STEP / 8; k += 2) {
            Two a[2 * MB][4], b[4];
#pragma unroll
            for (int i = 0; i < 2 * MB; i++) {
                const int square = (part + i) / 4, y = (part + i) % 4 * 2 + lane / 8 % 2, chunk = first + k + lane / 16;
                load_matrices(a[i], left + (square * chunks + chunk) * PITCH + 16 * (y * SIDE + lane % 8) + moved);
            }
#pragma unroll
            for (int n = 0; n < N / 32; n++) {
                const int column = half + 16 * n + lane / 16 * 8 + lane % 8;
                load_matrices(b, now + ((k + lane / 8 % 2) * N + column) * 16);
#pragma unroll
                for (int i = 0; i < 2 * MB; i++) {
                    add_product(sums[i][2 * n], a[i], b[0], b[1]);
                    add_product(sums[i][2 * n + 1], a[i], b[2], b[3]);
                }
            }
        }
    }
    wait_for_batches<0>();
    __syncthreads();
    // Through shared memory, so that all channels of a pixel are written together.
    constexpr int LINE = 2 * N + 16;
    const float *const offset = bias.at + tile * N, *const last = added.at + tile * N;
    auto keep = [&](int pixel, int column, float one, float two) {
        one += offset[column];
        two += offset[column + 1];
        Two both = options.positive ? rounded(fmaxf(one, 0.0f), fmaxf(two, 0.0f)) : rounded(one, two);
        if (added.size[0]) both = sum(both, rounded(last[column], last[column + 1]));
        *reinterpret_cast<Two*>(shared + pixel * LINE + 2 * column) = both;
    };
#pragma unroll
    for (int i = 0; i < 2 * MB; i++) {
#pragma unroll
        for (int n = 0; n < N / 16; n++) {
            const int pixel = (part + i) * 16 + lane / 4, column = half + 8 * n + lane % 4 * 2;
            keep(pixel, column, sums[i][n][0], sums[i][n][1]);
            keep(pixel + 8, column, sums[i][n][2], sums[i][n][3]);
        }
    }
    __syncthreads();
    Eight *const results = reinterpret_cast<Eight*>(output.at), *const others = reinterpret_cast<Eight*>(second.at);
    const int split = options.split, rest = second.size[3] / 8, begin = tile * (N / 8);
    const int all = split ? split / 8 : tiles * (N / 8);  // groups of 8 channels of a pixel of the output
    const bool whole = split || !options.side;
    for (int i = thread; whole && i < COUNT * SQUARE * SQUARE * (N / 8); i += THREADS) {
        const int chunk = i % (N / 8), pixel = i / (N / 8), square = pixel / (SQUARE * SQUARE), channel = begin + chunk;
        const int y = squares.row(square) + pixel / SQUARE % SQUARE, x = squares.column(square) + pixel % SQUARE;
        if (!squares.holds(square, y, x)) continue;
        const Eight value = *reinterpret_cast<const Eight*>(shared + pixel * LINE + 16 * chunk);
        const size_t at = size_t(y) * width + x;
        if (split && channel >= all) others[at * rest + channel - all] = value;
        else if (!options.side) results[at * all + channel] = value;
    }
    if (options.side == 1) open_planes<1, COUNT>(squares, begin * 8, N, LINE, shared, output, options);
    if (options.side == 2) open_planes<2, COUNT>(squares, begin * 8, N, LINE, shared, output, options);
    if (split || !rest) return;
    for (int i = thread; i < COUNT * SQUARE * SQUARE / 4 * (N / 8); i += THREADS) {
        const int chunk = i % (N / 8), place = i / (N / 8), square = place / 16, row = place % 16 / 4, column = place % 4;
        const int y = squares.row(square) / 2 + row, x = squares.column(square) / 2 + column;
        if (!squares.holds(square, 2 * y + 1, 2 * x + 1)) continue;
        const char* const from = shared + (square * SQUARE * SQUARE + 2 * row * SQUARE + 2 * column) * LINE + 16 * chunk;
        const Eight* const four[4] = {
            reinterpret_cast<const Eight*>(from), reinterpret_cast<const Eight*>(from + LINE),
            reinterpret_cast<const Eight*>(from + SQUARE * LINE), reinterpret_cast<const Eight*>(from + (SQUARE + 1) * LINE)};
        others[(size_t(y) * (width / 2) + x) * all + begin + chunk] = larger(larger(*four[0], *four[1]), larger(*four[2], *four[3]));
    }
}

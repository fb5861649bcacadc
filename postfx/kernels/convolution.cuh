// Convolutions of a network in half precision, channels last, as products on tensor cores: see
// postfx/runtime/convolutions.py, which appends a kernel for each kind of layer that a network has.
//
// A block of threads keeps all weights of its N channels in shared memory, or the parts that come
// next. It is a few groups of four warps, each of which takes squares of 8x8 pixels one after the
// other for itself: it multiplies the square's pixels by all weights at one go, and writes the
// results from its registers while the next pixels come. Meanwhile the others multiply. A square
// lies in shared memory with its border, by 8 channels; a tap's products begin at another pixel of
// it, so nothing is copied for them.

FN const Eight* eights(const View& view) { return reinterpret_cast<const Eight*>(view.at); }

FN Eight sum(const Eight& a, const Eight& b) {
    return {{sum(a.at[0], b.at[0]), sum(a.at[1], b.at[1]), sum(a.at[2], b.at[2]),
             sum(a.at[3], b.at[3])}};
}

FN Eight larger(const Eight& a, const Eight& b) {
    return {{larger(a.at[0], b.at[0]), larger(a.at[1], b.at[1]), larger(a.at[2], b.at[2]),
             larger(a.at[3], b.at[3])}};
}

// 64 pixels of the picture by their number: 8x8, or WIDE ones 32x2.
template <bool WIDE>
struct Square {
    static constexpr int ACROSS = WIDE ? 32 : 8, DOWN = 64 / ACROSS;
    int number, wide, all, height, width;

    FN Square(int number, int height, int width)
        : number(number),
          wide((width + ACROSS - 1) / ACROSS),
          all(wide * ((height + DOWN - 1) / DOWN)),
          height(height),
          width(width) {}

    FN int row() const { return number / wide * DOWN; }

    FN int column() const { return number % wide * ACROSS; }

    FN bool holds(int y, int x) const {
        return number < all && y >= 0 && x >= 0 && y < height && x < width;
    }
};

// Pixels along a side of a square with its border, and bytes of 8 channels of all of them: no bank
// twice at a time.
__device__ constexpr int side_of(int taps) {
    return 8 + taps - 1;
}

__device__ constexpr int pitch_of(int taps) {
    return 16 * (side_of(taps) * side_of(taps) + (taps == 3 ? 5 : taps == 1));
}

// Begin to copy a square with its border into shared memory, by 8 channels; a group does it
// together. Sums with what is enlarged are there at the end, a few of which are on their way at a
// time.
template <int TAPS, bool CELLS, bool COARSE, int CHUNKS, bool WIDE>
FN void fill(char* left, int thread, const Square<WIDE>& square, const View& input,
             const View& coarse) {
    constexpr int SIDE = WIDE ? Square<WIDE>::ACROSS : side_of(TAPS), BEFORE = TAPS == 3,
                  EACH = CHUNKS / 4, MANY = 3;
    constexpr int ALL = side_of(TAPS) * side_of(TAPS) * CHUNKS;
    const Eight* const pixels = eights(input);
    auto place = [&](int i) { return left + i % CHUNKS * pitch_of(TAPS) + 16 * (i / CHUNKS); };
    if constexpr (!COARSE) {
#pragma unroll 2
        for (int i = thread; i < ALL; i += GROUP) {
            const int chunk = i % CHUNKS, pixel = i / CHUNKS;
            const int y = square.row() + pixel / SIDE - BEFORE,
                      x = square.column() + pixel % SIDE - BEFORE;
            bool there = square.holds(y, x);
            size_t from = (size_t(y) * square.width + x) * CHUNKS + chunk;
            if (CELLS) {
                const int v = 2 * y + chunk / (2 * EACH) - (TAPS == 2),
                          u = 2 * x + chunk / EACH % 2 - (TAPS == 2);
                there = square.number < square.all && v >= 0 && u >= 0 && v < input.size[1]
                        && u < input.size[2];
                from = (size_t(v) * input.size[2] + u) * EACH + chunk % EACH;
            }
            copy_eight(place(i), reinterpret_cast<const char*>(pixels + (there ? from : 0)), there);
        }
        return;
    }
    AS_IT_IS for (int first = thread; first < ALL; first += MANY * GROUP) {
        Eight own[MANY], more[MANY];
        UNROLL for (int k = 0; k < MANY; k++) {
            const int i = first + k * GROUP, chunk = i % CHUNKS, pixel = i / CHUNKS;
            const int y = square.row() + pixel / SIDE - BEFORE,
                      x = square.column() + pixel % SIDE - BEFORE;
            own[k] = more[k] = {{0, 0, 0, 0}};
            if (i >= ALL || !square.holds(y, x)) continue;
            own[k] = pixels[(size_t(y) * square.width + x) * CHUNKS + chunk];
            more[k] = eights(coarse)[(size_t(y / 2) * coarse.size[2] + x / 2) * CHUNKS + chunk];
        }
        UNROLL for (int k = 0; k < MANY; k++)
            if (first + k * GROUP < ALL)
                *reinterpret_cast<Eight*>(place(first + k * GROUP)) = sum(own[k], more[k]);
    }
}

// What a layer is besides its tensors: size of the result, number of tiles, first of the `second`
// ones of its channels (0 if there are none), whether negative results become 0.
struct Options {
    int height, width, tiles, split, positive;
};

// Each of four lanes next to each other has two channels of four eights; the q-th one gets all of
// the q-th eight.
FN Eight whole_eight(const Two (&parts)[4], int q) {
    const bool odd = q % 2, late = q / 2;
    Two low[2], high[2];  // the first and the last half of eights q % 2 and q % 2 + 2
    UNROLL for (int i = 0; i < 2; i++) {
        const Two first = parts[2 * i], second = parts[2 * i + 1];
        const Two own = odd ? second : first, other = from_lane(odd ? first : second, 1);
        low[i] = odd ? other : own, high[i] = odd ? own : other;
    }
    const Two first = from_lane(late ? low[0] : low[1], 2),
              second = from_lane(late ? high[0] : high[1], 2);
    return late ? Eight{{first, second, low[1], high[1]}} : Eight{{low[0], high[0], first, second}};
}

// The activation of a logit, a sum and an offset: weight_of and gate_of of common.cuh and tanh, as
// exact as half precision. The channel is one of the eight from FIRST on, so it is mostly known
// when compiled which one.
template <int FIRST, int SHARES, int STATES>
FN float activated(float sum, float offset, int channel) {
    const float to_two = 1.44269504f;  // exp(x) is 2 to the power of x * to_two
    if (FIRST + 8 <= SHARES || (FIRST < SHARES && channel < SHARES)) {
        // from -STEEPEST to STEEPEST as 0 to 1
        const float range = 2.0f * STEEPEST, scale = 1.0f / range;
        return exp2_of(saturated(sum * scale + (offset * scale + 0.5f)) * (range * to_two)
                       - STEEPEST * to_two);
    }
    if (FIRST + 8 <= STATES || (FIRST < STATES && channel < STATES))
        return over_one(1.0f + exp2_of(sum * -to_two - offset * to_two));
    return 2.0f * over_one(1.0f + exp2_of(sum * (-2.0f * to_two) - offset * (2.0f * to_two)))
           - 1.0f;
}

// Write a thread's EIGHTS of planes from the FIRST on after their activations: of two pixels,
// `apart`, that are there, and with OUT 2 of each its left and right part, which are RIGHT eights
// apart.
template <int FIRST, int EIGHTS, int OUT, int RIGHT, int PLANES, int SHARES, int STATES, int COUNT>
FN void write_planes(const float (&sums)[COUNT], const Pair* offsets, Half* to, size_t plane,
                     int apart, const bool (&there)[2]) {
    const int q = threadIdx.x % 4, own = 2 * q;
    if constexpr (EIGHTS > 0 && FIRST < PLANES) {
        constexpr int AT = COUNT - 4 * (EIGHTS + RIGHT);  // its sums
        const Pair one = offsets[0], two = offsets[4 * RIGHT];
        UNROLL for (int i = 0; i < 4; i++) {
            const int e = i % 2, channel = FIRST + own + e;
            Half* const place = to + e * plane + i / 2 * apart;
            const bool writes = there[i / 2] && (FIRST + 8 <= PLANES || channel < PLANES);
            const float left = activated<FIRST, SHARES, STATES>(sums[AT + i], e ? one.y : one.x,
                                                                channel);
            if constexpr (OUT == 1) {
                if (writes) *place = to_half(left);
            } else {
                const float beside = sums[AT + 4 * RIGHT + i];
                const float right = activated<FIRST, SHARES, STATES>(beside, e ? two.y : two.x,
                                                                     channel);
                const Two both = rounded(left, right);
                if (writes) *reinterpret_cast<Two*>(place) = both;
            }
        }
        write_planes<FIRST + 8, EIGHTS - 1, OUT, RIGHT, PLANES, SHARES, STATES>(
            sums, offsets + 4, to + 8 * plane, plane, apart, there);
    }
}

// A convolution of TAPS x TAPS pixels of `input` (1, h, w, C); or, with CELLS, of cells of 2x2
// pixels of (1, 2 h, 2 w, C / 4), which begin a pixel before the first with two taps. With COARSE,
// `coarse` (1, h / 2, w / 2, C) is enlarged and added to the input. `weights` (tiles of N channels,
// steps, 4, N, 8) and `bias` (channels,) give `output` (1, h, w, channels), no less than 0 if
// `options` says so, plus `added` (channels,) if there is one. `second` may be the largest of 2x2
// pixels (1, h / 2, w / 2, channels), or the channels from the `split`-th on.
//
// If OUT is not 0, `output` is planes after their activations (1, PLANES, OUT * h, OUT * w): first
// SHARES weights, then shares before STATES, then states. With OUT 2 a tile has all planes of the
// two pixels of a row, or half of them, one after the other, the upper row's tiles first. With OUT
// 1 the planes are in the first tile.
//
// With SLOTS the weights do not stay in shared memory: half a tap's lies in each of so many slots,
// and the last warp that is through with it fills it anew. So all groups of a block go through the
// weights side by side.
template <int TAPS, bool CELLS, bool COARSE, int C, int N, int SLOTS, int OUT, int PLANES,
          int SHARES, int STATES>
FN void convolve(const View& input, const View& coarse, const View& weights, const View& bias,
                 const View& added, const View& output, const View& second,
                 const Options& options) {
    SHARED_MEMORY;
    constexpr int CHUNKS = C / 8, SIDE = side_of(TAPS), PITCH = pitch_of(TAPS),
                  WEIGHTS = TAPS * TAPS * C * N * 2;
    constexpr int PART = CHUNKS / 2 * N * 16, PARTS = 2 * TAPS * TAPS,
                  HELD = SLOTS ? SLOTS * PART : WEIGHTS;
    constexpr int RING = SLOTS ? SLOTS : 1;
    // While products of a wide tile run, the next factors come; with narrow ones, other groups
    // multiply then.
    constexpr bool EARLY = N > 96;
    constexpr int ALL = CHUNKS / 2, SOME = ALL % 5 == 0          ? 5
                                           : ALL % 4 == 0        ? 4
                                           : ALL == 6 && N == 32 ? 3
                                                                 : ALL;
    constexpr int AT_ONCE = EARLY ? 1 : SLOTS ? CHUNKS / 4 : SOME, STEPS = ALL / AT_ONCE;
    const int tiles = options.tiles, blocks = gridDim.x / tiles, tile = blockIdx.x % tiles,
              groups = blockDim.x / GROUP;
    const int group = threadIdx.x / GROUP, thread = threadIdx.x % GROUP;
    const int warp = thread / 32, lane = thread % 32, q = lane % 4;
    const int block = blockIdx.x / tiles, apart = blocks * groups;
    Square<OUT != 0> square(group * blocks + block, options.height, options.width);
    char* const left = shared + HELD + group * CHUNKS * PITCH;
    const char* const factors = reinterpret_cast<const char*>(weights.at) + size_t(tile) * WEIGHTS;
    Slot* const slots = reinterpret_cast<Slot*>(shared + HELD + groups * CHUNKS * PITCH);
    // that go through the slots
    const int parts = (square.all - block + apart - 1) / apart * PARTS;
    int part = 0;
    if (SLOTS && threadIdx.x == 0)
        for (int i = 0; i < SLOTS; i++) {
            empty(slots[i]);
            fill_slot(slots[i], shared + i * PART, factors + i * PART, PART);
        }
    if (!SLOTS)
        for (int i = 16 * threadIdx.x; i < WEIGHTS; i += 16 * blockDim.x)
            copy_eight(shared + i, factors + i, true);
    fill<TAPS, CELLS, COARSE, CHUNKS>(left, thread, square, input, coarse);
    wait_for_copies();
    show_to_products();
    __syncthreads();
    auto release = [&](int part) {
        if (lane || !leave_slot(slots[part % RING], 4 * groups) || part + SLOTS >= parts) return;
        const int next = part + SLOTS;
        fill_slot(slots[part % RING], shared + part % RING * PART, factors + next % PARTS * PART,
                  PART);
    };
    const int begin = tile * N, split = options.split;
    // In their first round groups multiply one after the other, so that from then on some multiply
    // while others wait.
    bool first = !SLOTS && square.all > 2 * apart;
    while ((SLOTS ? square.number - group * blocks : square.number) < square.all) {
        float sums[N / 2];
        UNROLL for (int i = 0; i < N / 2; i++) sums[i] = 0.0f;
        // A warp has 16 pixels.
        Two own[EARLY ? 2 : 1][AT_ONCE][4];
        auto load = [&](Two (&to)[AT_ONCE][4], int tap, int step) {
            const int pixel = (2 * warp + lane / 8 % 2 + tap / TAPS) * SIDE + lane % 8 + tap % TAPS;
            const char* const pixels = left + 16 * pixel + (2 * step * AT_ONCE + lane / 16) * PITCH;
            UNROLL for (int k = 0; k < AT_ONCE; k++) load_matrices(to[k], pixels + 2 * k * PITCH);
        };
        if (first && group) take_turn(group);
        if (EARLY) load(own[0], 0, 0);
        AS_IT_IS for (int tap = 0; tap < TAPS * TAPS; tap++) {
            UNROLL for (int step = 0; step < STEPS; step++) {
                // steps that share a part of the weights
                constexpr int HALF = SLOTS ? STEPS / 2 : 1;
                const bool enters = SLOTS && step % HALF == 0,
                           leaves = SLOTS && step % HALF == HALF - 1;
                const int now = EARLY ? step % 2 : 0;
                if (!EARLY) load(own[0], tap, step);
                if (enters) wait_for_slot(slots[part % RING], part / RING);
                const char* const right = SLOTS ? shared + part % RING * PART
                                                      + step % HALF * AT_ONCE * N * 32
                                                : shared + (tap * STEPS + step) * AT_ONCE * N * 32;
                begin_products();
                UNROLL for (int k = 0; k < AT_ONCE; k++)
                    multiply(sums, own[now][k], matrices(right + k * N * 32, N * 16, 128));
                if (EARLY) {
                    end_products_before(own[1 - now]);
                    if (enters && tap + step) release(part - 1);
                    if (step + 1 < STEPS) load(own[1 - now], tap, step + 1);
                    else if (tap + 1 < TAPS * TAPS) load(own[1 - now], tap + 1, 0);
                } else {
                    end_products(sums, own[0]);
                    if (leaves) release(part);
                }
                if (leaves) part++;
            }
        }
        if (EARLY) {
            end_products(sums, own[0]);
            if (SLOTS) release(part - 1);
        }
        if (first && group + 1 < groups && square.number + blocks < square.all) give_turn(group);
        first = false;
        const auto done = square;
        square.number += apart;
        meet_group(group);
        if (square.number < square.all)
            fill<TAPS, CELLS, COARSE, CHUNKS>(left, thread, square, input, coarse);

        // A lane has channels 2 q and 2 q + 1 of each eight, of two pixels one below the other, or
        // of a row, 8 apart.
        constexpr int ASIDE = OUT ? 8 : 0, BELOW = OUT ? 0 : 1;
        const int x = done.column() + lane / 4 + (OUT ? warp % 2 * 16 : 0);
        const int y = done.row() + (OUT ? warp / 2 : 2 * warp);
        const bool there[2] = {done.holds(y, x), done.holds(y + BELOW, x + ASIDE)};
        const Pair* const offsets = reinterpret_cast<const Pair*>(bias.at) + begin / 2 + q;
        if constexpr (OUT > 0) {
            // eights from a pixel of a row to the next
            constexpr int RIGHT = OUT == 2 ? N / 16 : 0;
            // tiles that share a row
            constexpr int EIGHTS = N / 8 - RIGHT, SHARED = OUT == 2 ? 2 * PLANES / N : 1;
            static_assert(SHARED <= 2, "a tile has half of a row's planes at least");
            const int across = OUT * done.width, row = OUT * y + (OUT == 2 ? tile / SHARED : 0),
                      apart = OUT * ASIDE;
            const bool later = SHARED == 2 && tile % 2;
            const size_t plane = size_t(across) * OUT * done.height,
                         at = size_t(row) * across + OUT * x;
            Half* const to = reinterpret_cast<Half*>(output.at) + (later * (N / 2) + 2 * q) * plane
                             + at;
            if (later)
                write_planes<N / 2, EIGHTS, OUT, RIGHT, PLANES, SHARES, STATES>(
                    sums, offsets, to, plane, apart, there);
            else if (OUT == 2 || tile == 0)
                write_planes<0, EIGHTS, OUT, RIGHT, PLANES, SHARES, STATES>(sums, offsets, to,
                                                                            plane, apart, there);
        }
        if constexpr (OUT < 2) {
            Two results[2][N / 8];
            UNROLL for (int n = 0; n < N / 8; n++) {
                const Pair offset = offsets[4 * n];
                Two last = 0;
                if (added.size[0])
                    last = rounded(added.at[begin + 8 * n + 2 * q],
                                   added.at[begin + 8 * n + 2 * q + 1]);
                UNROLL for (int k = 0; k < 2; k++) {
                    const float one = sums[4 * n + 2 * k] + offset.x,
                                two = sums[4 * n + 2 * k + 1] + offset.y;
                    const Two both = options.positive ? rounded(fmaxf(one, 0.0f), fmaxf(two, 0.0f))
                                                      : rounded(one, two);
                    results[k][n] = added.size[0] ? sum(both, last) : both;
                }
            }
            Eight* const to = reinterpret_cast<Eight*>(output.at);
            Eight* const others = reinterpret_cast<Eight*>(second.at);
            const int all = split ? split / 8 : tiles * (N / 8), rest = second.size[3] / 8;
            UNROLL for (int n = 0; n < N / 8; n += 4) {
                const int eight = begin / 8 + n + q;
                const bool own[2] = {there[0] && n + q < N / 8, there[1] && n + q < N / 8};
                if (OUT && (!split || begin + 8 * (n + 4) <= split)) continue;
                UNROLL for (int k = 0; k < 2; k++) {
                    Two parts[4];
                    UNROLL for (int i = 0; i < 4; i++) {
                        parts[i] = n + i < N / 8 ? results[k][n + i] : 0;
                    }
                    const Eight value = whole_eight(parts, q);
                    const size_t at = size_t(y + BELOW * k) * done.width + x + ASIDE * k;
                    if (!own[k]) continue;
                    if (split && eight >= all) others[at * rest + eight - all] = value;
                    else if (!OUT) to[at * all + eight] = value;
                }
                if (split || !rest) continue;
                Two most[4];
                UNROLL for (int i = 0; i < 4; i++) {
                    most[i] = n + i < N / 8 ? larger(results[0][n + i], results[1][n + i]) : 0;
                    most[i] = larger(most[i], from_lane(most[i], 4));
                }
                const Eight value = whole_eight(most, q);
                if (own[0] && x % 2 == 0 && done.holds(y + 1, x + 1))
                    others[(size_t(y / 2) * (done.width / 2) + x / 2) * all + eight] = value;
            }
        }
        wait_for_copies();
        meet_group(group);
    }
}

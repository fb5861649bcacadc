// Small networks by a warp's matrix units: 32 points at once, in registers alone.
//
// A product has 16 rows, so 32 points are two. Lane 4 g + q holds numbers 2 q and 2 q + 1 of every
// eight, of the four points that lanes 4 g to 4 g + 3 came with: rows g and g + 8 of both products.
// So a layer's sums lie where the next layer's factors have to.
#pragma once

constexpr int MOST_MATRIX_WIDTH = 64;   // more numbers of a layer do not stay in registers
constexpr int LEAST_MATRIX_WIDTH = 16;  // fewer are as fast by a thread

FN constexpr int eights_of(int count) { return (count + 7) / 8; }

// Numbers of a warp's points: of both products, of each eight, rows g and g + 8 with two each.
template <int COUNT> struct Dealt {
    float at[2][eights_of(COUNT)][4];
};

// The pair of a point's numbers 8 e + 2 k and 8 e + 2 k + 1; 0 beside them.
template <int COUNT> FN void take_pair(const float* own, int first, float& x, float& y) {
    x = first < COUNT ? own[first] : 0.0f;
    y = first + 1 < COUNT ? own[first + 1] : 0.0f;
}

// Deal out what each lane holds of its own point. Four lanes give each other their pairs in turn.
template <int COUNT> FN void deal(const float* own, Dealt<COUNT>& dealt) {
    const int q = threadIdx.x % 4;
    UNROLL for (int e = 0; e < eights_of(COUNT); e++) {
        UNROLL for (int turn = 0; turn < 4; turn++) {
            const int other = q ^ turn;
            float x = 0.0f, y = 0.0f;
            UNROLL for (int k = 0; k < 4; k++) {  // registers have no index
                float left, right;
                take_pair<COUNT>(own, 8 * e + 2 * k, left, right);
                x = k == other ? left : x, y = k == other ? right : y;
            }
            x = __shfl_xor_sync(~0u, x, turn), y = __shfl_xor_sync(~0u, y, turn);
            UNROLL for (int i = 0; i < 4; i++) {
                float* const pair = dealt.at[i / 2][e] + i % 2 * 2;
                pair[0] = i == other ? x : pair[0], pair[1] = i == other ? y : pair[1];
            }
        }
    }
}

// The reverse: each lane gets all numbers of its own point.
template <int COUNT> FN void collect(const Dealt<COUNT>& dealt, float* own) {
    const int q = threadIdx.x % 4;
    UNROLL for (int e = 0; e < eights_of(COUNT); e++) {
        UNROLL for (int turn = 0; turn < 4; turn++) {
            const int other = q ^ turn;
            float x = 0.0f, y = 0.0f;
            UNROLL for (int i = 0; i < 4; i++) {
                const float* const pair = dealt.at[i / 2][e] + i % 2 * 2;
                x = i == other ? pair[0] : x, y = i == other ? pair[1] : y;
            }
            x = __shfl_xor_sync(~0u, x, turn), y = __shfl_xor_sync(~0u, y, turn);
            UNROLL for (int k = 0; k < 4; k++) {
                const int first = 8 * e + 2 * k;
                if (first < COUNT) own[first] = k == other ? x : own[first];
                if (first + 1 < COUNT) own[first + 1] = k == other ? y : own[first + 1];
            }
        }
    }
}

// A layer of all points: its biases, and 8 inputs after 8 inputs.
template <int READS, int MAKES>
FN void multiply_points(const float* weights, const Dealt<READS>& seen, Dealt<MAKES>& made) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4;
    const float* const biases = weights + READS * MAKES;
    UNROLL for (int n = 0; n < eights_of(MAKES); n++) {
        UNROLL for (int k = 0; k < 4; k++) {
            const int column = 8 * n + 2 * q + k % 2;
            made.at[0][n][k] = made.at[1][n][k] = column < MAKES ? biases[column] : 0.0f;
        }
    }
    UNROLL for (int step = 0; step < eights_of(READS); step++) {
        unsigned high[2][4], low[2][4];
        UNROLL for (int k = 0; k < 8; k++) {
            const int place = k % 2 * 2 + k / 2 % 2;  // rows g and g + 8 of a column follow it
            split(seen.at[k / 4][step][k % 4], high[k / 4][place], low[k / 4][place]);
        }
        UNROLL for (int n = 0; n < eights_of(MAKES); n++) {
            const int row = 8 * n + g, column = 8 * step + 2 * q;
            unsigned whole[2], rest[2];
            UNROLL for (int k = 0; k < 2; k++) {
                const bool is_there = row < MAKES && column + k < READS;
                split(is_there ? weights[row * READS + column + k] : 0.0f, whole[k], rest[k]);
            }
            UNROLL for (int i = 0; i < 2; i++) {
                float sums[4] = {0.0f, 0.0f, 0.0f, 0.0f};  // small products first
                add_product(sums, low[i], whole);
                add_product(sums, high[i], rest);
                add_product(sums, high[i], whole);
                UNROLL for (int k = 0; k < 4; k++) made.at[i][n][k] += sums[k];
            }
        }
    }
}

template <int KIND, int READS, int MAKES, int... REST> struct WarpLayers {
    static constexpr bool FITS = READS <= MOST_MATRIX_WIDTH && MAKES <= MOST_MATRIX_WIDTH
                                 && WarpLayers<KIND, MAKES, REST...>::FITS;
    static constexpr int WIDEST = MAKES > WarpLayers<KIND, MAKES, REST...>::WIDEST
                                      ? MAKES : WarpLayers<KIND, MAKES, REST...>::WIDEST;
    FN_MEMBER static void run(const float* parameters, const Dealt<READS>& seen, float* values) {
        Dealt<MAKES> made;
        multiply_points<READS, MAKES>(parameters, seen, made);
        UNROLL for (int i = 0; i < 2; i++) {
            UNROLL for (int n = 0; n < eights_of(MAKES); n++) {
                UNROLL for (int k = 0; k < 4; k++)
                    made.at[i][n][k] = activated<KIND, float>(made.at[i][n][k]).value;
            }
        }
        WarpLayers<KIND, MAKES, REST...>::run(parameters + (READS + 1) * MAKES, made, values);
    }
};
template <int KIND, int READS, int MAKES> struct WarpLayers<KIND, READS, MAKES> {  // the last one
    static constexpr bool FITS = READS <= MOST_MATRIX_WIDTH && MAKES <= MOST_MATRIX_WIDTH;
    static constexpr int WIDEST = 0;  // of what layers between make
    FN_MEMBER static void run(const float* parameters, const Dealt<READS>& seen, float* values) {
        Dealt<MAKES> made;
        multiply_points<READS, MAKES>(parameters, seen, made);
        collect<MAKES>(made, values);
    }
};

// Of the points of all lanes of a warp, which come together; whether the network is one for it.
template <int KIND, int READS, int... REST>
FN bool mlp_by_warp(const float* parameters, const float* features, float* values) {
    typedef WarpLayers<KIND, READS, REST...> Layers;
    if constexpr (Layers::FITS && Layers::WIDEST >= LEAST_MATRIX_WIDTH) {
        if (__activemask() != ~0u) return false;
        Dealt<READS> dealt = {};
        deal<READS>(features, dealt);
        Layers::run(parameters, dealt, values);
        return true;
    }
    return false;
}

// Layers of small networks, for the kernels of neural.cu. What the tensors hold: see
// postfx/kernels/neural.py.
//
// A warp takes 16 or 32 points through all layers in its registers; the weights lie in its block's
// shared memory, if there is room. Products are made by tensor cores: each number is a sum of two
// with 11 bits, and three products of these are added up in float32 (Ootomo and Yokota 2022), so
// that results have float32's precision.
#include "number.cuh"
#include "gelu.h"
#include "matrix.cuh"

#ifdef __CUDACC__
extern __shared__ __align__(16) float memory[];

FN int shared_floats() {
    unsigned bytes;
    asm("mov.u32 %0, %%dynamic_smem_size;" : "=r"(bytes));
    return int(bytes / 4);
}
#endif

const int WARPS = THREADS / 32, TILE = 16, MOST_POINTS = TILE * WARPS, GROUPED = 4;

FN float relu_of(float z) { return z < 0.0f ? 0.0f : z; }  // NaN stays NaN

FN int up_to(int size, int unit) { return (size + unit - 1) / unit * unit; }

// Rows in shared memory begin at multiples of 32 floats. In row r, column c lies at c ^ turn_of(r):
// so the numbers that a warp reads at once lie in different banks, be they two columns of 8 rows or
// 8 columns of 4 rows.
FN int turn_of(int row) { return 8 * ((row & 3) ^ (row >> 2 & 1)); }

// What every block knows of the network: sizes; floats before each layer's inputs in a point's
// rows, before its parameters in the shared memory, and in the tensor.
struct Network {
    int layers, inputs, encoded, bands, activation, widest;
    int size[MOST_LAYERS + 1], rows[MOST_LAYERS + 2], space[MOST_LAYERS + 1],
        count[MOST_LAYERS + 1];
};

// Rows of a layer's weights in the shared memory.
FN int height_of(int makes) { return makes <= 8 ? 8 : up_to(makes, 32); }

// Floats of these rows.
FN int stride_of(int widest) { return widest <= 64 ? 64 : MOST_WIDTH; }

FN void read_network(const View& view, Network& net) {
    const float* const at = view.at;
    if (threadIdx.x == 0) {
        int size[MOST_LAYERS + 1];  // sizes beyond the last layer are 0
        int widest = 0, rows = 0, space = 0, count = 0;
        UNROLL for (int layer = 0; layer <= MOST_LAYERS; layer++) {
            size[layer] = int(at[SIZES + layer]);
        }
        net.layers = int(at[LAYERS]), net.inputs = int(at[INPUTS]),
        net.activation = int(at[ACTIVATION]);
        net.encoded = int(at[ENCODED]), net.bands = int(at[BANDS]);
        UNROLL for (int layer = 0; layer <= MOST_LAYERS; layer++) widest = max(widest, size[layer]);
        UNROLL for (int layer = 0; layer <= MOST_LAYERS; layer++) {
            net.size[layer] = size[layer], net.rows[layer] = rows, net.space[layer] = space,
            net.count[layer] = count;
            rows += up_to(size[layer], 32);
            const int makes = layer < MOST_LAYERS ? size[layer + 1] : 0;
            space += makes ? (height_of(makes) + 1) * stride_of(widest) : 0;
            count += (size[layer] + 1) * makes;
        }
        net.rows[MOST_LAYERS + 1] = rows, net.widest = widest;
    }
    __syncthreads();
}

// A layer's parameters. In the shared memory rows have `stride` floats, 0 beside the weights, and
// the last is the bias.
struct Layer {
    const float *weights, *biases;
    int reads, makes;
};

template <int WIDTH, bool SHARED>
FN Layer layer_of(const Network& net, int layer, const float* at) {
    const int reads = net.size[layer], makes = net.size[layer + 1];
    at += SHARED ? net.space[layer] : net.count[layer];
    return {at, at + (SHARED ? height_of(makes) * WIDTH : reads * makes), reads, makes};
}

// Copy all parameters into the shared memory, where they are after a barrier. Many are read before
// any is written, because each alone would wait for the card's memory.
template <int WIDTH>
FN void load_layers(const Network& net, const float* parameters, float* shared) {
    const int many = 16;
    for (int layer = 0; layer < net.layers; layer++) {
        const Layer from = layer_of<WIDTH, false>(net, layer, parameters);
        const int height = height_of(from.makes), floats = height * WIDTH;
        float* const to = shared + net.space[layer];
        const float bias = threadIdx.x < from.makes ? from.biases[threadIdx.x] : 0.0f;
        for (int begin = threadIdx.x; begin < floats; begin += many * THREADS) {
            float values[many];
            UNROLL for (int n = 0; n < many; n++) {
                const int k = begin + n * THREADS, j = k / WIDTH, i = k % WIDTH;
                values[n] = j < from.makes && i < from.reads ? from.weights[j * from.reads + i]
                                                             : 0.0f;
            }
            UNROLL for (int n = 0; n < many; n++) {
                const int k = begin + n * THREADS, j = k / WIDTH, i = k % WIDTH;
                if (k < floats) to[j * WIDTH + (i ^ turn_of(j))] = values[n];
            }
        }
        if (threadIdx.x < WIDTH) to[floats + threadIdx.x] = bias;
    }
    __syncthreads();
}

// Sine of whole pi + rest: Taylor series, absolute error below 2e-7 for rest in [-pi/2, pi/2].
FN float sine_of(float whole, float rest) {
    const float square = rest * rest, half = whole * 0.5f,
                sign = 1.0f - 4.0f * (half - floorf(half));
    float sine = -1.0f / 39916800.0f;
    sine = sine * square + 1.0f / 362880.0f;
    sine = sine * square - 1.0f / 5040.0f;
    sine = sine * square + 1.0f / 120.0f;
    sine = sine * square - 1.0f / 6.0f;
    return sign * (sine * square * rest + rest);
}

// Sine and cosine of half turns.
FN Pair waves_of(float turns) {
    const float whole = floorf(turns + 0.5f), rest = turns - whole;
    return {sine_of(whole, PI * rest), sine_of(whole, PI * (0.5f - fabsf(rest)))};
}

// GELU and sine, as on the CPU, and their slopes; a ReLU is made where the sums are.
FN void activate(int kind, float& z, float& slope) {
    if (kind == SINE) {
        // pi in three parts, the first two of few bits
        const float whole = floorf(z * (1.0f / PI) + 0.5f);
        const float rest = z - whole * 3.140625f - whole * 9.67502593994e-4f
                           - whole * 1.50995799e-7f;
        slope = sine_of(whole, 0.5f * PI - fabsf(rest));
        z = sine_of(whole, rest);
        return;
    }
    const Active<float> found = gelu_of<float>(z);
    slope = found.slope;
    z = found.value;
}

// The sums of a warp: for DEPTH times 16 points up to 8 TILES numbers. Of lane 4 g + q: of points g
// and g + 8, numbers 2 q and 2 q + 1 of each eight.
template <int TILES, int DEPTH>
using Sums = float[DEPTH][TILES][4];

// sums += rows right, for `steps` times 8 numbers of a warp's rows to `tiles` times 8. `right(step,
// tile)` is what this lane needs of an (8, 8) block: rows 2 q and 2 q + 1, column g. Tensor cores
// round towards 0, so that sums over many steps are made outside of them.
template <int TILES, int DEPTH, int GROUP, class Right>
FN void add_rows(Sums<TILES, DEPTH>& sums, const float* rows, int width, int steps, int tiles,
                 Right right) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, turn = turn_of(g);
#pragma unroll(TILES > 8 ? 1 : 2)
    for (int step = 0; step < steps; step++) {
        const float* const at = rows + g * width + ((8 * step) ^ turn) + 2 * q;
        unsigned high[DEPTH][4], low[DEPTH][4];
        UNROLL for (int k = 0; k < 2 * DEPTH; k++) {
            const Pair both = *reinterpret_cast<const Pair*>(at + 8 * k * width);
            split(both.x, high[k / 2][k % 2], low[k / 2][k % 2]);
            split(both.y, high[k / 2][2 + k % 2], low[k / 2][2 + k % 2]);
        }
        UNROLL for (int first = 0; first < (GROUP == 1 ? 1 : TILES); first += GROUP) {
            if (first >= tiles) break;
            unsigned whole[GROUP][2], rest[GROUP][2];
            float parts[DEPTH][GROUP][4] = {};
            UNROLL for (int n = 0; n < GROUP; n++) {
                const Pair both = right(step, first + n);
                split(both.x, whole[n][0], rest[n][0]);
                split(both.y, whole[n][1], rest[n][1]);
            }
            UNROLL for (int k = 0; k < 3 * DEPTH * GROUP; k++) {  // small products first
                const int d = k % DEPTH, n = k / DEPTH % GROUP, what = k / DEPTH / GROUP;
                add_product(parts[d][n], what == 0 ? low[d] : high[d],
                            what == 1 ? rest[n] : whole[n]);
            }
            UNROLL for (int d = 0; d < DEPTH; d++) {
                UNROLL for (int k = 0; k < 4 * GROUP; k++)
                    sums[d][first + k / 4][k % 4] += parts[d][k / 4][k % 4];
            }
        }
    }
}

template <int TILES, int DEPTH, class Right>
FN void multiply(Sums<TILES, DEPTH>& sums, const float* rows, int inner, int columns, Right right) {
    const int steps = (inner + 7) / 8, tiles = (columns + 7) / 8, width = up_to(inner, 32);
    if (tiles > 1) {
        add_rows<TILES, DEPTH, 4>(sums, rows, width, steps, tiles, right);
    } else {
        add_rows<TILES, DEPTH, 1>(sums, rows, width, steps, tiles, right);
    }
}

// Call `call(tile, half, pair)` for all pairs of numbers that this lane has of 16 points' rows.
template <int TILES, class Call>
FN void each_pair(float* at, int width, Call call) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, turn = turn_of(g);
    UNROLL for (int n = 0; n < TILES; n++) {
        if (8 * n >= width) break;
        UNROLL for (int r = 0; r < 2; r++) {
            call(n, r,
                 *reinterpret_cast<Pair*>(at + (g + 8 * r) * width + ((8 * n) ^ turn) + 2 * q));
        }
    }
}

// What the first layer reads of some points, and 0 beside it, in a warp's rows; from `end` on
// points are 0. Numbers of 16 points are read before any is written, because each alone would wait
// for the card's memory.
FN void encode_points(const Network& net, const View& points, int first, int end, int count,
                      float* rows) {
    const int width = up_to(net.size[0], 32), lane = threadIdx.x % 32, p = lane % TILE,
              turn = turn_of(p);
    for (int column = lane; column < width; column += 32) {
        if (column >= net.inputs && column < net.size[0]) continue;
        const float* const from = points.at + size_t(first) * net.inputs + column;
        for (int begin = 0; begin < count; begin += TILE) {
            float numbers[TILE];
            UNROLL for (int k = 0; k < TILE; k++) {
                const bool is_there = column < net.inputs && first + begin + k < end;
                numbers[k] = is_there ? from[(begin + k) * net.inputs] : 0.0f;
            }
            UNROLL for (int k = 0; k < TILE; k++)
                rows[(begin + k) * width + (column ^ turn_of(k))] = numbers[k];
        }
    }
    __syncwarp();
    for (float* row = rows + p * width; net.bands && row < rows + count * width;
         row += TILE * width) {
        for (int i = 0; i < net.encoded; i++) {  // a lane for every other band of a point
            const float number = row[i ^ turn];
            float factor = lane < TILE ? 1.0f : 2.0f;
            int column = net.inputs + 2 * (i + lane / TILE * net.encoded);
#pragma unroll 2
            for (int band = lane / TILE; band < net.bands; band += 2) {
                const Pair waves = waves_of(number * factor);
                row[column ^ turn] = waves.x;
                row[(column + 1) ^ turn] = waves.y;
                factor *= 4.0f, column += 4 * net.encoded;
            }
        }
    }
    __syncwarp();
}

// A layer of DEPTH times 16 points, before its activation; beyond the columns that it makes numbers
// are of no use.
template <int TILES, int DEPTH, bool SHARED>
FN void run_layer(const Layer& layer, const float* rows, Sums<TILES, DEPTH>& sums) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, turn = turn_of(g);
    UNROLL for (int n = 0; n < TILES; n++) {
        UNROLL for (int k = 0; k < 4; k++) {
            const int column = 8 * n + 2 * q + k % 2;
            const float bias = SHARED || column < layer.makes ? layer.biases[column] : 0.0f;
            UNROLL for (int d = 0; d < DEPTH; d++) sums[d][n][k] = bias;
        }
    }
    multiply<TILES, DEPTH>(sums, rows, layer.reads, layer.makes, [&](int step, int tile) {
        if (SHARED) {
            const float* const row = layer.weights + (8 * tile + g) * 8 * TILES;
            return *reinterpret_cast<const Pair*>(row + ((8 * step) ^ turn) + 2 * q);
        }
        const float* const row = layer.weights + min(8 * tile + g, layer.makes - 1) * layer.reads;
        const int column = 8 * step + 2 * q, last = layer.reads - 1;
        return Pair{row[min(column, last)], row[min(column + 1, last)]};
    });
}

// A layer's activation of 16 points in a warp's rows, 0 beside what it makes, and slopes unless it
// is a ReLU.
template <int TILES>
FN void activate_rows(int kind, int makes, const float (&sums)[TILES][4], float* rows,
                      float* slopes) {
    const int width = up_to(makes, 32), q = threadIdx.x % 4, column = threadIdx.x % 32;
    each_pair<TILES>(rows, width, [&](int n, int r, Pair& pair) {
        const float x = sums[n][2 * r], y = sums[n][2 * r + 1];
        pair.x = 8 * n + 2 * q < makes ? kind == RELU ? relu_of(x) : x : 0.0f;
        pair.y = 8 * n + 2 * q + 1 < makes ? kind == RELU ? relu_of(y) : y : 0.0f;
    });
    __syncwarp();
    if (kind == RELU) return;
#pragma unroll 2
    // the same numbers: this code is too long to be there for each
    for (int k = 0; k < TILE * width; k += 32) {
        float slope;
        const int p = k / width, c = k % width + column, at = p * width + (c ^ turn_of(p));
        if (c >= makes) continue;
        activate(kind, rows[at], slope);
        if (slopes) slopes[at] = slope;
    }
    __syncwarp();
}

template <int TILES, int DEPTH, bool SHARED>
FN void run_all(const Network& net, const float* weights, const View& points, const View& values) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, total = values.size[0],
              last = net.layers - 1;
    const int warp = threadIdx.x / 32, together = TILE * DEPTH;
    float* const rows = memory + warp * together * 8 * TILES;
    for (int tile = blockIdx.y + warp * gridDim.y; tile * together < total;
         tile += gridDim.y * WARPS) {
        const int first = tile * together;
        encode_points(net, points, first, total, together, rows);
        for (int index = 0; index <= last; index++) {
            const Layer layer = layer_of<8 * TILES, SHARED>(net, index, weights);
            Sums<TILES, DEPTH> sums;
            run_layer<TILES, DEPTH, SHARED>(layer, rows, sums);
            __syncwarp();
            if (index < last) {
                const int size = TILE * up_to(layer.makes, 32);
                UNROLL for (int d = 0; d < DEPTH; d++) {
                    activate_rows(net.activation, layer.makes, sums[d], rows + d * size, nullptr);
                }
                continue;
            }
            UNROLL for (int k = 0; k < 4 * TILES * DEPTH; k++) {
                const int d = k / 4 / TILES, n = k / 4 % TILES, column = 8 * n + 2 * q + k % 2;
                const int p = first + TILE * d + g + k % 4 / 2 * 8;
                if (column < layer.makes && p < total)
                    values.at[size_t(p) * layer.makes + column] = sums[d][n][k % 4];
            }
        }
    }
}

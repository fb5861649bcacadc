// Small networks: see postfx/kernels/neural.py, which says what the tensors hold.
//
// A block of 8 warps takes some points at a time through all layers in its shared memory; the weights lie there, too,
// if there is room. Products are made by tensor cores: each number is a sum of two with 11 bits, and three products of
// these are added up in float32 (Ootomo and Yokota 2022), so that results have float32's precision.
#ifdef __CUDACC__
extern __shared__ float memory[];

__device__ inline int shared_floats() {
    unsigned bytes;
    asm("mov.u32 %0, %%dynamic_smem_size;" : "=r"(bytes));
    return int(bytes / 4);
}

// sums (16, 8) += left (16, 8) right (8, 8), spread over a warp. Of lane 4 g + q: sums of rows g and g + 8, columns 2 q
// and 2 q + 1; left of the same rows, columns q and q + 4; right of column g, rows q and q + 4.
__device__ inline void add_product(float (&sums)[4], const unsigned (&left)[4], const unsigned (&right)[2]) {
    asm("mma.sync.aligned.m16n8k8.row.col.f32.tf32.tf32.f32 {%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, "
        "{%0, %1, %2, %3};"
        : "+f"(sums[0]), "+f"(sums[1]), "+f"(sums[2]), "+f"(sums[3])
        : "r"(left[0]), "r"(left[1]), "r"(left[2]), "r"(left[3]), "r"(right[0]), "r"(right[1]));
}
#endif

const int NEURAL_THREADS = 256, NEURAL_POINTS = 64, SLACK = 16;

__device__ inline int padded(int size) {
    return (size + 7) / 8 * 8;
}

// From one row to the next: the rows of a warp's 8 by 4 numbers lie in different banks.
__device__ inline int stride_of(int size) {
    return padded(size) + 4;
}

struct Network {
    int layers, inputs, encoded, bands, activation;
    const float* sizes;
    __device__ int size(int layer) const { return int(sizes[layer]); }

    // Floats that `points` points need of what layers `first` to `last` - 1 read.
    __device__ int rows(int first, int last, int points) const {
        int total = 0;
        for (int layer = first; layer < last; layer++) total += points * stride_of(size(layer));
        return total;
    }

    // Floats of all parameters up to a layer, in the shared memory.
    __device__ int space(int last) const {
        int total = 0;
        for (int layer = 0; layer < last; layer++) total += padded(size(layer + 1)) * stride_of(size(layer));
        return total;
    }

    __device__ int count(int last) const {
        int total = 0;
        for (int layer = 0; layer < last; layer++) total += (size(layer) + 1) * size(layer + 1);
        return total;
    }
};

__device__ inline Network network_of(const View& view) {
    const float* at = view.at;
    return {int(at[0]), int(at[1]), int(at[2]), int(at[3]), int(at[4]), at + 5};
}

// A layer's parameters, or sums of their gradients: in the shared memory with rows padded by 0 and followed by the
// bias; elsewhere as the tensor has them.
struct Layer {
    float *weights, *biases;
    int reads, makes, stride, step;
};

__device__ inline Layer layer_of(const Network& net, int layer, float* at, bool shared) {
    const int reads = net.size(layer), makes = net.size(layer + 1);
    at += shared ? net.space(layer) : net.count(layer);
    if (shared) return {at, at + padded(reads), reads, makes, stride_of(reads), stride_of(reads)};
    return {at, at + reads * makes, reads, makes, reads, 1};
}

// Copy all parameters into the shared memory.
__device__ inline void load_layers(const Network& net, float* parameters, float* shared) {
    for (int layer = 0; layer < net.layers; layer++) {
        const Layer from = layer_of(net, layer, parameters, false), to = layer_of(net, layer, shared, true);
        for (int k = threadIdx.x; k < padded(to.makes) * to.stride; k += NEURAL_THREADS) {
            const int j = k / to.stride, i = k % to.stride;
            float value = 0.0f;
            if (j < to.makes && i < to.reads) value = from.weights[j * to.reads + i];
            if (j < to.makes && i == padded(to.reads)) value = from.biases[j];
            to.weights[k] = value;
        }
    }
}

__device__ inline float activated(int kind, float z) {
    if (kind == 0) return fmaxf(z, 0.0f);
    return kind == 1 ? 0.5f * z * (1.0f + erff(z * 0.7071067811865476f)) : sinf(z);
}

__device__ inline float slope_of(int kind, float z) {
    if (kind == 0) return z > 0.0f ? 1.0f : 0.0f;
    if (kind == 2) return cosf(z);
    const float bell = 0.3989422804014327f * expf(-0.5f * z * z);
    return 0.5f * (1.0f + erff(z * 0.7071067811865476f)) + z * bell;
}

// What the first layer reads of `count` points; 0 beside it and for the others of `most`.
__device__ inline void encode_points(const Network& net, const float* points, int count, int most, float* rows) {
    const int size = net.size(0), wide = padded(size), stride = stride_of(size);
    for (int k = threadIdx.x; k < wide * most; k += NEURAL_THREADS) {
        const int p = k / wide, column = k % wide, feature = column - net.inputs;
        float value = 0.0f;
        if (p < count && column < size) {
            if (feature < 0) {
                value = points[p * net.inputs + column];
            } else {
                const int pair = feature / 2, band = pair / net.encoded;
                const float turns = points[p * net.inputs + pair % net.encoded] * float(1 << band);
                const float whole = floorf(turns + 0.5f), angle = (turns - whole) * 3.14159265358979f;
                const float sign = whole * 0.5f == floorf(whole * 0.5f) ? 1.0f : -1.0f;
                value = sign * (feature % 2 ? cosf(angle) : sinf(angle));
            }
        }
        rows[p * stride + column] = value;
    }
    __syncthreads();
}

union Bits {
    float number;
    unsigned bits;
};

// A number as the sum of two that tensor cores take, which have 11 bits.
__device__ inline void split(float value, unsigned& high, unsigned& low) {
    Bits whole, rest;
    whole.number = value;
    whole.bits = (whole.bits + 0x1000u) & ~0x1fffu;
    rest.number = value - whole.number;
    high = whole.bits;
    low = rest.bits;
}

// A matrix: how far it is from one row to the next, and from one column to the next.
struct Matrix {
    const float* at;
    int row, column;
};

// 16 rows and up to 32 of `columns` columns of a product by one warp, of `inner` sums. A lane has rows g and g + 8,
// columns 2 q and 2 q + 1 of each eight. `left` is 0 beyond `inner`; so is `right`, unless it is BARE: without padding.
// The order of the sums puts a warp's numbers into different banks: `pairs` are neighbours, or four apart.
template <bool BARE>
__device__ inline void multiply(float (&sums)[4][4], Matrix left, Matrix right, int inner, int columns, bool pairs) {
    const int lane = threadIdx.x % 32, g = lane / 4, q = lane % 4, second = pairs ? 1 : 4;
    for (int k = pairs ? 2 * q : q; k < padded(inner); k += 8) {
        const float* const a = left.at + g * left.row + k * left.column;
        const float* const b = right.at + k * right.row + g * right.column;
        const int down = 8 * left.row, across = second * left.column, below = second * right.row;
        unsigned high[4], low[4];
        split(a[0], high[0], low[0]);
        split(a[down], high[1], low[1]);
        split(a[across], high[2], low[2]);
        split(a[down + across], high[3], low[3]);
#pragma unroll
        for (int n = 0; n < 4; n++) {
            if (8 * n >= columns) continue;
            const float* const c = b + 8 * n * right.column;
            const bool there = !BARE || 8 * n + g < columns;
            unsigned above[2], rest[2];
            split(there && (!BARE || k < inner) ? c[0] : 0.0f, above[0], rest[0]);
            split(there && (!BARE || k + second < inner) ? c[below] : 0.0f, above[1], rest[1]);
            add_product(sums[n], low, above);
            add_product(sums[n], high, rest);
            add_product(sums[n], high, above);
        }
    }
}

// Call `store(row, column, sum)` for all sums of a warp.
template <class Store>
__device__ inline void spread(const float (&sums)[4][4], Store store) {
    const int lane = threadIdx.x % 32;
#pragma unroll
    for (int n = 0; n < 4; n++) {
#pragma unroll
        for (int k = 0; k < 4; k++) store(lane / 4 + k / 2 * 8, 8 * n + lane % 4 * 2 + k % 2, sums[n][k]);
    }
}

// Call `store(point, output, sum)` for the outputs of a layer before its activation, the padding included.
template <bool BARE, class Store>
__device__ inline void run_layer(const Layer& layer, const float* from, int points, Store store) {
    const int tiles = points / 16, wide = (layer.makes + 31) / 32, lane = threadIdx.x % 32;
    for (int tile = threadIdx.x / 32; tile < tiles * wide; tile += NEURAL_THREADS / 32) {
        const int p = tile % tiles * 16, j = tile / tiles * 32;
        float sums[4][4];
#pragma unroll
        for (int n = 0; n < 4; n++) {
#pragma unroll
            for (int k = 0; k < 4; k++) {
                const int column = j + 8 * n + lane % 4 * 2 + k % 2;
                sums[n][k] = column < layer.makes ? layer.biases[column * layer.step] : 0.0f;
            }
        }
        multiply<BARE>(sums, {from + p * stride_of(layer.reads), stride_of(layer.reads), 1},
                       {layer.weights + j * layer.stride, 1, layer.stride}, layer.reads, layer.makes - j, false);
        spread(sums, [&](int row, int column, float sum) { store(p + row, j + column, sum); });
    }
}

template <bool BARE>
__device__ inline void run_all(const Network& net, float* weights, View points, View values) {
    int widest = 0;
    for (int layer = 0; layer < net.layers; layer++) widest = max(widest, stride_of(net.size(layer)));
    const int total = values.size[0], outputs = values.size[1];
    for (int first = blockIdx.y * NEURAL_POINTS; first < total; first += gridDim.y * NEURAL_POINTS) {
        const int count = min(NEURAL_POINTS, total - first);
        encode_points(net, points.at + size_t(first) * net.inputs, count, NEURAL_POINTS, memory);
        for (int index = 0; index < net.layers; index++) {
            const Layer layer = layer_of(net, index, weights, !BARE);
            const float* const from = memory + index % 2 * NEURAL_POINTS * widest;
            float* const to = memory + (index + 1) % 2 * NEURAL_POINTS * widest;
            if (index < net.layers - 1) {
                run_layer<BARE>(layer, from, NEURAL_POINTS, [&](int p, int j, float z) {
                    if (j >= padded(layer.makes)) return;
                    to[p * stride_of(layer.makes) + j] = j < layer.makes ? activated(net.activation, z) : 0.0f;
                });
            } else {
                run_layer<BARE>(layer, from, NEURAL_POINTS, [&](int p, int j, float z) {
                    if (p < count && j < outputs) values.at[size_t(first + p) * outputs + j] = z;
                });
            }
            __syncthreads();
        }
    }
}

// network (12,), parameters (count,), points (points, inputs) -> values (points, outputs): a block for every so many 64
// points.
extern "C" __global__ void __launch_bounds__(256) neural_forward(View network, View parameters, View points,
                                                                 View values) {
    const Network net = network_of(network);
    int widest = 0;
    for (int layer = 0; layer < net.layers; layer++) widest = max(widest, stride_of(net.size(layer)));
    const int begin = 2 * NEURAL_POINTS * widest;
    if (begin + net.space(net.layers) <= shared_floats()) {
        load_layers(net, parameters.at, memory + begin);
        run_all<false>(net, memory + begin, points, values);
    } else {
        run_all<true>(net, parameters.at, points, values);
    }
}

// The gradients of one layer: of its parameters, added to `sums`; and of what it reads, which takes the place of the
// slopes there.
template <bool BARE>
__device__ inline void pull_back(const Layer& layer, const Layer& sums, const float* reads, const float* deltas,
                                 float* slopes, int points) {
    const int high = (layer.makes + 15) / 16, wide = (layer.reads + 31) / 32, tiles = points / 16;
    const int read_stride = stride_of(layer.reads), made_stride = stride_of(layer.makes);
    for (int tile = threadIdx.x / 32; tile < (slopes ? high + tiles : high) * wide; tile += NEURAL_THREADS / 32) {
        float found[4][4] = {};
        const int i = tile % wide * 32, row = tile / wide * 16;
        if (row < 16 * high) {
            multiply<false>(found, {deltas + row, 1, made_stride}, {reads + i, read_stride, 1}, points, layer.reads - i,
                            true);
            spread(found, [&](int r, int c, float sum) {
                const bool there = row + r < layer.makes && i + c < layer.reads;
                if (there) sums.weights[(row + r) * sums.stride + i + c] += sum;
            });
        } else {
            const int p = row - 16 * high;
            multiply<BARE>(found, {deltas + p * made_stride, made_stride, 1},
                           {layer.weights + i, layer.stride, 1}, layer.makes, layer.reads - i, true);
            spread(found, [&](int r, int c, float sum) {
                if (i + c >= padded(layer.reads)) return;
                float& slope = slopes[(p + r) * read_stride + i + c];
                slope = i + c < layer.reads ? slope * sum : 0.0f;
            });
        }
    }
    if (threadIdx.x < layer.makes) {
        float total = 0.0f;
        for (int p = 0; p < points; p++) total += deltas[p * made_stride + threadIdx.x];
        sums.biases[threadIdx.x * sums.step] += total;
    }
    __syncthreads();
}

// One group of points: all layers forwards and backwards.
template <bool BARE>
__device__ inline void learn_group(const Network& net, float* weights, float* sums, int most, View points, View targets,
                                   int begin, int end, double& error) {
    const int last = net.layers, outputs = net.size(last), stride = stride_of(outputs);
    float* const changes = memory + net.rows(0, last, most);
    float* const result = changes + net.rows(1, last, most);
    const float share = 1.0f / (float(points.size[0]) * float(outputs));
    for (int first = begin; first < end; first += most) {
        const int count = min(most, end - first);
        encode_points(net, points.at + size_t(first) * net.inputs, count, most, memory);
        for (int index = 0; index < last; index++) {
            const Layer layer = layer_of(net, index, weights, !BARE);
            const int makes = layer.makes, wide = stride_of(makes);
            float* const to = memory + net.rows(0, index + 1, most);
            float* const slopes = changes + net.rows(1, index + 1, most);
            run_layer<BARE>(layer, memory + net.rows(0, index, most), most, [&](int p, int j, float z) {
                if (j >= padded(makes)) return;
                if (index < last - 1) to[p * wide + j] = j < makes ? activated(net.activation, z) : 0.0f;
                slopes[p * wide + j] = j >= makes ? 0.0f : index < last - 1 ? slope_of(net.activation, z) : z;
            });
            __syncthreads();
        }
        for (int p = threadIdx.x; p < most; p += NEURAL_THREADS) {
            const float* const target = targets.at + size_t(first + p) * outputs;
            bool known = p < count;
            for (int j = 0; j < outputs; j++) known = known && fabsf(target[j]) <= 3.4028234664e38f;
            for (int j = 0; j < outputs; j++) {
                const float difference = known ? result[p * stride + j] - target[j] : 0.0f;
                error += double(difference) * difference;
                result[p * stride + j] = 2.0f * share * difference;
            }
        }
        __syncthreads();
        for (int index = last - 1; index >= 0; index--) {
            const Layer layer = layer_of(net, index, weights, !BARE), into = layer_of(net, index, sums, !BARE);
            pull_back<BARE>(layer, into, memory + net.rows(0, index, most), changes + net.rows(1, index + 1, most),
                            index ? changes + net.rows(1, index, most) : nullptr, most);
        }
    }
}

// network (12,), parameters (count,), points (points, inputs), targets (points, outputs) -> partials (groups, count +
// 1): a block for a group.
extern "C" __global__ void __launch_bounds__(256) neural_gradients(View network, View parameters, View points,
                                                                   View targets, View partials) {
    __shared__ double errors[NEURAL_THREADS];
    const Network net = network_of(network);
    const int groups = partials.size[0], sums = partials.size[1], group = blockIdx.y;
    const long long total = points.size[0];
    float* const gradients = partials.at + size_t(group) * sums;
    const int begin = int(group * total / groups), end = int((group + 1) * total / groups);
    const int room = shared_floats() - SLACK, space = net.space(net.layers);
    int most = NEURAL_POINTS;
    while (most > 16 && net.rows(0, net.layers, most) + net.rows(1, net.layers + 1, most) > room) most /= 2;
    const int used = net.rows(0, net.layers, most) + net.rows(1, net.layers + 1, most);
    double error = 0.0;
    if (used + 2 * space <= room) {
        float *const weights = memory + used, *const found = weights + space;
        load_layers(net, parameters.at, weights);
        for (int k = threadIdx.x; k < space; k += NEURAL_THREADS) found[k] = 0.0f;
        learn_group<false>(net, weights, found, most, points, targets, begin, end, error);
        for (int index = 0; index < net.layers; index++) {
            const Layer from = layer_of(net, index, found, true), to = layer_of(net, index, gradients, false);
            for (int k = threadIdx.x; k < to.reads * to.makes; k += NEURAL_THREADS) {
                to.weights[k] = from.weights[k / to.reads * from.stride + k % to.reads];
            }
            for (int k = threadIdx.x; k < to.makes; k += NEURAL_THREADS) to.biases[k] = from.biases[k * from.step];
        }
    } else {
        for (int k = threadIdx.x; k < sums - 1; k += NEURAL_THREADS) gradients[k] = 0.0f;
        __syncthreads();
        learn_group<true>(net, parameters.at, gradients, most, points, targets, begin, end, error);
    }
    errors[threadIdx.x] = error;
    __syncthreads();
    if (threadIdx.x == 0) {
        for (int k = 1; k < most; k++) error += errors[k];
        gradients[sums - 1] = float(error / (double(total) * net.size(net.layers)));
    }
}

// partials (groups, count + 1), hyper (4,), parameters (count,), moments (count, 3): the last two change in place. A
// block for 8 parameters, 32 of whose threads share a parameter's groups.
extern "C" __global__ void __launch_bounds__(256) neural_adam(View partials, View hyper, View parameters,
                                                              View moments) {
    __shared__ float parts[NEURAL_THREADS];
    const int count = moments.size[0], y = blockIdx.y * 8 + threadIdx.x % 8;
    float gradient = 0.0f;
    for (int group = threadIdx.x / 8; y < count && group < partials.size[0]; group += NEURAL_THREADS / 8) {
        gradient += partials.at[size_t(group) * (count + 1) + y];
    }
    parts[threadIdx.x] = gradient;
    __syncthreads();
    if (threadIdx.x >= 8 || y >= count) return;
    for (int k = 8 + threadIdx.x; k < NEURAL_THREADS; k += 8) gradient += parts[k];
    float* const row = moments.at + 3 * size_t(y);
    const float rate = hyper.at[0], slow = hyper.at[1], slower = hyper.at[2], epsilon = hyper.at[3];
    const double step = row[2] + 1.0;
    const float size = float(rate / (1.0 - pow(double(slow), step)));
    const float scale = float(1.0 / sqrt(1.0 - pow(double(slower), step)));
    row[0] = slow * row[0] + (1.0f - slow) * gradient;
    row[1] = slower * row[1] + (1.0f - slower) * gradient * gradient;
    row[2] = float(step);
    parameters.at[y] -= size * row[0] / (sqrtf(row[1]) * scale + epsilon);
}

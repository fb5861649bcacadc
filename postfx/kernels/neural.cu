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

// Begin to copy a number into the shared memory, where it is after `wait_for_copies` and a barrier.
__device__ inline void copy_number(float* to, const float* from) {
    asm volatile("cp.async.ca.shared.global [%0], [%1], 4;" ::"r"(unsigned(__cvta_generic_to_shared(to))), "l"(from));
}

__device__ inline void wait_for_copies() {
    asm volatile("cp.async.wait_all;" ::: "memory");
}
#endif

const int NEURAL_POINTS = 64, SLACK = 16;

__device__ inline int padded(int size) {
    return (size + 7) / 8 * 8;
}

// From one row to the next: the rows of a warp's 8 by 4 numbers lie in different banks.
__device__ inline int stride_of(int size) {
    return padded(size) + 4;
}

// What every block knows of the network, up to each layer: floats of a point in rows of what the layers before it read,
// of their parameters in the shared memory, and of these in the tensor.
struct Network {
    int layers, inputs, encoded, bands, activation, widest;
    int size[MOST_LAYERS + 1], rows[MOST_LAYERS + 2], space[MOST_LAYERS + 1], count[MOST_LAYERS + 1];
};

__device__ inline void read_network(const View& view, Network& net) {
    const float* const at = view.at;
    if (threadIdx.x == 0) {
        net.layers = int(at[LAYERS]), net.inputs = int(at[INPUTS]);
        net.encoded = max(int(at[ENCODED]), 1), net.bands = int(at[BANDS]);
        net.activation = int(at[ACTIVATION]), net.widest = net.rows[0] = net.space[0] = net.count[0] = 0;
        for (int layer = 0; layer <= net.layers; layer++) {
            const int size = net.size[layer] = int(at[SIZES + layer]);
            net.rows[layer + 1] = net.rows[layer] + stride_of(size);
            net.widest = max(net.widest, stride_of(size));
            if (layer == 0) continue;
            const int reads = net.size[layer - 1];
            net.space[layer] = net.space[layer - 1] + padded(size) * stride_of(reads);
            net.count[layer] = net.count[layer - 1] + (reads + 1) * size;
        }
    }
    __syncthreads();
}

// A layer's parameters, or sums of their gradients: in the shared memory with rows padded by 0 and followed by the
// bias; elsewhere as the tensor has them.
struct Layer {
    float *weights, *biases;
    int reads, makes, stride, step;
};

__device__ inline Layer layer_of(const Network& net, int layer, float* at, bool shared) {
    const int reads = net.size[layer], makes = net.size[layer + 1];
    at += shared ? net.space[layer] : net.count[layer];
    if (shared) return {at, at + padded(reads), reads, makes, stride_of(reads), stride_of(reads)};
    return {at, at + reads * makes, reads, makes, reads, 1};
}

// Copy all parameters into the shared memory, where they are after the next `encode_points`.
__device__ inline void load_layers(const Network& net, float* parameters, float* shared) {
    for (int layer = 0; layer < net.layers; layer++) {
        const Layer from = layer_of(net, layer, parameters, false), to = layer_of(net, layer, shared, true);
        for (int j = threadIdx.x / 32; j < padded(to.makes); j += THREADS / 32) {
            for (int i = threadIdx.x % 32; i < to.stride; i += 32) {
                float* const at = to.weights + j * to.stride + i;
                if (j < to.makes && i < to.reads) {
                    copy_number(at, from.weights + j * to.reads + i);
                } else if (j < to.makes && i == padded(to.reads)) {
                    copy_number(at, from.biases + j);
                } else {
                    *at = 0.0f;
                }
            }
        }
    }
}

// GELU and sine; a ReLU is made where the sums are.
__device__ inline float activated(int kind, float z) {
    return kind == GELU ? 0.5f * z * (1.0f + erff(z * 0.7071067811865476f)) : sinf(z);
}

__device__ inline float slope_of(int kind, float z) {
    if (kind == SINE) return cosf(z);
    const float bell = 0.3989422804014327f * expf(-0.5f * z * z);
    return 0.5f * (1.0f + erff(z * 0.7071067811865476f)) + z * bell;
}

// What the first layer reads of `count` points; 0 beside it and for the others of `most`.
__device__ inline void encode_points(const Network& net, const float* points, int count, int most, float* rows) {
    const int size = net.size[0], wide = padded(size), stride = stride_of(size), inputs = net.inputs;
    for (int k = threadIdx.x; k < count * inputs; k += THREADS) {
        copy_number(rows + k / inputs * stride + k % inputs, points + k);
    }
    for (int p = threadIdx.x / 32; p < most; p += THREADS / 32) {
        float* const row = rows + p * stride;
        for (int column = (p < count ? size : 0) + threadIdx.x % 32; column < wide; column += 32) row[column] = 0.0f;
    }
    wait_for_copies();
    __syncthreads();
    const int p = threadIdx.x % most, pairs = p < count ? (size - inputs) / 2 : 0;
    float* const row = rows + p * stride;
    for (int pair = threadIdx.x / most; pair < pairs; pair += THREADS / most) {
        const float turns = row[pair % net.encoded] * float(1 << pair / net.encoded);
        const float whole = floorf(turns + 0.5f), angle = (turns - whole) * PI;
        const float sign = whole * 0.5f == floorf(whole * 0.5f) ? 1.0f : -1.0f;
        row[inputs + 2 * pair] = sign * sinf(angle);
        row[inputs + 2 * pair + 1] = sign * cosf(angle);
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

// 16 rows and 8 COUNT columns of a product by one warp, of `inner` sums; those beyond `columns` are of no use. A lane
// has rows g and g + 8, columns 2 q and 2 q + 1 of each eight. `left` is 0 beyond `inner`. The order of the sums puts a
// warp's numbers into different banks: `pairs` are neighbours, or four apart.
template <int COUNT>
__device__ inline void multiply(float (&sums)[4][4], Matrix left, Matrix right, int inner, int columns, bool pairs) {
    const int lane = threadIdx.x % 32, g = lane / 4, q = lane % 4, second = pairs ? 1 : 4, last = inner - 1;
    const int down = 8 * left.row, across = second * left.column;
    const float* at[COUNT];
#pragma unroll
    for (int n = 0; n < COUNT; n++) at[n] = right.at + min(8 * n + g, columns - 1) * right.column;
#pragma unroll 2
    for (int first = 0; first < inner; first += 8) {
        const int k = first + (pairs ? 2 * q : q);
        const float* const a = left.at + g * left.row + k * left.column;
        const int above = min(k, last) * right.row, below = min(k + second, last) * right.row;
        unsigned high[4], low[4], whole[COUNT][2], rest[COUNT][2];
        split(a[0], high[0], low[0]);
        split(a[down], high[1], low[1]);
        split(a[across], high[2], low[2]);
        split(a[down + across], high[3], low[3]);
#pragma unroll
        for (int n = 0; n < COUNT; n++) {
            split(at[n][above], whole[n][0], rest[n][0]);
            split(at[n][below], whole[n][1], rest[n][1]);
        }
#pragma unroll
        for (int n = 0; n < COUNT; n++) add_product(sums[n], low, whole[n]);
#pragma unroll
        for (int n = 0; n < COUNT; n++) add_product(sums[n], high, rest[n]);
#pragma unroll
        for (int n = 0; n < COUNT; n++) add_product(sums[n], high, whole[n]);
    }
}

__device__ inline void multiply(float (&sums)[4][4], Matrix left, Matrix right, int inner, int columns, bool pairs) {
    if (columns > 8) {
        multiply<4>(sums, left, right, inner, columns, pairs);
    } else {
        multiply<1>(sums, left, right, inner, columns, pairs);
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

// A layer of some points: rows of its outputs with 0 beside them, and of the slopes there; -1 is no activation.
__device__ inline void run_layer(const Layer& layer, const float* from, int points, int kind, float* to,
                                 float* slopes) {
    const int tiles = points / 16, wide = (layer.makes + 31) / 32, lane = threadIdx.x % 32;
    const int reads = stride_of(layer.reads), stride = stride_of(layer.makes);
    for (int tile = threadIdx.x / 32; tile < tiles * wide; tile += THREADS / 32) {
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
        multiply(sums, {from + p * reads, reads, 1}, {layer.weights + j * layer.stride, 1, layer.stride}, layer.reads,
                 layer.makes - j, false);
        spread(sums, [&](int row, int column, float sum) {
            const int at = (p + row) * stride + j + column;
            const bool there = j + column < layer.makes;
            if (j + column < padded(layer.makes)) {
                if (kind == RELU && slopes) slopes[at] = there && sum > 0.0f ? 1.0f : 0.0f;
                to[at] = there ? kind == RELU ? fmaxf(sum, 0.0f) : sum : 0.0f;
            }
        });
#pragma unroll 1
        for (int k = 0; k < 16 && kind > RELU; k++) {  // the same numbers: this code is too long to be there 16 times
            const int column = j + k / 4 * 8 + lane % 4 * 2 + k % 2;
            if (column >= padded(layer.makes)) break;
            const int at = (p + lane / 4 + k % 4 / 2 * 8) * stride + column;
            const float z = to[at];
            if (slopes) slopes[at] = column < layer.makes ? slope_of(kind, z) : 0.0f;
            to[at] = activated(kind, z);
        }
    }
    __syncthreads();
}

template <bool SHARED>
__device__ inline void run_all(const Network& net, float* weights, View points, View values) {
    const int total = values.size[0], outputs = values.size[1], last = net.layers - 1, stride = stride_of(outputs);
    for (int first = blockIdx.y * NEURAL_POINTS; first < total; first += gridDim.y * NEURAL_POINTS) {
        const int count = min(NEURAL_POINTS, total - first);
        encode_points(net, points.at + size_t(first) * net.inputs, count, NEURAL_POINTS, memory);
        float *from = memory, *to = memory + NEURAL_POINTS * net.widest;
        for (int index = 0; index <= last; index++) {
            const int kind = index < last ? net.activation : -1;
            run_layer(layer_of(net, index, weights, SHARED), from, NEURAL_POINTS, kind, to, nullptr);
            float* const made = to;
            to = from;
            from = made;
        }
        for (int k = threadIdx.x; k < count * outputs; k += THREADS) {
            values.at[size_t(first) * outputs + k] = from[k / outputs * stride + k % outputs];
        }
        __syncthreads();
    }
}

// network (12,), parameters (count,), points (points, inputs) -> values (points, outputs): a block for every so many 64
// points.
extern "C" __global__ void __launch_bounds__(THREADS) neural_forward(View network, View parameters, View points,
                                                                 View values) {
    __shared__ Network net;
    read_network(network, net);
    const int begin = 2 * NEURAL_POINTS * net.widest;
    if (begin + net.space[net.layers] <= shared_floats()) {
        load_layers(net, parameters.at, memory + begin);
        run_all<true>(net, memory + begin, points, values);
    } else {
        run_all<false>(net, parameters.at, points, values);
    }
}

// The gradients of one layer: of its parameters, added to `sums`; and of what it reads, which takes the place of the
// slopes there, or for the first layer goes to rows of `pulls` of `count` points.
__device__ inline void pull_back(const Layer& layer, const Layer& sums, const float* reads, const float* deltas,
                                 float* slopes, int points, float* pulls, int count, int inputs) {
    const int high = (layer.makes + 15) / 16, wide = (layer.reads + 31) / 32, tiles = slopes || pulls ? points / 16 : 0;
    const int read_stride = stride_of(layer.reads), made_stride = stride_of(layer.makes);
    for (int tile = threadIdx.x / 32; tile < (high + tiles) * wide; tile += THREADS / 32) {
        float found[4][4] = {};
        const int i = tile % wide * 32, row = tile / wide * 16;
        if (row < 16 * high) {
            multiply(found, {deltas + row, 1, made_stride}, {reads + i, read_stride, 1}, points, layer.reads - i,
                            true);
            spread(found, [&](int r, int c, float sum) {
                const bool there = row + r < layer.makes && i + c < layer.reads;
                if (there) sums.weights[(row + r) * sums.stride + i + c] += sum;
            });
        } else {
            const int p = row - 16 * high;
            multiply(found, {deltas + p * made_stride, made_stride, 1},
                           {layer.weights + i, layer.stride, 1}, layer.makes, layer.reads - i, true);
            spread(found, [&](int r, int c, float sum) {
                if (pulls) {
                    if (p + r < count && i + c < inputs) pulls[(p + r) * inputs + i + c] = sum;
                } else if (i + c < padded(layer.reads)) {
                    float& slope = slopes[(p + r) * read_stride + i + c];
                    slope = i + c < layer.reads ? slope * sum : 0.0f;
                }
            });
        }
    }
    for (int first = 0; first < layer.makes; first += THREADS / 4) {  // four threads share a bias
        const int j = first + threadIdx.x / 4;
        float total = 0.0f;
        for (int p = threadIdx.x % 4; p < points && j < layer.makes; p += 4) total += deltas[p * made_stride + j];
        total += __shfl_xor_sync(~0u, total, 1);
        total += __shfl_xor_sync(~0u, total, 2);
        if (threadIdx.x % 4 == 0 && j < layer.makes) sums.biases[j * sums.step] += total;
    }
    __syncthreads();
}

// One group of points: all layers forwards and backwards.
template <bool SHARED>
__device__ inline void learn_group(const Network& net, float* weights, float* sums, int most, View points, View targets,
                                   View pulls, int begin, int end, double& error) {
    const int last = net.layers, kind = net.activation, outputs = net.size[last], stride = stride_of(outputs);
    float* const changes = memory + most * (net.rows[last] - net.rows[1]);  // from layer 1 on
    float* const result = changes + most * net.rows[last];
    const float share = 1.0f / (float(points.size[0]) * float(outputs));
    for (int first = begin; first < end; first += most) {
        const int count = min(most, end - first);
        encode_points(net, points.at + size_t(first) * net.inputs, count, most, memory);
        for (int index = 0; index < last; index++) {
            const Layer layer = layer_of(net, index, weights, SHARED);
            float *const reads = memory + most * net.rows[index], *const makes = memory + most * net.rows[index + 1];
            float* const slopes = changes + most * net.rows[index + 1];
            if (index < last - 1) {
                run_layer(layer, reads, most, kind, makes, slopes);
            } else {
                run_layer(layer, reads, most, -1, slopes, nullptr);
            }
        }
        for (int p = threadIdx.x; p < most; p += THREADS) {
            const float* const target = targets.at + size_t(first + p) * outputs;
            bool known = p < count;
            for (int j = 0; j < outputs; j++) known = known && fabsf(target[j]) <= LARGEST_FLOAT;
            for (int j = 0; j < outputs; j++) {
                const float difference = known ? result[p * stride + j] - target[j] : 0.0f;
                error += double(difference) * difference;
                result[p * stride + j] = 2.0f * share * difference;
            }
        }
        __syncthreads();
        float* const pulled = pulls.size[0] == points.size[0] ? pulls.at + size_t(first) * net.inputs : nullptr;
        for (int index = last - 1; index >= 0; index--) {
            const Layer layer = layer_of(net, index, weights, SHARED), into = layer_of(net, index, sums, SHARED);
            pull_back(layer, into, memory + most * net.rows[index], changes + most * net.rows[index + 1],
                      index ? changes + most * net.rows[index] : nullptr, most, index ? nullptr : pulled, count,
                      net.inputs);
        }
    }
}

// network (12,), parameters (count,), points (points, inputs), targets (points, outputs) -> partials (groups, count +
// 1), and pulls (points, inputs) or (1, inputs): a block for a group.
extern "C" __global__ void __launch_bounds__(THREADS) neural_gradients(View network, View parameters, View points,
                                                                   View targets, View partials, View pulls) {
    __shared__ double errors[THREADS];
    __shared__ Network net;
    read_network(network, net);
    const int groups = partials.size[0], sums = partials.size[1], group = blockIdx.y;
    const long long total = points.size[0];
    float* const gradients = partials.at + size_t(group) * sums;
    const int begin = int(group * total / groups), end = int((group + 1) * total / groups);
    const int room = shared_floats() - SLACK, space = net.space[net.layers];
    const int wide = net.rows[net.layers] + net.rows[net.layers + 1] - net.rows[1];
    int most = NEURAL_POINTS;
    while (most > 16 && most * wide > room) most /= 2;
    const int used = most * wide;
    double error = 0.0;
    if (used + 2 * space <= room) {
        float *const weights = memory + used, *const found = weights + space;
        load_layers(net, parameters.at, weights);
        for (int k = threadIdx.x; k < space; k += THREADS) found[k] = 0.0f;
        learn_group<true>(net, weights, found, most, points, targets, pulls, begin, end, error);
        for (int index = 0; index < net.layers; index++) {
            const Layer from = layer_of(net, index, found, true), to = layer_of(net, index, gradients, false);
            for (int j = threadIdx.x / 32; j < to.makes; j += THREADS / 32) {
                for (int i = threadIdx.x % 32; i < to.reads; i += 32) {
                    to.weights[j * to.reads + i] = from.weights[j * from.stride + i];
                }
            }
            for (int k = threadIdx.x; k < to.makes; k += THREADS) to.biases[k] = from.biases[k * from.step];
        }
    } else {
        for (int k = threadIdx.x; k < sums - 1; k += THREADS) gradients[k] = 0.0f;
        __syncthreads();
        learn_group<false>(net, parameters.at, gradients, most, points, targets, pulls, begin, end, error);
    }
    errors[threadIdx.x] = error;
    __syncthreads();
    if (threadIdx.x == 0) {
        for (int k = 1; k < most; k++) error += errors[k];
        gradients[sums - 1] = float(error / (double(total) * net.size[net.layers]));
    }
}

// A step of one parameter, whose moments are a row of three.
__device__ inline void adam_step(float gradient, const View& hyper, float* row, float& parameter) {
    const float rate = hyper.at[0], slow = hyper.at[1], slower = hyper.at[2], epsilon = hyper.at[3];
    const double step = row[2] + 1.0;
    const float size = float(rate / (1.0 - pow(double(slow), step)));
    const float scale = float(1.0 / sqrt(1.0 - pow(double(slower), step)));
    row[0] = slow * row[0] + (1.0f - slow) * gradient;
    row[1] = slower * row[1] + (1.0f - slower) * gradient * gradient;
    row[2] = float(step);
    parameter -= size * row[0] / (sqrtf(row[1]) * scale + epsilon);
}

// partials (groups, count + 1), hyper (4,), parameters (count,), moments (count, 3): the last two change in place. A
// block for 8 parameters, 32 of whose threads share a parameter's groups.
extern "C" __global__ void __launch_bounds__(THREADS) neural_adam(View partials, View hyper, View parameters,
                                                              View moments) {
    __shared__ float parts[THREADS];
    const int count = moments.size[0], y = blockIdx.y * 8 + threadIdx.x % 8;
    float gradient = 0.0f;
    for (int group = threadIdx.x / 8; y < count && group < partials.size[0]; group += THREADS / 8) {
        gradient += partials.at[size_t(group) * (count + 1) + y];
    }
    parts[threadIdx.x] = gradient;
    __syncthreads();
    if (threadIdx.x >= 8 || y >= count) return;
    for (int k = 8 + threadIdx.x; k < THREADS; k += 8) gradient += parts[k];
    adam_step(gradient, hyper, moments.at + 3 * size_t(y), parameters.at[y]);
}

struct Corner {
    int entry;
    float share;
};

// A corner of the cell of a grid's level that a point lies in.
__device__ inline Corner corner_of(const View& grid, int level, const float* point, int corner) {
    const unsigned primes[3] = {1u, 2654435761u, 805459861u};
    const int dims = int(grid.at[DIMS]), entries = int(grid.at[ENTRIES]), side = int(grid.at[SIDES + level]);
    long long corners = 1;
    for (int axis = 0; axis < dims; axis++) corners *= side + 1;
    unsigned entry = 0, step = 1;
    float share = 1.0f;
    for (int axis = 0; axis < dims; axis++) {
        const float place = point[axis] > 0.0f ? fminf(point[axis], 1.0f) * float(side) : 0.0f;
        const int cell = min(int(place), side - 1), bit = corner >> axis & 1;
        const float rest = place - float(cell);
        share *= bit ? rest : 1.0f - rest;
        if (corners <= entries) {
            entry += unsigned(cell + bit) * step;
            step *= unsigned(side + 1);
        } else {
            entry ^= unsigned(cell + bit) * primes[axis];
        }
    }
    return {int(entry & unsigned(entries - 1)), share};
}

// grid (20,), table (levels, entries * numbers), points (points, dims + others) -> rows (points, levels * numbers +
// others).
extern "C" __global__ void neural_grid(View grid, View table, View points, View rows) {
    const int dims = int(grid.at[DIMS]), numbers = int(grid.at[NUMBERS]), levels = int(grid.at[LEVELS]);
    PIXEL(rows.size[1], rows.size[0]);
    const float* const point = points.at + size_t(y) * points.size[1];
    const int level = x / numbers;
    float value = 0.0f;
    if (level >= levels) value = point[dims + x - levels * numbers];
    for (int corner = 0; level < levels && corner < 1 << dims; corner++) {
        const Corner found = corner_of(grid, level, point, corner);
        value += found.share * table.at[size_t(level) * table.size[1] + found.entry * numbers + x % numbers];
    }
    rows.at[size_t(y) * rows.size[1] + x] = value;
}

// grid (20,), points (points, dims + others), pulls (points, inputs) -> sums (levels, entries * numbers) int64, in
// units of 2^-44: a block for a level.
extern "C" __global__ void __launch_bounds__(THREADS) neural_grid_pull(View grid, View points, View pulls, View sums) {
    const int dims = int(grid.at[DIMS]), numbers = int(grid.at[NUMBERS]), level = blockIdx.y;
    unsigned long long* const row = reinterpret_cast<unsigned long long*>(sums.at) + size_t(level) * sums.size[1];
    for (int k = threadIdx.x; k < sums.size[1]; k += THREADS) row[k] = 0;
    __syncthreads();
    for (int p = threadIdx.x; p < points.size[0]; p += THREADS) {
        const float* const pull = pulls.at + size_t(p) * pulls.size[1] + level * numbers;
        for (int corner = 0; corner < 1 << dims; corner++) {
            const Corner found = corner_of(grid, level, points.at + size_t(p) * points.size[1], corner);
            for (int k = 0; k < numbers; k++) {
                const long long units = llrint(double(found.share * pull[k]) * UNITS);
                if (units) atomicAdd(row + found.entry * numbers + k, (unsigned long long)(units));
            }
        }
    }
}

// sums (levels, entries * numbers) int64, hyper (4,), table (levels, entries * numbers), moments (levels, entries *
// numbers, 3): the last two change in place.
extern "C" __global__ void neural_grid_step(View sums, View hyper, View table, View moments) {
    PIXEL(table.size[1], table.size[0]);
    const size_t at = size_t(y) * table.size[1] + x;
    const long long units = reinterpret_cast<const long long*>(sums.at)[at];
    if (units == 0) return;
    const float gradient = float(double(units) / UNITS);
    adam_step(gradient, hyper, moments.at + 3 * at, table.at[at]);
}

// Kernels of small networks, made of the layers in neural.cuh, and of grids: see
// postfx/kernels/neural.py.

// What a lane needs of an (8, 8) block of weights: see `add_product`.
struct alignas(16) Parts {
    unsigned high[2], low[2];
};

// Layers of at most 64 numbers: blocks of 8 in a row, as 1, 4 or 8.
FN int shift_of(int size) { return size <= 8 ? 0 : size <= 32 ? 2 : 3; }

FN int blocks_of(int reads, int makes) { return (up_to(reads, 32) / 8) << shift_of(makes); }

// Floats that a narrow network takes in the shared memory: biases, then its split weights.
FN int split_floats(const Network& net) {
    int blocks = 0;
    for (int layer = 0; layer < net.layers; layer++)
        blocks += blocks_of(net.size[layer], net.size[layer + 1]);
    return 64 * net.layers + blocks * 32 * 4;
}

// Copy biases and split weights into the shared memory, where they are after a barrier.
FN void split_layers(const Network& net, const float* parameters, float* biases) {
    const int many = 8;
    Parts* to = reinterpret_cast<Parts*>(biases + 64 * net.layers);
    for (int layer = 0; layer < net.layers; layer++) {
        const Layer from = layer_of<64, false>(net, layer, parameters);
        const int shift = shift_of(from.makes), count = blocks_of(from.reads, from.makes) * 32;
        if (threadIdx.x < 64) {
            biases[64 * layer + threadIdx.x] = threadIdx.x < from.makes ? from.biases[threadIdx.x]
                                                                        : 0.0f;
        }
        for (int begin = threadIdx.x; begin < count; begin += many * THREADS) {
            Pair values[many];
            UNROLL for (int n = 0; n < many; n++) {
                const int k = begin + n * THREADS, lane = k % 32, block = k / 32,
                          step = block >> shift;
                const int j = 8 * (block - (step << shift)) + lane / 4,
                          i = 8 * step + 2 * (lane % 4);
                const float* const row = from.weights + j * from.reads + i;
                values[n].x = j < from.makes && i < from.reads ? row[0] : 0.0f;
                values[n].y = j < from.makes && i + 1 < from.reads ? row[1] : 0.0f;
            }
            UNROLL for (int n = 0; n < many; n++) {
                Parts parts;
                split(values[n].x, parts.high[0], parts.low[0]);
                split(values[n].y, parts.high[1], parts.low[1]);
                if (begin + n * THREADS < count) to[begin + n * THREADS] = parts;
            }
        }
        to += count;
    }
    __syncthreads();
}

// sums += left right, where both are a warp's sums, and right is TILES blocks in a row. What
// `add_product` needs to the left, of columns that are in another order there as in the blocks, is
// what it gives.
template <int TILES, int DEPTH>
FN void add_blocks(Sums<8, DEPTH>& sums, const Sums<8, DEPTH>& left, const Parts* right,
                   int steps) {
    const int lane = threadIdx.x % 32, group = TILES < GROUPED ? TILES : GROUPED;
    UNROLL for (int step = 0; step < 8; step++) {
        if (step == 4 && steps == 4) break;
        unsigned high[DEPTH][4], low[DEPTH][4];
        UNROLL for (int k = 0; k < 4 * DEPTH; k++) {
            const int d = k / 4, to = k % 2 * 2 + k % 4 / 2;
            split(left[d][step][k % 4], high[d][to], low[d][to]);
        }
        UNROLL for (int first = 0; first < TILES; first += group) {
            Parts parts[group];
            float found[DEPTH][group][4] = {};
            UNROLL for (int n = 0; n < group; n++)
                parts[n] = right[(TILES * step + first + n) * 32 + lane];
            UNROLL for (int k = 0; k < 3 * DEPTH * group; k++) {  // small products first
                const int d = k % DEPTH, n = k / DEPTH % group, what = k / DEPTH / group;
                add_product(found[d][n], what == 0 ? low[d] : high[d],
                            what == 1 ? parts[n].low : parts[n].high);
            }
            UNROLL for (int k = 0; k < 4 * DEPTH * group; k++) {
                const int d = k % DEPTH, n = k / DEPTH % group, r = k / DEPTH / group;
                sums[d][first + n][r] += found[d][n][r];
            }
        }
    }
}

// All layers of a narrow network: a layer's numbers stay in registers, where the next one reads
// them.
template <int DEPTH>
FN void run_narrow(const Network& net, const float* biases, float* rows, const View& points,
                   const View& values) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, total = values.size[0],
              last = net.layers - 1;
    const int warp = threadIdx.x / 32, together = TILE * DEPTH;
    for (int tile = blockIdx.y + warp * gridDim.y; tile * together < total;
         tile += gridDim.y * WARPS) {
        const Parts* right = reinterpret_cast<const Parts*>(biases + 64 * net.layers);
        Sums<8, DEPTH> left = {};
        UNROLL for (int d = 0; d < DEPTH; d++) {
            encode_points(net, points, tile * together + TILE * d, total, TILE, rows);
            each_pair<8>(rows, up_to(net.size[0], 32), [&](int n, int r, Pair& pair) {
                left[d][n][2 * r] = pair.x, left[d][n][2 * r + 1] = pair.y;
            });
            __syncwarp();
        }
        for (int index = 0; index <= last; index++) {
            const int reads = net.size[index], makes = net.size[index + 1],
                      steps = up_to(reads, 32) / 8;
            Sums<8, DEPTH> sums;
            UNROLL for (int n = 0; n < 8; n++) {
                const Pair bias =
                    *reinterpret_cast<const Pair*>(biases + 64 * index + 8 * n + 2 * q);
                UNROLL for (int d = 0; d < DEPTH; d++) {
                    sums[d][n][0] = sums[d][n][2] = bias.x, sums[d][n][1] = sums[d][n][3] = bias.y;
                }
            }
            if (makes > 32) {
                add_blocks<8, DEPTH>(sums, left, right, steps);
            } else if (makes > 8) {
                add_blocks<4, DEPTH>(sums, left, right, steps);
            } else {
                add_blocks<1, DEPTH>(sums, left, right, steps);
            }
            right += blocks_of(reads, makes) * 32;
            if (index < last && net.activation != RELU) {
                UNROLL for (int d = 0; d < DEPTH; d++) {
                    activate_rows(net.activation, makes, sums[d], rows, nullptr);
                    each_pair<8>(rows, up_to(makes, 32), [&](int n, int r, Pair& pair) {
                        sums[d][n][2 * r] = pair.x, sums[d][n][2 * r + 1] = pair.y;
                    });
                    __syncwarp();
                }
            }
            if (index < last) {
                UNROLL for (int k = 0; k < 32 * DEPTH; k++) {
                    const int d = k / 32, n = k / 4 % 8;
                    left[d][n][k % 4] = net.activation == RELU ? relu_of(sums[d][n][k % 4])
                                                               : sums[d][n][k % 4];
                }
                continue;
            }
            UNROLL for (int n = 0; n < 8; n++) {
                if (8 * n >= makes) break;
                UNROLL for (int k = 0; k < 4 * DEPTH; k++) {
                    const int column = 8 * n + 2 * q + k % 2,
                              p = tile * together + k / 4 * TILE + g + k % 4 / 2 * 8;
                    if (column < makes && p < total)
                        values.at[size_t(p) * makes + column] = sums[k / 4][n][k % 4];
                }
            }
        }
    }
}

// network (12,), parameters (count,), points (points, inputs) -> values (points, outputs): warps
// take 16 or 32 points at a time.
extern "C" __global__ void __launch_bounds__(THREADS)
    neural_forward(View network, View parameters, View points, View values) {
    __shared__ Network net;
    read_network(network, net);
    const int wide = MOST_WIDTH / 8, rows = MOST_POINTS * MOST_WIDTH, warp = threadIdx.x / 32;
    float* const weights = memory + rows;
    if (net.widest <= 64 && split_floats(net) + MOST_POINTS * 64 <= shared_floats()) {
        split_layers(net, parameters.at, memory);
        run_narrow<2>(net, memory, memory + split_floats(net) + warp * TILE * 64, points, values);
    } else if (rows + net.space[net.layers] > shared_floats()) {
        run_all<wide, 1, false>(net, parameters.at, points, values);
    } else {
        load_layers<8 * wide>(net, parameters.at, weights);
        run_all<wide, 1, true>(net, weights, points, values);
    }
}

// 16 by 8 COUNT derivatives by a layer's weights, and 16 by its biases if there are any: sums over
// points of what the layer made and read, whose rows have `high` and `wide` floats. They are added
// to the tensor's if that has `begun`.
template <int COUNT>
FN void add_weights(const float* deltas, int high, const float* reads, int wide, int points,
                    int row, int column, const Layer& layer, float* weights, float* biases,
                    bool begun) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4,
              turns[2] = {turn_of(2 * q), turn_of(2 * q + 1)};
    float found[COUNT][4], down[2] = {};
    const float *left[2][2], *right[2][COUNT];
    UNROLL for (int k = 0; k < 2; k++) {
        UNROLL for (int r = 0; r < 2; r++)
            left[k][r] = deltas + (2 * q + k) * high + ((row + 8 * r) ^ turns[k]) + g;
        UNROLL for (int n = 0; n < COUNT; n++)
            right[k][n] = reads + (2 * q + k) * wide + ((column + 8 * n) ^ turns[k]) + g;
    }
    UNROLL for (int k = 0; k < 4 * COUNT; k++) {
        const int j = row + g + k % 4 / 2 * 8, i = column + k / 4 * 8 + 2 * q + k % 2;
        found[k / 4][k % 4] = begun && j < layer.makes && i < layer.reads
                                  ? weights[j * layer.reads + i]
                                  : 0.0f;
    }
#pragma unroll 2
    for (int p = 0; p < points; p += 8) {
        unsigned high_left[4], low_left[4], whole[COUNT][2], rest[COUNT][2];
        float parts[COUNT][4] = {};
        UNROLL for (int k = 0; k < 2; k++) {
            UNROLL for (int r = 0; r < 2; r++) {
                const float value = left[k][r][p * high];
                split(value, high_left[2 * k + r], low_left[2 * k + r]);
                down[r] += value;
            }
            UNROLL for (int n = 0; n < COUNT; n++) {
                split(right[k][n][p * wide], whole[n][k], rest[n][k]);
            }
        }
        UNROLL for (int n = 0; n < COUNT; n++) add_product(parts[n], low_left, whole[n]);
        UNROLL for (int n = 0; n < COUNT; n++) add_product(parts[n], high_left, rest[n]);
        UNROLL for (int n = 0; n < COUNT; n++) add_product(parts[n], high_left, whole[n]);
        UNROLL for (int k = 0; k < 4 * COUNT; k++) found[k / 4][k % 4] += parts[k / 4][k % 4];
    }
    UNROLL for (int k = 0; k < 4 * COUNT; k++) {
        const int j = row + g + k % 4 / 2 * 8, i = column + k / 4 * 8 + 2 * q + k % 2;
        if (j < layer.makes && i < layer.reads) weights[j * layer.reads + i] = found[k / 4][k % 4];
    }
    UNROLL for (int r = 0; r < 2; r++) {
        down[r] += __shfl_xor_sync(~0u, down[r], 1);
        down[r] += __shfl_xor_sync(~0u, down[r], 2);
        const int j = row + g + 8 * r;
        if (column == 0 && q == 0 && j < layer.makes)
            biases[j] = down[r] + (begun ? biases[j] : 0.0f);
    }
}

// The same for a whole layer, by all warps: what it made and read lies at these places of the
// shared memory. Not in line, as three forms of `learn_group` call it.
template <int COUNT>
__device__ __noinline__ void spread_weights(int deltas, int reads, int points, Layer layer,
                                            float* gradients, bool begun) {
    const int high = up_to(layer.makes, 32), wide = up_to(layer.reads, 32);
    const int across = (layer.reads + 8 * COUNT - 1) / (8 * COUNT),
              tiles = (layer.makes + 15) / 16 * across;
    for (int tile = threadIdx.x / 32; tile < tiles; tile += WARPS) {
        add_weights<COUNT>(memory + deltas, high, memory + reads, wide, points, tile / across * 16,
                           tile % across * 8 * COUNT, layer, gradients,
                           gradients + layer.makes * layer.reads, begun);
    }
}

// What a thread has of a group's squared error, and of its points that are learnt.
struct Part {
    double error;
    int learnt;
};

// The derivatives of the squared error by the last layer's outputs of 16 points, in their place,
// and that error.
template <int TILES>
FN void compare(float (&sums)[TILES][4], const View& targets, int first, int end, float share,
                Part& part) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, outputs = targets.size[1];
    UNROLL for (int r = 0; r < 2; r++) {
        const int p = first + g + 8 * r;
        const float* const target = targets.at + size_t(p) * outputs;
        float unknown = p < end ? 0.0f : 1.0f;
        UNROLL for (int k = 0; k < 2 * TILES; k++) {
            const int column = k / 2 * 8 + 2 * q + k % 2;
            float& value = sums[k / 2][2 * r + k % 2];
            const float wanted = column < outputs && p < end ? target[column] : 0.0f;
            if (!(fabsf(wanted) <= LARGEST_FLOAT)) unknown = 1.0f;
            value = column < outputs ? value - wanted : 0.0f;
        }
        unknown += __shfl_xor_sync(~0u, unknown, 1);
        unknown += __shfl_xor_sync(~0u, unknown, 2);
        part.learnt += q == 0 && unknown == 0.0f;
        UNROLL for (int k = 0; k < 2 * TILES; k++) {
            float& value = sums[k / 2][2 * r + k % 2];
            value = unknown > 0.0f ? 0.0f : value;
            part.error += double(value) * value;
            value *= 2.0f * share;
        }
    }
}

// One group of points: all layers forwards and backwards, for `most` points at a time, 16 for each
// warp that has some. A layer's derivatives take the place of what the next one read.
template <int TILES, bool SHARED>
__device__ __noinline__ Part learn_group(const Network& net, const float* weights, float* gradients,
                                         int most, const View& points, const View& targets,
                                         const View& pulls, int begin, int end) {
    const int g = threadIdx.x % 32 / 4, q = threadIdx.x % 4, last = net.layers,
              kind = net.activation;
    const int own = threadIdx.x / 32 * TILE, turns[2] = {turn_of(2 * q), turn_of(2 * q + 1)};
    const bool is_busy = own < most, is_pulled = pulls.size[0] == points.size[0];
    float* const slopes = memory + most * (net.rows[last + 1] - net.rows[1]);  // from layer 1 on
    const float share = 1.0f / (float(points.size[0]) * float(net.size[last]));
    Part part = {0.0, 0};
    for (int first = begin; first == begin || first < end; first += most) {
        Sums<TILES, 1> sums;
        if (is_busy) {
            encode_points(net, points, first + own, end, TILE,
                          memory + own * up_to(net.size[0], 32));
            for (int index = 0; index < last; index++) {
                const Layer layer = layer_of<8 * TILES, SHARED>(net, index, weights);
                const float* const reads = memory + most * net.rows[index]
                                           + own * up_to(layer.reads, 32);
                const int place = most * net.rows[index + 1] + own * up_to(layer.makes, 32);
                run_layer<TILES, 1, SHARED>(layer, reads, sums);
                if (index == last - 1) break;
                activate_rows(kind, layer.makes, sums[0], memory + place, slopes + place);
            }
            compare(sums[0], targets, first + own, end, share, part);
        }
        for (int index = last - 1; index >= 0; index--) {
            const Layer layer = layer_of<8 * TILES, SHARED>(net, index, weights);
            const int width = up_to(layer.reads, 32), high = up_to(layer.makes, 32);
            float* const reads = memory + most * net.rows[index];
            float* const deltas = memory + most * net.rows[index + 1];
            if (is_busy) {
                each_pair<TILES>(deltas + own * high, high, [&](int n, int r, Pair& pair) {
                    pair = {sums[0][n][2 * r], sums[0][n][2 * r + 1]};
                });
            }
            __syncthreads();
            float* const into = gradients + net.count[index];
            const int blocks = (layer.makes + 15) / 16;
            if (blocks * ((layer.reads + 31) / 32) >= WARPS) {
                spread_weights<4>(most * net.rows[index + 1], most * net.rows[index], most, layer,
                                  into, first > begin);
            } else if (blocks * ((layer.reads + 15) / 16) >= WARPS) {
                spread_weights<2>(most * net.rows[index + 1], most * net.rows[index], most, layer,
                                  into, first > begin);
            } else {
                spread_weights<1>(most * net.rows[index + 1], most * net.rows[index], most, layer,
                                  into, first > begin);
            }
            if (is_busy && (index || is_pulled)) {
                UNROLL for (int k = 0; k < 4 * TILES; k++) sums[0][k / 4][k % 4] = 0.0f;
                multiply<TILES, 1>(
                    sums, deltas + own * high, layer.makes, layer.reads, [&](int step, int tile) {
                        if (SHARED) {
                            const float* const row = layer.weights + (8 * step + 2 * q) * 8 * TILES
                                                     + g;
                            return Pair{row[(8 * tile) ^ turns[0]],
                                        row[8 * TILES + ((8 * tile) ^ turns[1])]};
                        }
                        const int j = 8 * step + 2 * q, lowest = layer.makes - 1;
                        const float* const column = layer.weights
                                                    + min(8 * tile + g, layer.reads - 1);
                        return Pair{column[min(j, lowest) * layer.reads],
                                    column[min(j + 1, lowest) * layer.reads]};
                    });
            }
            __syncthreads();
            if (is_busy && index) {
                float* const at = (kind == RELU ? reads : slopes + most * net.rows[index])
                                  + own * width;
                each_pair<TILES>(at, width, [&](int n, int r, const Pair& pair) {
                    const bool is_relu = kind == RELU;
                    const int column = 8 * n + 2 * q;
                    const float one = is_relu ? float(pair.x > 0.0f) : pair.x;
                    const float other = is_relu ? float(pair.y > 0.0f) : pair.y;
                    sums[0][n][2 * r] *= column < layer.reads ? one : 0.0f;
                    sums[0][n][2 * r + 1] *= column + 1 < layer.reads ? other : 0.0f;
                });
            } else if (is_busy && is_pulled) {
                UNROLL for (int k = 0; k < 4 * TILES; k++) {
                    const int column = k / 4 * 8 + 2 * q + k % 2,
                              p = first + own + g + k % 4 / 2 * 8;
                    if (column < net.inputs && p < end) {
                        pulls.at[size_t(p) * net.inputs + column] = sums[0][k / 4][k % 4];
                    }
                }
            }
        }
    }
    return part;
}

// network (12,), parameters (count,), points (points, inputs), targets (points, outputs) ->
// partials (groups, count + 2), and pulls (points, inputs) or (1, inputs): a block for a group.
extern "C" __global__ void __launch_bounds__(THREADS)
    neural_gradients(View network, View parameters, View points, View targets, View partials,
                     View pulls) {
    __shared__ Part parts[THREADS];
    __shared__ Network net;
    read_network(network, net);
    const int groups = partials.size[0], sums = partials.size[1], group = blockIdx.y;
    const long long total = points.size[0];
    float* const gradients = partials.at + size_t(group) * sums;
    const int begin = int(group * total / groups), end = int((group + 1) * total / groups);
    const int narrow = 64 / 8, wide = MOST_WIDTH / 8, last = net.layers,
              hidden = net.rows[last] - net.rows[1];
    const int floats = net.rows[last + 1] + (net.activation == RELU ? 0 : hidden);  // of a point
    int most = MOST_POINTS;
    while (most > TILE && (most * floats > shared_floats() || most >= 2 * (end - begin))) most /= 2;
    float* const weights = memory + most * floats;
    Part part;
    if (most * floats + net.space[last] > shared_floats()) {
        part = learn_group<wide, false>(net, parameters.at, gradients, most, points, targets, pulls,
                                        begin, end);
    } else if (net.widest <= 8 * narrow) {
        load_layers<8 * narrow>(net, parameters.at, weights);
        part = learn_group<narrow, true>(net, weights, gradients, most, points, targets, pulls,
                                         begin, end);
    } else {
        load_layers<8 * wide>(net, parameters.at, weights);
        part = learn_group<wide, true>(net, weights, gradients, most, points, targets, pulls, begin,
                                       end);
    }
    parts[threadIdx.x] = part;
    __syncthreads();
    if (threadIdx.x == 0) {
        for (int k = 1; k < THREADS; k++)
            part.error += parts[k].error, part.learnt += parts[k].learnt;
        gradients[sums - 2] = float(part.error / (double(total) * net.size[net.layers]));
        gradients[sums - 1] = float(double(part.learnt) / double(total));
    }
}

// What makes the sum of groups a mean over the points that are learnt; 0 if there are none.
FN float scale_of(const View& partials) {
    float share = 0.0f;
    for (int group = 0; group < partials.size[0]; group++) {
        share += partials.at[size_t(group + 1) * partials.size[1] - 1];
    }
    return share > 0.0f ? 1.0f / share : 0.0f;
}

// A step of one parameter, whose moments are a row of three.
FN void adam_step(float gradient, const View& hyper, float* row, float& parameter) {
    const float rate = hyper.at[0], slow = hyper.at[1], slower = hyper.at[2], epsilon = hyper.at[3];
    const float step = row[2] + 1.0f;
    const float size = rate / -expm1f(step * logf(slow)),
                scale = 1.0f / sqrtf(-expm1f(step * logf(slower)));
    row[0] = slow * row[0] + (1.0f - slow) * gradient;
    row[1] = slower * row[1] + (1.0f - slower) * gradient * gradient;
    row[2] = step;
    parameter -= size * row[0] / (sqrtf(row[1]) * scale + epsilon);
}

// partials (groups, count + 2), hyper (4,), parameters (count,), moments (count, 3): the last two
// change in place. A block for 8 parameters, 32 of whose threads share a parameter's groups.
extern "C" __global__ void __launch_bounds__(THREADS)
    neural_adam(View partials, View hyper, View parameters, View moments) {
    __shared__ float parts[THREADS];
    const int count = moments.size[0], y = blockIdx.y * 8 + threadIdx.x % 8;
    float gradient = 0.0f;
    for (int group = threadIdx.x / 8; y < count && group < partials.size[0]; group += THREADS / 8) {
        gradient += partials.at[size_t(group) * (count + 2) + y];
    }
    parts[threadIdx.x] = gradient;
    __syncthreads();
    if (threadIdx.x >= 8 || y >= count) return;
    for (int k = 8 + threadIdx.x; k < THREADS; k += 8) gradient += parts[k];
    adam_step(gradient * scale_of(partials), hyper, moments.at + 3 * size_t(y), parameters.at[y]);
}

struct Corner {
    int entry;
    float share;
};

// A corner of the cell of a grid's level that a point lies in.
FN Corner corner_of(const View& grid, int level, const float* point, int corner) {
    const unsigned primes[3] = {1u, 2654435761u, 805459861u};
    const int dims = int(grid.at[DIMS]), entries = int(grid.at[ENTRIES]),
              side = int(grid.at[SIDES + level]);
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

// grid (20,), table (levels, entries * numbers), points (points, dims + others) -> rows (points,
// levels * numbers + others).
extern "C" __global__ void neural_grid(View grid, View table, View points, View rows) {
    const int dims = int(grid.at[DIMS]), numbers = int(grid.at[NUMBERS]),
              levels = int(grid.at[LEVELS]);
    PIXEL(rows.size[1], rows.size[0]);
    const float* const point = points.at + size_t(y) * points.size[1];
    const int level = x / numbers;
    float value = 0.0f;
    if (level >= levels) value = point[dims + x - levels * numbers];
    for (int corner = 0; level < levels && corner < 1 << dims; corner++) {
        const Corner found = corner_of(grid, level, point, corner);
        value += found.share
                 * table.at[size_t(level) * table.size[1] + found.entry * numbers + x % numbers];
    }
    rows.at[size_t(y) * rows.size[1] + x] = value;
}

// grid (20,), points (points, dims + others), pulls (points, inputs) -> sums (levels, entries *
// numbers) int64, in units of 2^-44: a block for a level.
extern "C" __global__ void __launch_bounds__(THREADS)
    neural_grid_pull(View grid, View points, View pulls, View sums) {
    const int dims = int(grid.at[DIMS]), numbers = int(grid.at[NUMBERS]), level = blockIdx.y;
    unsigned long long* const row = reinterpret_cast<unsigned long long*>(sums.at)
                                    + size_t(level) * sums.size[1];
    for (int k = threadIdx.x; k < sums.size[1]; k += THREADS) row[k] = 0;
    __syncthreads();
    for (int p = threadIdx.x; p < points.size[0]; p += THREADS) {
        const float* const pull = pulls.at + size_t(p) * pulls.size[1] + level * numbers;
        for (int corner = 0; corner < 1 << dims; corner++) {
            const Corner found = corner_of(grid, level, points.at + size_t(p) * points.size[1],
                                           corner);
            for (int k = 0; k < numbers; k++) {
                const float own = clamped(found.share * pull[k], -MOST_PULL, MOST_PULL);
                const long long units = llrint(double(own) * UNITS);
                if (units) atomicAdd(row + found.entry * numbers + k, (unsigned long long)(units));
            }
        }
    }
}

// sums (levels, entries * numbers) int64, partials (groups, parts), hyper (4,), table (levels,
// entries * numbers), moments (levels, entries * numbers, 3): the last two change in place.
extern "C" __global__ void neural_grid_step(View sums, View partials, View hyper, View table,
                                            View moments) {
    PIXEL(table.size[1], table.size[0]);
    const size_t at = size_t(y) * table.size[1] + x;
    const long long units = reinterpret_cast<const long long*>(sums.at)[at];
    if (units == 0) return;
    const float gradient = float(double(units) / UNITS) * scale_of(partials);
    adam_step(gradient, hyper, moments.at + 3 * at, table.at[at]);
}

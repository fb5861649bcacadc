// Small networks: see postfx/kernels/neural.py, which says what the tensors hold.
//
// A block works on some points at a time; its threads share the rows of every layer. Thread counts do not matter, so
// that one thread can do it all.
const int NEURAL_WIDTH = 128, NEURAL_LAYERS = 5, NEURAL_POINTS = 16;
typedef float Rows[NEURAL_WIDTH][NEURAL_POINTS];

struct Team {
    int thread, threads;
};

__device__ inline Team team() {
    return {int(threadIdx.y * blockDim.x + threadIdx.x), int(blockDim.x * blockDim.y)};
}

struct Network {
    int layers, inputs, encoded, bands, activation;
    const float* sizes;
    __device__ int size(int layer) const { return int(sizes[layer]); }
};

__device__ inline Network network_of(const View& view) {
    const float* at = view.at;
    return {int(at[0]), int(at[1]), int(at[2]), int(at[3]), int(at[4]), at + 5};
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

// What the first layer reads of `count` points.
__device__ inline void encode_points(const Network& net, const float* points, int count, Rows rows) {
    const Team by = team();
    for (int k = by.thread; k < net.size(0) * count; k += by.threads) {
        const int row = k / count, p = k % count, feature = row - net.inputs;
        if (feature < 0) {
            rows[row][p] = points[p * net.inputs + row];
        } else {
            const int pair = feature / 2, band = pair / net.encoded;
            const float turns = points[p * net.inputs + pair % net.encoded] * float(1 << band);
            const float whole = floorf(turns + 0.5f), angle = (turns - whole) * 3.14159265358979f;
            const float sign = whole * 0.5f == floorf(whole * 0.5f) ? 1.0f : -1.0f;
            rows[row][p] = sign * (feature % 2 ? cosf(angle) : sinf(angle));
        }
    }
    __syncthreads();
}

// A layer before its activation. `kind` is the activation of what it reads; -1 is none.
__device__ inline void run_layer(const float* weights, int reads, int makes, int kind, int count, Rows from, Rows to) {
    const Team by = team();
    for (int k = by.thread; k < makes * count; k += by.threads) {
        const int j = k / count, p = k % count;
        float total = weights[reads * makes + j];
        for (int i = 0; i < reads; i++) {
            total += weights[j * reads + i] * (kind < 0 ? from[i][p] : activated(kind, from[i][p]));
        }
        to[j][p] = total;
    }
    __syncthreads();
}

// network (12,), parameters (count,), points (points, inputs) -> values (points, outputs): a block for 8 points.
extern "C" __global__ void neural_forward(View network, View parameters, View points, View values) {
    __shared__ Rows rows[2];
    const int outputs = values.size[1], each = min(int(blockDim.y), NEURAL_POINTS);
    const int first = blockIdx.y * blockDim.y, count = min(each, values.size[0] - first);
    if (blockIdx.x > 0 || count <= 0) return;
    const Network net = network_of(network);
    const Team by = team();
    encode_points(net, points.at + size_t(first) * net.inputs, count, rows[0]);
    const float* weights = parameters.at;
    for (int layer = 0; layer < net.layers; layer++) {
        const int reads = net.size(layer), makes = net.size(layer + 1);
        Rows& to = rows[(layer + 1) % 2];
        run_layer(weights, reads, makes, -1, count, rows[layer % 2], to);
        if (layer < net.layers - 1) {  // here once for a number, not again for each that reads it
            for (int k = by.thread; k < makes * count; k += by.threads) {
                to[k / count][k % count] = activated(net.activation, to[k / count][k % count]);
            }
            __syncthreads();
        }
        weights += (reads + 1) * makes;
    }
    for (int k = by.thread; k < outputs * count; k += by.threads) {
        values.at[size_t(first + k / outputs) * outputs + k % outputs] = rows[net.layers % 2][k % outputs][k / outputs];
    }
}

// network (12,), parameters (count,), points (points, inputs), targets (points, outputs) -> partials (groups, count + 1):
// a block takes whole groups. Rows hold layers before their activation, and derivatives of these once they are known.
extern "C" __global__ void neural_gradients(View network, View parameters, View points, View targets, View partials) {
    __shared__ Rows rows[NEURAL_LAYERS + 1];
    const Network net = network_of(network);
    const Team by = team();
    const int outputs = targets.size[1], groups = partials.size[0], sums = partials.size[1];
    const long long total = points.size[0];
    const float share = 1.0f / float(total * outputs);
    for (int group = blockIdx.y * gridDim.x + blockIdx.x; group < groups; group += gridDim.x * gridDim.y) {
        float* const gradients = partials.at + size_t(group) * sums;
        double error = 0.0;
        for (int k = by.thread; k < sums - 1; k += by.threads) gradients[k] = 0.0f;
        const int end = int((group + 1) * total / groups);
        for (int first = int(group * total / groups); first < end; first += NEURAL_POINTS) {
            const int count = min(NEURAL_POINTS, end - first);
            __syncthreads();
            encode_points(net, points.at + size_t(first) * net.inputs, count, rows[0]);
            const float* weights = parameters.at;
            for (int layer = 0; layer < net.layers; layer++) {
                const int reads = net.size(layer), makes = net.size(layer + 1);
                run_layer(weights, reads, makes, layer ? net.activation : -1, count, rows[layer], rows[layer + 1]);
                weights += (reads + 1) * makes;
            }
            Rows& result = rows[net.layers];
            for (int p = by.thread; p < count; p += by.threads) {
                const float* const target = targets.at + size_t(first + p) * outputs;
                bool known = true;
                for (int j = 0; j < outputs; j++) known = known && fabsf(target[j]) <= 3.4028234664e38f;
                for (int j = 0; j < outputs; j++) result[j][p] = known ? 2.0f * share * (result[j][p] - target[j]) : 0.0f;
            }
            __syncthreads();
            if (by.thread == 0) {
                for (int k = 0; k < outputs * count; k++) {
                    const double difference = result[k / count][k % count] / (2.0 * share);
                    error += difference * difference;
                }
            }
            for (int layer = net.layers - 1; layer >= 0; layer--) {
                const int reads = net.size(layer), makes = net.size(layer + 1);
                weights -= (reads + 1) * makes;
                float* const asked = gradients + (weights - parameters.at);
                for (int k = by.thread; k < (reads + 1) * makes; k += by.threads) {
                    const bool bias = k >= reads * makes;
                    const int j = bias ? k - reads * makes : k / reads, i = bias ? 0 : k % reads;
                    float more = 0.0f;
                    for (int p = 0; p < count; p++) {
                        const float read = layer ? activated(net.activation, rows[layer][i][p]) : rows[0][i][p];
                        more += rows[layer + 1][j][p] * (bias ? 1.0f : read);
                    }
                    asked[k] += more;
                }
                __syncthreads();
                if (layer == 0) break;
                for (int k = by.thread; k < reads * count; k += by.threads) {
                    const int i = k / count, p = k % count;
                    float more = 0.0f;
                    for (int j = 0; j < makes; j++) more += weights[j * reads + i] * rows[layer + 1][j][p];
                    rows[layer][i][p] = more * slope_of(net.activation, rows[layer][i][p]);
                }
                __syncthreads();
            }
        }
        if (by.thread == 0) gradients[sums - 1] = float(error / (double(total) * outputs));
    }
}

// partials (groups, count + 1), hyper (4,), parameters (count,), moments (count, 3): the last two change in place.
extern "C" __global__ void neural_adam(View partials, View hyper, View parameters, View moments) {
    const int count = moments.size[0];
    PIXEL(1, count);
    float gradient = 0.0f;
    for (int group = 0; group < partials.size[0]; group++) gradient += partials.at[size_t(group) * (count + 1) + y];
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

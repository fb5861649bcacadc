// Harmonic mean depth of what was hit, 1 where nothing was: depth (h, w, 1) -> depth_scale (1,). One block.
__device__ inline bool is_hit(float z) {
    return z > 0.0f && z < 1e9f;
}

// Sum of 1 / z over four depths; a product of fractions needs one division, and 4 factors of 1e-6 to 1e9 stay normal.
__device__ inline float nearness(const Four& depth) {
    const bool a = is_hit(depth.x), b = is_hit(depth.y), c = is_hit(depth.z), d = is_hit(depth.w);
    const float p = a ? fmaxf(depth.x, 1e-6f) : 1.0f, q = b ? fmaxf(depth.y, 1e-6f) : 1.0f;
    const float r = c ? fmaxf(depth.z, 1e-6f) : 1.0f, s = d ? fmaxf(depth.w, 1e-6f) : 1.0f;
    const float left = (a ? q : 0.0f) + (b ? p : 0.0f), right = (c ? s : 0.0f) + (d ? r : 0.0f);
    return (left * (r * s) + right * (p * q)) / ((p * q) * (r * s));
}

__device__ inline int hits_of(const Four& depth) {
    return is_hit(depth.x) + is_hit(depth.y) + is_hit(depth.z) + is_hit(depth.w);
}

extern "C" __global__ void __launch_bounds__(1024) denoise_scale(View depth, View depth_scale) {
    __shared__ double near[1024];
    __shared__ int hits[1024];
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    const int count = depth.size[0] * depth.size[1], fours = count / 4;
    double sum = 0.0;
    int seen = 0;
    int i = thread;
    for (; i + 3 * threads < fours; i += 4 * threads) {  // four reads on their way at a time: there is but one block
        const Four a = four(depth, i), b = four(depth, i + threads);
        const Four c = four(depth, i + 2 * threads), d = four(depth, i + 3 * threads);
        sum += (nearness(a) + nearness(b)) + (nearness(c) + nearness(d));
        seen += hits_of(a) + hits_of(b) + hits_of(c) + hits_of(d);
    }
    for (; i < fours; i += threads) {
        const Four a = four(depth, i);
        sum += nearness(a);
        seen += hits_of(a);
    }
    for (i = 4 * fours + thread; i < count; i += threads) {
        const Four a = {depth.at[i], 0.0f, 0.0f, 0.0f};
        sum += nearness(a);
        seen += hits_of(a);
    }
    near[thread] = sum;
    hits[thread] = seen;
    for (int half = threads / 2; half > 0; half /= 2) {
        __syncthreads();
        if (thread >= half) continue;
        near[thread] += near[thread + half];
        hits[thread] += hits[thread + half];
    }
    if (thread == 0) depth_scale.at[0] = hits[0] ? float(hits[0] / near[0]) : 1.0f;
}

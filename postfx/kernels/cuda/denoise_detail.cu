// Share of each tile's difference to give back: sums (tiles_high, tiles_wide, 11), evidence (1,) -> detail (tiles_high,
// tiles_wide, 1). What the frame has in common needs all tiles, so the first block strides over them and others end.
const int LAGS = 8, NEAR = 6, SUMS = 3 + LAGS, TOTALS = 3 + NEAR;  // near: lags that a pixel filter reaches
const int HIGH = 8, WIDE = 32, PITCH = (WIDE + 2) * SUMS;  // tiles that are read at once, and a border of one
const int MOST_THREADS = 1024;
const float LEAST = 1e-12f, LN10 = 2.302585093f;

struct Tile {
    float power, noise, correlation[LAGS];
};

__device__ inline float ramp(float value, float low, float high) {
    return fminf(fmaxf((value - low) / (high - low), 0.0f), 1.0f);
}

// Reads an area of tiles and its border; those beyond the frame are zeros and so do not count.
__device__ inline void read_area(const View& sums, int top, int left, float* area, int thread, int threads) {
    __syncthreads();
    for (int i = thread; i < (HIGH + 2) * PITCH; i += threads) {
        const int y = top + i / PITCH - 1, column = (left - 1) * SUMS + i % PITCH, width = sums.size[1] * SUMS;
        const bool inside = y >= 0 && y < sums.size[0] && column >= 0 && column < width;
        area[i] = inside ? sums.at[y * width + column] : 0.0f;
    }
    __syncthreads();
}

// Power, noise of the structure and correlations around a tile; neighbours count by 1 2 1 both ways.
__device__ inline Tile gather(const float* tile) {
    float spread[SUMS];
#pragma unroll
    for (int k = 0; k < SUMS; k++) {
        const float* const at = tile + k;
        spread[k] = 4.0f * at[0] + 2.0f * (at[-SUMS] + at[SUMS] + at[-PITCH] + at[PITCH])
            + (at[-PITCH - SUMS] + at[-PITCH + SUMS] + at[PITCH - SUMS] + at[PITCH + SUMS]);
    }
    Tile found = {spread[1] / spread[0], 2.25f * LAGS / spread[0], {}};
    const float scale = 1.0f / (spread[2] + LEAST);
#pragma unroll
    for (int k = 0; k < LAGS; k++) found.correlation[k] = spread[3 + k] * scale;
    return found;
}

// Share of detail in what was removed around a tile.
__device__ inline float detail_of(const Tile& tile, const float common[NEAR]) {
    float structure = -tile.noise;
#pragma unroll
    for (int k = 0; k < LAGS; k++) {
        const float own = tile.correlation[k] - (k < NEAR ? common[k] : 0.0f);
        structure += own * own;
    }
    const float faint = ramp(-logf(tile.power + LEAST), 5.6f * LN10, 6.4f * LN10);
    return fmaxf(ramp(sqrtf(fmaxf(structure, 0.0f)), 0.45f, 0.8f), faint);
}

// Sum over all threads of the block, in a fixed order.
__device__ inline float block_sum(float value, float* partial, int thread, int threads) {
    __syncthreads();
    partial[thread] = value;
    __syncthreads();
    for (int count = threads; count > 1; count = (count + 1) / 2) {
        if (thread < count / 2) partial[thread] += partial[thread + (count + 1) / 2];
        __syncthreads();
    }
    return partial[0];
}

extern "C" __global__ void __launch_bounds__(MOST_THREADS) denoise_detail(View sums, View evidence, View detail) {
    __shared__ float area[(HIGH + 2) * PITCH], partial[MOST_THREADS];
    if (blockIdx.x + blockIdx.y > 0) return;
    const int height = sums.size[0], width = sums.size[1];
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    float totals[TOTALS] = {};  // power, pixels, weight and weighted correlations of the frame
    for (int top = 0; top < height; top += HIGH) {
        for (int left = 0; left < width; left += WIDE) {
            read_area(sums, top, left, area, thread, threads);
            for (int i = thread; i < HIGH * WIDE; i += threads) {
                if (top + i / WIDE >= height || left + i % WIDE >= width) continue;
                const float* const tile = area + (i / WIDE + 1) * PITCH + (i % WIDE + 1) * SUMS;
                const Tile found = gather(tile);
                const float weight = sqrtf(found.power) * tile[0];
                totals[0] += tile[1];
                totals[1] += tile[0];
                totals[2] += weight;
#pragma unroll
                for (int k = 0; k < NEAR; k++) totals[3 + k] += weight * found.correlation[k];
            }
        }
    }
#pragma unroll
    for (int k = 0; k < TOTALS; k++) totals[k] = block_sum(totals[k], partial, thread, threads);
    const float power = totals[0] / totals[1], total = totals[2] + LEAST, loud = logf(power + LEAST);
    const float filtered = ramp(loud, -4.2f * LN10, -3.5f * LN10);
    const float quiet = ramp(-loud, 1.4f * LN10, 1.8f * LN10) * fminf(evidence.at[0], 1.0f);
    float common[NEAR], share = 0.0f;
#pragma unroll
    for (int k = 0; k < NEAR; k++) common[k] = filtered * fmaxf(totals[3 + k] / total, 0.0f);
    for (int top = 0; top < height; top += HIGH) {
        for (int left = 0; left < width; left += WIDE) {
            read_area(sums, top, left, area, thread, threads);
            for (int i = thread; i < HIGH * WIDE; i += threads) {
                const int y = top + i / WIDE, x = left + i % WIDE;
                if (y >= height || x >= width) continue;
                const float* const tile = area + (i / WIDE + 1) * PITCH + (i % WIDE + 1) * SUMS;
                const Tile found = gather(tile);
                const float own = quiet * detail_of(found, common);
                share += own * sqrtf(found.power) * tile[0];
                detail.at[y * width + x] = own;
            }
        }
    }
    share = block_sum(share, partial, thread, threads) / total;
    const float clean = ramp(share * evidence.at[0], 0.35f, 0.55f);
    for (int i = thread; i < height * width; i += threads) detail.at[i] += (1.0f - detail.at[i]) * clean;
}

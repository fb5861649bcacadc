// Sums over what was removed in tiles of 16x16: colour, denoised (h, w, 3), params (4,) -> sums (tiles_high,
// tiles_wide, 11): pixels, power, power once held, products at 8 lags. Blocks stride over rows of 8 tiles.
const int TILE = 16, GROUP = 8, LAGS = 8, SUMS = 3 + LAGS;
const int PITCH = TILE + 1;  // rows begin in different banks

// Exposed luminance of a pixel, within what the network sees.
__device__ inline float light_of(const float* pixel, float exposure) {
    const float r = fminf(clamped(pixel[0], 0.0f, MAX_FLOAT) * exposure, MAX_COLOUR);
    const float g = fminf(clamped(pixel[1], 0.0f, MAX_FLOAT) * exposure, MAX_COLOUR);
    const float b = fminf(clamped(pixel[2], 0.0f, MAX_FLOAT) * exposure, MAX_COLOUR);
    return 0.2126f * r + 0.7152f * g + 0.0722f * b;
}

// What was removed as it is seen: times the slope of sqrt(y / (1 + y)) at the result, within [-1, 1].
__device__ inline float removed_at(const float* noisy, const float* denoised, float exposure) {
    const float clean = light_of(denoised, exposure), seen = fmaxf(clean, 1e-3f);
    const float slope = 0.5f / (sqrtf(seen * (1.0f + seen)) * (1.0f + seen));
    return fminf(fmaxf((light_of(noisy, exposure) - clean) * slope, -1.0f), 1.0f);
}

__device__ inline float held_within(float value, float limit) {
    return fminf(fmaxf(value, -limit), limit);
}

// Sum over a row of products of `own` and the pixels `shift` right of each in another row; both ends lie in the tile.
template <int SHIFT>
__device__ inline float across(const float own[TILE], const float other[TILE]) {
    float sum = 0.0f;
#pragma unroll
    for (int i = SHIFT < 0 ? -SHIFT : 0; i < (SHIFT < 0 ? TILE : TILE - SHIFT); i++) sum += own[i] * other[i + SHIFT];
    return sum * (float(TILE) / (TILE - (SHIFT < 0 ? -SHIFT : SHIFT)));  // per whole row of pairs
}

__device__ inline void load_row(const float* row, float limit, float values[TILE]) {
#pragma unroll
    for (int i = 0; i < TILE; i++) values[i] = held_within(row[i], limit);
}

// What a row of a tile adds to each sum from the third one on; rows beyond the tile do not count.
__device__ inline void sum_row(const float* row, int y, float limit, float sums[1 + LAGS]) {
    float own[TILE], other[TILE];
    load_row(row, limit, own);
    sums[0] = across<0>(own, own);
    sums[1] = across<1>(own, own);
    sums[5] = across<2>(own, own);
    sums[7] = across<4>(own, own);
    sums[2] = sums[3] = sums[4] = sums[6] = sums[8] = 0.0f;
    if (y + 1 < TILE) {
        load_row(row + PITCH, limit, other);
        const float scale = float(TILE) / (TILE - 1);
        sums[2] = across<0>(own, other) * scale;
        sums[3] = across<1>(own, other) * scale;
        sums[4] = across<-1>(own, other) * scale;
    }
    if (y + 2 < TILE) {
        load_row(row + 2 * PITCH, limit, other);
        sums[6] = across<0>(own, other) * (float(TILE) / (TILE - 2));
    }
    if (y + 4 < TILE) {
        load_row(row + 4 * PITCH, limit, other);
        sums[8] = across<0>(own, other) * (float(TILE) / (TILE - 4));
    }
}

__device__ inline float sum_of_rows(const float* rows) {
    float sum = 0.0f;
#pragma unroll
    for (int i = 0; i < TILE; i++) sum += rows[i];
    return sum;
}

extern "C" __global__ void denoise_judge(View colour, View denoised, View params, View sums) {
    __shared__ float removed[GROUP][TILE * PITCH], power[GROUP][PITCH], rows[GROUP][1 + LAGS][PITCH];
    const int h = colour.size[0], w = colour.size[1], tiles_wide = sums.size[1];
    const int groups_wide = (tiles_wide + GROUP - 1) / GROUP, groups = groups_wide * sums.size[0];
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    const float exposure = params.at[EXPOSURE];
    for (int group = blockIdx.y * gridDim.x + blockIdx.x; group < groups; group += gridDim.x * gridDim.y) {
        const int tile_y = group / groups_wide, tile_x = GROUP * (group - tile_y * groups_wide);
#pragma unroll 4
        for (int i = thread; i < TILE * TILE * GROUP; i += threads) {
            const int column = i % (TILE * GROUP), row = i / (TILE * GROUP);
            const int y = tile_y * TILE + row, x = tile_x * TILE + column, at = 3 * (y * w + x);
            removed[column / TILE][row * PITCH + column % TILE] =
                y < h && x < w ? removed_at(colour.at + at, denoised.at + at, exposure) : 0.0f;
        }
        __syncthreads();
        for (int i = thread; i < GROUP * TILE; i += threads) {
            const float* const row = removed[i / TILE] + i % TILE * PITCH;
            float sum = 0.0f;
#pragma unroll
            for (int k = 0; k < TILE; k++) sum += row[k] * row[k];
            power[i / TILE][i % TILE] = sum;
        }
        __syncthreads();
        for (int i = thread; i < GROUP * TILE; i += threads) {
            const int tile = i / TILE, row = i % TILE;
            const int count = min(TILE, h - tile_y * TILE) * min(TILE, w - (tile_x + tile) * TILE);
            if (tile_x + tile >= tiles_wide) continue;
            const float all = sum_of_rows(power[tile]);
            float found[1 + LAGS];
            sum_row(removed[tile] + row * PITCH, row, 3.0f * sqrtf(all / count), found);  // fireflies are held there
#pragma unroll
            for (int k = 0; k <= LAGS; k++) rows[tile][k][row] = found[k];
            if (row > 0) continue;
            float* const result = sums.at + (tile_y * tiles_wide + tile_x + tile) * SUMS;
            result[0] = count;
            result[1] = all;
        }
        __syncthreads();
        for (int i = thread; i < GROUP * (1 + LAGS); i += threads) {
            const int tile = i / (1 + LAGS), k = i % (1 + LAGS);
            if (tile_x + tile < tiles_wide)
                sums.at[(tile_y * tiles_wide + tile_x + tile) * SUMS + 2 + k] = sum_of_rows(rows[tile][k]);
        }
    }
}

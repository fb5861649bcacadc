#include "output.h"

// Sums over what was removed in tiles of 16x16: colour, denoised (h, w, 3), params (4,), judged
// (tiles_high, tiles_wide,
// 1) -> sums (tiles_high, tiles_wide, 11): pixels, power, power once held, products at 8 lags; all
// are 0 where a tile is not judged. Blocks stride over rows of 8 tiles.
const int GROUP = 8, LAGS = SUMS - FIRST;
const int PITCH = TILE + 1;  // rows begin in different banks

// What was removed at a pixel, as it is seen.
FN float removed_at(const float* noisy, const float* denoised, float exposure) {
    return seen_difference<float>(luminance_of<float>(noisy[0], noisy[1], noisy[2], exposure),
                                  luminance_of<float>(denoised[0], denoised[1], denoised[2],
                                                      exposure));
}

FN float held_within(float value, float limit) { return fminf(fmaxf(value, -limit), limit); }

// Sum over a row of products of `own` and the pixels `shift` right of each in another row; both
// ends lie in the tile.
template <int SHIFT>
FN float across(const float own[TILE], const float other[TILE]) {
    float sum = 0.0f;
    UNROLL for (int i = SHIFT < 0 ? -SHIFT : 0; i < (SHIFT < 0 ? TILE : TILE - SHIFT); i++)
        sum += own[i] * other[i + SHIFT];
    return sum * (float(TILE) / (TILE - (SHIFT < 0 ? -SHIFT : SHIFT)));  // per whole row of pairs
}

FN void load_row(const float* row, float limit, float values[TILE]) {
    UNROLL for (int i = 0; i < TILE; i++) values[i] = held_within(row[i], limit);
}

// What a row of a tile adds to each sum from the third one on; rows beyond the tile do not count.
FN void sum_row(const float* row, int y, float limit, float sums[1 + LAGS]) {
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

FN float sum_of_rows(const float* rows) {
    float sum = 0.0f;
    UNROLL for (int i = 0; i < TILE; i++) sum += rows[i];
    return sum;
}

extern "C" __global__ void denoise_judge(View colour, View denoised, View params, View judged,
                                         View sums) {
    __shared__ float removed[GROUP][TILE * PITCH], power[GROUP][PITCH],
        rows[GROUP][1 + LAGS][PITCH];
    const int h = colour.size[0], w = colour.size[1], tiles_wide = sums.size[1];
    const int groups_wide = (tiles_wide + GROUP - 1) / GROUP, groups = groups_wide * sums.size[0];
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    const float exposure = params.at[EXPOSURE];
    for (int group = blockIdx.y * gridDim.x + blockIdx.x; group < groups;
         group += gridDim.x * gridDim.y) {
        const int tile_y = group / groups_wide, tile_x = GROUP * (group - tile_y * groups_wide);
#pragma unroll 4
        for (int i = thread; i < TILE * TILE * GROUP; i += threads) {
            const int column = i % (TILE * GROUP), row = i / (TILE * GROUP);
            const int y = tile_y * TILE + row, x = tile_x * TILE + column, at = 3 * (y * w + x);
            const bool counts = y < h && x < w && judged.at[tile_y * tiles_wide + x / TILE] > 0.0f;
            removed[column / TILE][row * PITCH + column % TILE] =
                counts ? removed_at(colour.at + at, denoised.at + at, exposure) : 0.0f;
        }
        __syncthreads();
        for (int i = thread; i < GROUP * TILE; i += threads) {
            const float* const row = removed[i / TILE] + i % TILE * PITCH;
            float sum = 0.0f;
            UNROLL for (int k = 0; k < TILE; k++) sum += row[k] * row[k];
            power[i / TILE][i % TILE] = sum;
        }
        __syncthreads();
        for (int i = thread; i < GROUP * TILE; i += threads) {
            const int tile = i / TILE, row = i % TILE;
            const int count = min(TILE, h - tile_y * TILE) * min(TILE, w - (tile_x + tile) * TILE);
            if (tile_x + tile >= tiles_wide) continue;
            const float all = sum_of_rows(power[tile]);
            float found[1 + LAGS];
            // fireflies are held there
            sum_row(removed[tile] + row * PITCH, row, LIMIT * sqrtf(all / count), found);
            UNROLL for (int k = 0; k <= LAGS; k++) rows[tile][k][row] = found[k];
            if (row > 0) continue;
            float* const result = sums.at + (tile_y * tiles_wide + tile_x + tile) * SUMS;
            result[COUNT] = judged.at[tile_y * tiles_wide + tile_x + tile] > 0.0f ? count : 0.0f;
            result[POWER] = all;
        }
        __syncthreads();
        for (int i = thread; i < GROUP * (1 + LAGS); i += threads) {
            const int tile = i / (1 + LAGS), k = i % (1 + LAGS);
            if (tile_x + tile < tiles_wide)
                sums.at[(tile_y * tiles_wide + tile_x + tile) * SUMS + HELD_POWER + k] =
                    sum_of_rows(rows[tile][k]);
        }
    }
}

// Share of each tile's difference to give back: sums (tiles_high, tiles_wide, 11), evidence (1,),
// known (tiles_high, tiles_wide, 1) -> detail (tiles_high, tiles_wide, 1), at least as much as is
// known. What the frame has in common needs all tiles, so the first block strides over them and
// others end.
const int TOTALS = 3 + NEAR;
// tiles that are read at once, and a border of one
const int HIGH = 8, WIDE = 32, AREA_PITCH = (WIDE + 2) * SUMS;
const int MOST_THREADS = 1024;

struct Tile {
    float power, noise, correlation[LAGS];
};

FN float ramp(float value, float low, float high) {
    return fminf(fmaxf((value - low) / (high - low), 0.0f), 1.0f);
}

// Reads an area of tiles and its border; those beyond the frame are zeros and so do not count.
FN void read_area(const View& sums, int top, int left, float* area, int thread, int threads) {
    __syncthreads();
    for (int i = thread; i < (HIGH + 2) * AREA_PITCH; i += threads) {
        const int y = top + i / AREA_PITCH - 1, column = (left - 1) * SUMS + i % AREA_PITCH,
                  width = sums.size[1] * SUMS;
        const bool inside = y >= 0 && y < sums.size[0] && column >= 0 && column < width;
        area[i] = inside ? sums.at[y * width + column] : 0.0f;
    }
    __syncthreads();
}

// Power, noise of the structure and correlations around a tile; neighbours count by 1 2 1 both
// ways.
FN Tile gather(const float* tile) {
    float spread[SUMS];
    UNROLL for (int k = 0; k < SUMS; k++) {
        const float* const at = tile + k;
        spread[k] = 4.0f * at[0] + 2.0f * (at[-SUMS] + at[SUMS] + at[-AREA_PITCH] + at[AREA_PITCH])
                    + (at[-AREA_PITCH - SUMS] + at[-AREA_PITCH + SUMS] + at[AREA_PITCH - SUMS]
                       + at[AREA_PITCH + SUMS]);
    }
    const float count = fmaxf(spread[COUNT], 1.0f);  // 0 if nothing around is judged
    Tile found = {spread[POWER] / count, SPREAD_NOISE * LAGS / count, {}};
    const float scale = 1.0f / (spread[HELD_POWER] + TINY_POWER);
    UNROLL for (int k = 0; k < LAGS; k++) found.correlation[k] = spread[FIRST + k] * scale;
    return found;
}

// Share of detail in what was removed around a tile.
FN float detail_of(const Tile& tile, const float common[NEAR]) {
    float structure = -tile.noise;
    UNROLL for (int k = 0; k < LAGS; k++) {
        const float own = tile.correlation[k] - (k < NEAR ? common[k] : 0.0f);
        structure += own * own;
    }
    const float faint = ramp(-logf(tile.power + TINY_POWER), -logf(INVISIBLE_HIGH),
                             -logf(INVISIBLE_LOW));
    return fmaxf(ramp(sqrtf(fmaxf(structure, 0.0f)), STRUCTURE_LOW, STRUCTURE_HIGH), faint);
}

// Sum over all threads of the block, in a fixed order.
FN float block_sum(float value, float* partial, int thread, int threads) {
    __syncthreads();
    partial[thread] = value;
    __syncthreads();
    for (int count = threads; count > 1; count = (count + 1) / 2) {
        if (thread < count / 2) partial[thread] += partial[thread + (count + 1) / 2];
        __syncthreads();
    }
    return partial[0];
}

extern "C" __global__ void __launch_bounds__(MOST_THREADS)
    denoise_detail(View sums, View evidence, View known, View detail) {
    __shared__ float area[(HIGH + 2) * AREA_PITCH], partial[MOST_THREADS];
    if (blockIdx.x + blockIdx.y > 0) return;
    const int height = sums.size[0], width = sums.size[1];
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    float totals[TOTALS] = {};  // power, pixels, weight and weighted correlations of the frame
    for (int top = 0; top < height; top += HIGH) {
        for (int left = 0; left < width; left += WIDE) {
            read_area(sums, top, left, area, thread, threads);
            for (int i = thread; i < HIGH * WIDE; i += threads) {
                if (top + i / WIDE >= height || left + i % WIDE >= width) continue;
                const float* const tile = area + (i / WIDE + 1) * AREA_PITCH
                                          + (i % WIDE + 1) * SUMS;
                const Tile found = gather(tile);
                const float weight = sqrtf(found.power) * tile[0];
                totals[0] += tile[1];
                totals[1] += tile[0];
                totals[2] += weight;
                UNROLL for (int k = 0; k < NEAR; k++) {
                    totals[3 + k] += weight * found.correlation[k];
                }
            }
        }
    }
    UNROLL for (int k = 0; k < TOTALS; k++) {
        totals[k] = block_sum(totals[k], partial, thread, threads);
    }
    const float power = totals[0] / fmaxf(totals[1], 1.0f), total = totals[2] + TINY_POWER,
                loud = logf(power + TINY_POWER);
    const float filtered = ramp(loud, logf(FILTERED_LOW), logf(FILTERED_HIGH));
    const float quiet = ramp(-loud, -logf(LOUD_HIGH), -logf(LOUD_LOW))
                        * fminf(evidence.at[0], 1.0f);
    float common[NEAR], share = 0.0f;
    UNROLL for (int k = 0; k < NEAR; k++) common[k] = filtered * fmaxf(totals[3 + k] / total, 0.0f);
    for (int top = 0; top < height; top += HIGH) {
        for (int left = 0; left < width; left += WIDE) {
            read_area(sums, top, left, area, thread, threads);
            for (int i = thread; i < HIGH * WIDE; i += threads) {
                const int y = top + i / WIDE, x = left + i % WIDE;
                if (y >= height || x >= width) continue;
                const float* const tile = area + (i / WIDE + 1) * AREA_PITCH
                                          + (i % WIDE + 1) * SUMS;
                const Tile found = gather(tile);
                const float own = quiet * detail_of(found, common);
                share += own * sqrtf(found.power) * tile[0];
                detail.at[y * width + x] = own;
            }
        }
    }
    share = block_sum(share, partial, thread, threads) / total;
    const float clean = ramp(share * evidence.at[0], CLEAN_LOW, CLEAN_HIGH);
    for (int i = thread; i < height * width; i += threads)
        detail.at[i] = fmaxf(detail.at[i] + (1.0f - detail.at[i]) * clean, known.at[i]);
}

// Gives detail back: colour, denoised (h, w, 3), detail (tiles_high, tiles_wide, 1) -> output (h,
// w, 3).
extern "C" __global__ void denoise_restore(View colour, View denoised, View detail, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const Between row = between_cells((y + 0.5f) * (1.0f / TILE) - 0.5f, detail.size[0]);
    const Between column = between_cells((x + 0.5f) * (1.0f / TILE) - 0.5f, detail.size[1]);
    const float share = between(detail, row, column);
    const int channels = output.size[2], here = channels * (y * width + x);
    for (int c = 0; c < channels; c++) {
        const float noisy = clamped(colour.at[here + c], 0.0f, MAX_FLOAT);
        output.at[here + c] = blended_by<float>(denoised.at[here + c], noisy, share);
    }
}

// A picture from what was computed in parts of it: tiles (n, th, tw, c), places (n, 10): origin,
// what may be used, what is used before others; frame_rows (rows,), frame_columns (columns,) ->
// picture (rows, columns, c), 0 where no tile is.
FN bool is_within(const float* box, int y, int x) {
    return y >= box[0] && x >= box[1] && y < box[2] && x < box[3];
}

extern "C" __global__ void denoise_assemble(View tiles, View places, View frame_rows,
                                            View frame_columns, View picture) {
    PIXEL(picture.size[1], picture.size[0]);
    const int v = int(frame_rows.at[y]), u = int(frame_columns.at[x]), channels = picture.size[2];
    int owner = -1;
    for (int i = tiles.size[0] - 1; i >= 0; i--)
        if (is_within(places.at + PLACE * i + HELD, v, u)) owner = i;
    for (int i = tiles.size[0] - 1; i >= 0; i--)
        if (is_within(places.at + PLACE * i + OWN, v, u)) owner = i;
    const float* const place = places.at + PLACE * max(owner, 0);
    const size_t row = size_t(max(owner, 0)) * tiles.size[1] + (v - int(place[0]));
    const float* const from = tiles.at + (row * tiles.size[2] + (u - int(place[1]))) * channels;
    float* const to = picture.at + (size_t(y) * picture.size[1] + x) * channels;
    for (int c = 0; c < channels; c++) to[c] = owner < 0 ? 0.0f : from[c];
}

// Leaves the noise in by strength: denoised, plain (h, w, 3), strength (h, w, 1), amount (1,) ->
// output (h, w, 3).
extern "C" __global__ void denoise_strength(View denoised, View plain, View strength, View amount,
                                            View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const int here = y * width + x;
    const float share = clamped(strength.at[here], 0.0f, 1.0f) * clamped(amount.at[0], 0.0f, 1.0f);
    const int channels = output.size[2];
    for (int c = 0; c < channels; c++) {
        const int at = channels * here + c;
        output.at[at] = blended_by<float>(plain.at[at], denoised.at[at], share);
    }
}

// Slices a bilateral grid at every pixel, applies the affine colour matrix found there and looks the result up in a cube:
// colour (height, width, 3), params (3,), matrix (9,), guide (112,), grid (1, 16, 16, 8, 12),
// cube (size, size, size, 3) -> output (height, width, 3).
const int KNOTS = 16, SHIFTS = 12, SLOPES = SHIFTS + 3 * KNOTS, WEIGHTS = SLOPES + 3 * KNOTS, NUMBERS = WEIGHTS + 4;

// Shares of the two cells around a position along an axis.
struct Cells {
    int first, second;
    float share;
};

__device__ inline Cells cells_at(float position, int count) {
    const float at = fminf(fmaxf(position, 0.0f), float(count - 1));
    const int first = int(at);
    return {first, min(first + 1, count - 1), at - first};
}

// The guide's numbers as all threads of a block read them: every slope times the weight of its channel.
__device__ inline void read_guide(const View& guide, float* numbers) {
    const int threads = blockDim.x * blockDim.y, thread = threadIdx.y * blockDim.x + threadIdx.x;
    for (int i = thread; i < NUMBERS; i += threads) {
        const bool slope = i >= SLOPES && i < WEIGHTS;
        numbers[i] = guide.at[i] * (slope ? guide.at[WEIGHTS + (i - SLOPES) / KNOTS] : 1.0f);
    }
    __syncthreads();
}

// Level of a shaped colour in the grid, 0..1 before the clip: a sum of ramps over each channel of a matrix's result.
__device__ inline float level_of(const Colour& colour, const Four* numbers) {
    const float* const scalars = &numbers->x;
    float level = scalars[NUMBERS - 1];
#pragma unroll
    for (int c = 0; c < 3; c++) {
        const float value = scalars[3 * c] * colour.r + scalars[3 * c + 1] * colour.g + scalars[3 * c + 2] * colour.b
            + scalars[9 + c];
#pragma unroll
        for (int k = 0; k < KNOTS / 4; k++) {
            const Four shift = numbers[(SHIFTS + c * KNOTS) / 4 + k], slope = numbers[(SLOPES + c * KNOTS) / 4 + k];
            level += slope.x * fmaxf(value - shift.x, 0.0f) + slope.y * fmaxf(value - shift.y, 0.0f)
                + (slope.z * fmaxf(value - shift.z, 0.0f) + slope.w * fmaxf(value - shift.w, 0.0f));
        }
    }
    return level;
}

__device__ inline void add(float weight, const Four& from, Four& to) {
    to = {to.x + weight * from.x, to.y + weight * from.y, to.z + weight * from.z, to.w + weight * from.w};
}

__device__ inline float applied(const Four& row, const Colour& colour) {
    return row.x * colour.r + row.y * colour.g + row.z * colour.b + row.w;
}

extern "C" __global__ void slice_apply(View colour, View params, View matrix, View guide, View grid, View cube,
                                       View output) {
    __shared__ Four numbers[NUMBERS / 4];
    read_guide(guide, &numbers->x);
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const int cells_high = grid.size[1], cells_wide = grid.size[2], levels = grid.size[3];
    const int here = 3 * (y * width + x);
    const Colour seen = shaped(shaper(params, matrix), colour.at + here);
    const Cells row = cells_at((y + 0.5f) * cells_high / height - 0.5f, cells_high);
    const Cells column = cells_at((x + 0.5f) * cells_wide / width - 0.5f, cells_wide);
    const Cells level = cells_at(level_of(seen, numbers) * levels - 0.5f, levels);
    Four red = {0.0f, 0.0f, 0.0f, 0.0f}, green = red, blue = red;
#pragma unroll
    for (int corner = 0; corner < 8; corner++) {
        const int j = corner & 4 ? row.second : row.first, i = corner & 2 ? column.second : column.first;
        const int k = corner & 1 ? level.second : level.first;
        const float weight = (corner & 4 ? row.share : 1.0f - row.share)
            * (corner & 2 ? column.share : 1.0f - column.share) * (corner & 1 ? level.share : 1.0f - level.share);
        const int cell = 3 * ((j * cells_wide + i) * levels + k);
        add(weight, four(grid, cell), red);
        add(weight, four(grid, cell + 1), green);
        add(weight, four(grid, cell + 2), blue);
    }
    const Colour found = looked_up(cube, {applied(red, seen), applied(green, seen), applied(blue, seen)});
    output.at[here] = found.r;
    output.at[here + 1] = found.g;
    output.at[here + 2] = found.b;
}

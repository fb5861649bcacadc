// Cubic resampling: image (h, w, channels), rows (height,), columns (width,) -> output (height, width, channels).
const float LARGEST = 3.402823466e38f;

struct Cubic {
    float weight[4];
    int index[4];
};

// The four taps around a position and their weights (Keys 1981, a = -0.5); only their constant indices are used.
__device__ inline Cubic cubic(float position, int size) {
    const float first = floorf(position), t = position - first;
    const int before = int(first) - 1;
    return {{((-0.5f * t + 1.0f) * t - 0.5f) * t, (1.5f * t - 2.5f) * t * t + 1.0f,
             ((-1.5f * t + 2.0f) * t + 0.5f) * t, (0.5f * t - 0.5f) * t * t},
            {within(before, size), within(before + 1, size), within(before + 2, size), within(before + 3, size)}};
}

__device__ inline float known(float value) {
    return fabsf(value) <= LARGEST ? value : 0.0f;
}

extern "C" __global__ void resample(View image, View rows, View columns, View output) {
    const int width = output.size[1], channels = image.size[2];
    PIXEL(width, output.size[0]);
    const Cubic down = cubic(rows.at[y], image.size[0]), across = cubic(columns.at[x], image.size[1]);
    const float* row[4];
#pragma unroll
    for (int j = 0; j < 4; j++) row[j] = image.at + size_t(down.index[j]) * image.size[1] * channels;
    float* const result = output.at + (size_t(y) * width + x) * channels;
    for (int k = 0; k < channels; k++) {
        float sum = 0.0f, least = LARGEST, most = -LARGEST;
#pragma unroll
        for (int i = 0; i < 4; i++) {
            const int at = across.index[i] * channels + k;
            const float before = known(row[0][at]), upper = known(row[1][at]), lower = known(row[2][at]);
            sum += across.weight[i] * (down.weight[0] * before + down.weight[1] * upper + down.weight[2] * lower
                                       + down.weight[3] * known(row[3][at]));
            if (i == 0 || i == 3) continue;
            least = fminf(least, fminf(upper, lower));
            most = fmaxf(most, fmaxf(upper, lower));
        }
        result[k] = fminf(fmaxf(sum, least), most);  // edges do not ring and nothing turns negative
    }
}

// Motion of a clearly nearer neighbour in 3x3, else its own: motion (h, w, 2), depth (h, w, 1), part_rows (th,),
// part_columns (tw,) -> moved (th, tw, 2).

// What no picture can have (NaN, infinity) is no motion.
__device__ inline float possible_motion(float value) {
    return value > -1e5f && value < 1e5f ? value : 0.0f;
}

extern "C" __global__ void denoise_dilate(View motion, View depth, View part_rows, View part_columns,
                                          View moved) {
    PIXEL(moved.size[1], moved.size[0]);
    const int height = depth.size[0], width = depth.size[1];
    const int v = int(part_rows.at[y]), u = int(part_columns.at[x]), here = v * width + u;
    float near = depth.at[here] * 0.9f;
    int at = here;
#pragma unroll
    for (int j = -1; j <= 1; j++) {
#pragma unroll
        for (int i = -1; i <= 1; i++) {
            // A repeated edge changes nothing: no pixel is nearer than itself.
            const int there = within(v + j, height) * width + within(u + i, width);
            const float z = depth.at[there];
            if (z < near) near = z, at = there;
        }
    }
    const Pair found = pair(motion, at);
    pair(moved, size_t(y) * moved.size[1] + x) = {possible_motion(found.x), possible_motion(found.y)};
}

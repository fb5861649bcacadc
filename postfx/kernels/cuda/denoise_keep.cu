// How much of the history each pixel of a part uses: reactive and last_reactive (h, w, 1), moved (th, tw, 2),
// part_rows (th,), part_columns (tw,) -> keep (th, tw, 1).
extern "C" __global__ void denoise_keep(View reactive, View last_reactive, View moved, View part_rows,
                                        View part_columns, View keep) {
    const int width = keep.size[1], h = reactive.size[0], w = reactive.size[1];
    PIXEL(width, keep.size[0]);
    const float v = part_rows.at[y], u = part_columns.at[x];
    const Pair motion = pair(moved, size_t(y) * width + x);
    const int from = within(int(rintf(v + motion.y)), h) * w + within(int(rintf(u + motion.x)), w);
    const float now = clamped(reactive.at[int(v) * w + int(u)], 0.0f, 1.0f);
    keep.at[y * width + x] = 1.0f - fmaxf(now, last_reactive.at[from]);
}

// Coverage of a premultiplied overlay (h, w, 4) over alpha (h, w, 1) -> output (h, w, 1).
extern "C" __global__ void overlay_over_alpha(View overlay, View alpha, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = size_t(y) * width + x;
    const float covered = clamped(overlay.at[4 * here + 3], 0.0f, 1.0f);
    output.at[here] = over(covered, covered, alpha.at[here]);
}

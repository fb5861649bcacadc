// Premultiplied overlay (h, w, 4) over colour (h, w, 3) -> output (h, w, 3).
extern "C" __global__ void overlay_over(View overlay, View colour, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const size_t here = size_t(y) * width + x;
    const float* const front = overlay.at + 4 * here;
    const float alpha = clamped(front[3], 0.0f, 1.0f);
    for (int c = 0; c < 3; c++) output.at[3 * here + c] = over(front[c], alpha, colour.at[3 * here + c]);
}

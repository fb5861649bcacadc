// Leaves the noise in by strength: denoised, plain (h, w, 3), strength (h, w, 1), amount (1,) -> output (h, w, 3).
extern "C" __global__ void denoise_strength(View denoised, View plain, View strength, View amount, View output) {
    const int width = output.size[1];
    PIXEL(width, output.size[0]);
    const int here = y * width + x;
    const float share = clamped(strength.at[here], 0.0f, 1.0f) * clamped(amount.at[0], 0.0f, 1.0f);
    for (int c = 0; c < 3; c++) {
        const float noisy = plain.at[3 * here + c], clean = denoised.at[3 * here + c];
        output.at[3 * here + c] = share == 1.0f ? clean : noisy + (clean - noisy) * share;  // both ends are exact
    }
}

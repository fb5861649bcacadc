// How far the guides' reflectance is trusted, in cells of 8x8 render pixels: less, the more of its detail is apart from
// the reflectance of the render size. diffuse_albedo and specular_albedo (h, w, 3), guide_diffuse_albedo and
// guide_specular_albedo (height, width, 3), window (8,), part_rows (th,), part_columns (tw,) -> trust (cells, cells, 1).
const float DOUBT = 0.7f, FAINT = 1e-4f;

extern "C" __global__ void denoise_trust(View diffuse_albedo, View specular_albedo, View guide_diffuse_albedo,
                                         View guide_specular_albedo, View window, View part_rows, View part_columns,
                                         View trust) {
    const int height = trust.size[0], width = trust.size[1];
    PIXEL(width, height);
    const Window part = window_of(window);
    const int bottom = min(min(TRUST_CELL * (y + 1), part_rows.size[0]), part.h - part.top);
    const int right = min(min(TRUST_CELL * (x + 1), part_columns.size[0]), part.w - part.left);
    float apart = 0.0f, spread = 0.0f;
    int count = 0;
    for (int i = TRUST_CELL * y; i < bottom; i++) {
        const int row = int(part_rows.at[i]);
        const int first = int(1LL * row * part.height / part.h);
        const int end = int((1LL * (row + 1) * part.height + part.h - 1) / part.h);
        for (int j = TRUST_CELL * x; j < right; j++, count++) {
            const int column = int(part_columns.at[j]);
            const int start = int(1LL * column * part.width / part.w);
            const int stop = int((1LL * (column + 1) * part.width + part.w - 1) / part.w);
            const Colour own = demodulation(diffuse_albedo, specular_albedo, row, column);
            Colour mean = {0.0f, 0.0f, 0.0f};
            float square = 0.0f;
            for (int v = first; v < end; v++)
                for (int u = start; u < stop; u++) {
                    const Colour guide = demodulation(guide_diffuse_albedo, guide_specular_albedo, v, u);
                    const float r = guide.r / own.r - 1.0f, g = guide.g / own.g - 1.0f, b = guide.b / own.b - 1.0f;
                    mean = {mean.r + r, mean.g + g, mean.b + b};
                    square += r * r + g * g + b * b;
                }
            const float share = 1.0f / ((end - first) * (stop - start));
            apart += (mean.r * mean.r + mean.g * mean.g + mean.b * mean.b) * (share * share);
            spread += square * share;
        }
    }
    trust.at[y * width + x] = count ? 1.0f - DOUBT * apart / (spread + 3.0f * FAINT * count) : 1.0f;
}

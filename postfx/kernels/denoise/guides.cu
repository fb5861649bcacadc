// The nearest guide pixel at each corner of a render pixel, as the network sees these: guide_diffuse_albedo,
// guide_specular_albedo and guide_normal (height, width, 3), guide_roughness and guide_depth (height, width, 1),
// depth_scale (1,), window (8,), seen_rows (hp,), seen_columns (wp,)
// -> guides (1, 44, hp, wp), 11 channels a corner.
extern "C" __global__ void denoise_guides(View guide_diffuse_albedo, View guide_specular_albedo, View guide_normal,
                                          View guide_roughness, View guide_depth, View depth_scale, View window,
                                          View seen_rows, View seen_columns, View guides) {
    const int height = guides.size[2], width = guides.size[3];
    PIXEL(width, height);
    const Window part = window_of(window);
    const unsigned h = part.h, w = part.w, out_height = part.height, out_width = part.width;
    // In quarters of a render pixel.
    const unsigned row = 4 * (part.top + int(seen_rows.at[y])) + 1;
    const unsigned column = 4 * (part.left + int(seen_columns.at[x])) + 1;
    const size_t plane = size_t(height) * width;
    const float scale = depth_scale.at[0];
    float* to = guides.at + size_t(y) * width + x;
#pragma unroll
    for (int corner = 0; corner < 4; corner++, to += 11 * plane) {
        const unsigned v = (row + 2 * (corner / 2)) * out_height / (4 * h);
        const unsigned u = (column + 2 * (corner % 2)) * out_width / (4 * w);
        const size_t pixel = size_t(v) * out_width + u;
        const float* diffuse = guide_diffuse_albedo.at + 3 * pixel;
        const float* specular = guide_specular_albedo.at + 3 * pixel;
        const float* normal = guide_normal.at + 3 * pixel;
        const float d0 = diffuse[0], d1 = diffuse[1], d2 = diffuse[2];
        const float s0 = specular[0], s1 = specular[1], s2 = specular[2];
        const float n0 = normal[0], n1 = normal[1], n2 = normal[2];
        const float rough = guide_roughness.at[pixel], z = guide_depth.at[pixel];
        to[0] = clamped(d0, 0.0f, 2.0f);
        to[plane] = clamped(d1, 0.0f, 2.0f);
        to[2 * plane] = clamped(d2, 0.0f, 2.0f);
        to[3 * plane] = clamped(s0, 0.0f, 2.0f);
        to[4 * plane] = clamped(s1, 0.0f, 2.0f);
        to[5 * plane] = clamped(s2, 0.0f, 2.0f);
        to[6 * plane] = clamped(n0, -1.0f, 1.0f);
        to[7 * plane] = clamped(n1, -1.0f, 1.0f);
        to[8 * plane] = clamped(n2, -1.0f, 1.0f);
        to[9 * plane] = clamped(rough, 0.0f, 1.0f);
        to[10 * plane] = scale / (scale + clamped(z, 0.0f, MAX_DEPTH));
    }
}

// How far the guides' reflectance is trusted, in cells of 8x8 render pixels: less, the more of its detail is apart from
// the reflectance of the render size. diffuse_albedo and specular_albedo (h, w, 3), guide_diffuse_albedo and
// guide_specular_albedo (height, width, 3), window (8,), part_rows (th,), part_columns (tw,) -> trust (cells, cells, 1).

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

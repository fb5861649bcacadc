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

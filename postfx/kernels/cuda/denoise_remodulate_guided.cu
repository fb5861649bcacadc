// Filtered colour, then the same times reflectance, a border of repeated pixels around both: filtered (3, hp, wp),
// diffuse_albedo and specular_albedo (h, w, 3), part_rows (th,), part_columns (tw,)
// -> radiance (6, th + 2, tw + 2), exposed linear.
extern "C" __global__ void denoise_remodulate_guided(View filtered, View diffuse_albedo, View specular_albedo,
                                                     View part_rows, View part_columns, View radiance) {
    const int height = radiance.size[1], width = radiance.size[2];
    PIXEL(width, height);
    const int v = int(part_rows.at[within(y - 1, height - 2)]), u = int(part_columns.at[within(x - 1, width - 2)]);
    const size_t from = size_t(filtered.size[1]) * filtered.size[2];
    const size_t there = size_t(v - int(part_rows.at[0])) * filtered.size[2] + u - int(part_columns.at[0]);
    const Colour factor = demodulation(diffuse_albedo, specular_albedo, v, u);
    const float factors[3] = {factor.r, factor.g, factor.b};
    const size_t plane = size_t(height) * width, here = size_t(y) * width + x;
#pragma unroll
    for (int c = 0; c < 3; c++) {
        const float light = filtered.at[c * from + there];
        radiance.at[c * plane + here] = light;
        radiance.at[(3 + c) * plane + here] = light * factors[c];
    }
}

// The 5x5 kernel of a level: mixed (3 or 4, hp, wp), heads (1, 25 or more, hp, wp), area (2,) -> filtered (3, hp, wp).
extern "C" __global__ void denoise_filter(View mixed, View heads, View area, View filtered) {
    const int height = filtered.size[1], width = filtered.size[2], plane = height * width;
    PIXEL(width, height);
    const int rows = int(area.at[0]), columns = int(area.at[1]), here = y * width + x;
    Colour sum = {0.0f, 0.0f, 0.0f};
    float total = TINY;
    if (y < rows && x < columns) {
        for (int j = 0; j < 5; j++) {
            const int v = y + j - 2;
            if (v < 0 || v >= rows) continue;
            for (int i = 0; i < 5; i++) {
                const int u = x + i - 2;
                if (u < 0 || u >= columns) continue;
                const float weight = heads.at[(5 * j + i) * plane + here];
                const int there = v * width + u;
                total += weight;
                sum.r += weight * mixed.at[there];
                sum.g += weight * mixed.at[plane + there];
                sum.b += weight * mixed.at[2 * plane + there];
            }
        }
    }
    filtered.at[here] = sum.r / total;
    filtered.at[plane + here] = sum.g / total;
    filtered.at[2 * plane + here] = sum.b / total;
}

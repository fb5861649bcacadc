// Cubic resampling: image (h, w, channels), rows (height,), columns (width,) -> output (height, width, channels).
extern "C" __global__ void resample(View image, View rows, View columns, View output) {
    const int width = output.size[1], channels = image.size[2];
    PIXEL(width, output.size[0]);
    resampled(image, channels, cubic(rows.at[y], image.size[0]), cubic(columns.at[x], image.size[1]),
              output.at + (size_t(y) * width + x) * channels);
}

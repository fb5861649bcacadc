// Rows of the reprojected history.
#include "warp.h"

static Status history_rows(Long first, Long last, Picture history, Picture moved,
                           Given<Params> params, Given<Window> window, Places out_rows,
                           Places out_columns, View<float, 3> warped) {
    const Long height = history.size[0], width = 3 * out_columns.size[0];
    const Warper warper(out_columns, *window, moved.size[1], height, history.size[1]);
    if (!warper) return NO_MEMORY;
    Long known = -1;
    for (Long n = first; n < last; n++) {
        const Long y = Long(out_rows.at[n]);
        const Long at = centre_of(y, Long(window->height), height).index - Long(window->top);
        const Long iy = clip(at, moved.size[0]);
        if (known != iy) warper.move(moved(iy));
        known = iy;
        float* out = warped(n);
        warper.find(y);
        warper.warp(history.at, y, out);
        if (params->gain != 1.0f) {
            for (Long i = 0; i + WIDE <= width; i += WIDE) {
                store<Wide>(out + i, rescaled<Wide>(load<Wide>(out + i), params->gain));
            }
            for (Long i = width / WIDE * WIDE; i < width; i++) {
                out[i] = rescaled<float>(out[i], params->gain);
            }
        }
    }
    return DONE;
}
EXPORT(denoise_history, history_rows)

// Mixes a picture with another denoiser's, and brings motion to the output's size: see partner.py.

// A number within 0..1 of a plane, or of one pixel for all.
FN float number_at(const View& plane, int y, int x) {
    const int row = min(y, plane.size[0] - 1), column = min(x, plane.size[1] - 1);
    return clamped(plane.at[size_t(row) * plane.size[1] + column], 0.0f, 1.0f);
}

// Where a pixel was along an axis; -1 if that is outside of the picture or unknown.
FN float place_of(int at, float moved, int size) {
    const float place = float(at) + moved;
    const bool known = fabsf(moved) < MOST_MOVED && place >= 0.0f && place <= float(size - 1);
    return known ? place : -1.0f;
}

// Logarithm of exposed light; that of light below 0 is the negative one. No number counts as 0.
FN float encode(float light) {
    const float size = log1p_of(fminf(fmaxf(0.0f, fabsf(light)), MOST_LIGHT));
    return light > 0.0f ? size : -size;
}

FN float decode(float coded) {
    const float size = expm1_of(fabsf(coded));
    return coded > 0.0f ? size : -size;
}

extern "C" __global__ void mix_partner(View colour, View partner, View history, View motion,
                                       View weight, View strength, View settings, View output) {
    const int height = output.size[0], width = output.size[1];
    PIXEL(width, height);
    const float exposure = settings.at[0],
                acting = clamped(settings.at[3], 0.0f, 1.0f) * number_at(strength, y, x);
    const float share = acting * number_at(weight, y, x),
                most = settings.at[1] * fminf(share, acting - share);
    const int row = min(y, motion.size[0] - 1), column = min(x, motion.size[1] - 1);
    const float* const moved = motion.at + 2 * (size_t(row) * motion.size[1] + column);
    const float at_y = place_of(y, moved[1], height), at_x = place_of(x, moved[0], width);
    const bool known = settings.at[2] > 0.0f && at_y >= 0.0f && at_x >= 0.0f;
    const int top = max(int(at_y), 0), left = max(int(at_x), 0);
    const int below = min(top + 1, height - 1), right = min(left + 1, width - 1);
    const float v = at_y - float(top), u = at_x - float(left);
    for (int c = 0; c < 3; c++) {
        const size_t here = 3 * (size_t(y) * width + x) + c;
        const float light = colour.at[here], own = encode(exposure * light);
        const float apart = encode(exposure * partner.at[here]) - own;
        if ((share == 0.0f || apart == 0.0f) && fabsf(light) <= LARGEST_FLOAT) {
            output.at[here] = light;
            continue;
        }
        float mixed = own + share * apart;
        if (known) {
            const float* const above = history.at + 3 * size_t(top) * width + c;
            const float* const under = history.at + 3 * size_t(below) * width + c;
            const float upper = above[3 * left] + u * (above[3 * right] - above[3 * left]);
            const float lower = under[3 * left] + u * (under[3 * right] - under[3 * left]);
            const float before = encode(exposure * (upper + v * (lower - upper)));
            mixed = fminf(fmaxf(before, mixed - most * fabsf(apart)), mixed + most * fabsf(apart));
        }
        output.at[here] = decode(mixed) / exposure;
    }
}

extern "C" __global__ void enlarge_motion(View motion, View rows, View columns, View ratio,
                                          View enlarged) {
    const int height = enlarged.size[0], width = enlarged.size[1];
    PIXEL(width, height);
    const int row = clip(int(rintf(rows.at[y])), motion.size[0]);
    const int column = clip(int(rintf(columns.at[x])), motion.size[1]);
    for (int c = 0; c < 2; c++) {
        const float moved = motion.at[2 * (size_t(row) * motion.size[1] + column) + c];
        const bool is_possible = fabsf(moved) < MOST_MOVED;
        enlarged.at[2 * (size_t(y) * width + x) + c] = is_possible ? moved * ratio.at[c]
                                                                   : MOST_MOVED;
    }
}

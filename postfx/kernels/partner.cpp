// Rows that mix a picture with another denoiser's; `partner.py` says how.
#include "rows.h"

constexpr float MOST_LIGHT = 1e30f;
constexpr float MOST_MOVED = 1 << 24;
enum Settings { EXPOSURE, REACH, KEEP, STRENGTH };

// Logarithm of exposed light; that of light below 0 is the negative one. No number counts as 0.
template <class F> FN F encode(F light) {
    const F size = smaller<F>(larger<F>(size_of<F>(light), 0.0f), MOST_LIGHT);
    const F found = log1p_of<F>(size);
    return light > 0.0f ? found : -found;
}
template <class F> FN F decode(F coded) {
    const F size = expm1_of<F>(size_of<F>(coded));
    return coded > 0.0f ? size : -size;
}

// Numbers of a plane, or of one pixel for all.
template <class F, int STEP> FN F number_at(const Picture& plane, Long y, Long x, int channel) {
    const float* row = plane(y < plane.size[0] ? y : plane.size[0] - 1) + channel;
    return plane.size[1] == 1 ? F(*row) : pick<F, STEP>(row + STEP * x);
}

// Where pixels were along an axis; -1 if that is outside of the picture or unknown.
template <class F> FN F place_of(F at, F moved, Long size) {
    const F place = at + moved, none = -1.0f;
    const F after = place >= 0.0f ? place : none;
    const F inside = after <= float(size - 1) ? after : none;
    return size_of<F>(moved) < MOST_MOVED ? inside : none;
}

// The picture before, moved along the motion.
template <class F> struct Before {
    int corners[4][Of<F>::COUNT];
    F down, across;

    FN_MEMBER Before(const Picture& history, F y, F x) {
        typedef typename Of<F>::Int I;
        const int h = int(history.size[0]), w = int(history.size[1]);
        const I top = whole(larger<F>(y, 0.0f)), left = whole(larger<F>(x, 0.0f));
        const I below = top + 1 < h ? top + 1 : I(h - 1);
        const I right = left + 1 < w ? left + 1 : I(w - 1);
        store_int<F>(corners[0], top * w + left);
        store_int<F>(corners[1], top * w + right);
        store_int<F>(corners[2], below * w + left);
        store_int<F>(corners[3], below * w + right);
        down = y - number(top);
        across = x - number(left);
    }
    FN_MEMBER F at(const float* channel) const {
        F near[4];
        for (int i = 0; i < 4; i++) near[i] = gather<F, 3>(channel, corners[i]);
        const F upper = near[0] + across * (near[1] - near[0]);
        const F lower = near[2] + across * (near[3] - near[2]);
        return upper + down * (lower - upper);
    }
};

static void mix_rows(Long first, Long last, Picture colour, Picture partner, Picture history,
                     Picture motion, Picture weight, Picture strength,
                     View<const float, 1> settings, NewPicture output) {
    const Long height = output.size[0], width = output.size[1];
    const float exposure = settings.at[EXPOSURE], reach = settings.at[REACH];
    const bool keep = settings.at[KEEP] > 0.0f;
    const float all = within<float>(settings.at[STRENGTH], 0.0f, 1.0f);
    for (Long y = first; y < last; y++) {
        const float *own_row = colour(y), *other_row = partner(y);
        float* out = output(y);
        across(0, width, EACH(F, Long x) {
            const F acting = all * within<F>(number_at<F, 1>(strength, y, x, 0), 0.0f, 1.0f);
            const F share = acting * within<F>(number_at<F, 1>(weight, y, x, 0), 0.0f, 1.0f);
            const F most = reach * smaller<F>(share, acting - share);
            const F at_y = place_of<F>(float(y), number_at<F, 2>(motion, y, x, 1), height);
            const F at_x = place_of<F>(ramp<F>(float(x), 1.0f), number_at<F, 2>(motion, y, x, 0),
                                       width);
            const Before<F> before(history, at_y, at_x);
            F mixed[3];
            for (int c = 0; c < 3; c++) {
                const F given = pick<F, 3>(own_row + 3 * x + c);
                const F own = encode<F>(exposure * given);
                const F apart = encode<F>(exposure * pick<F, 3>(other_row + 3 * x + c)) - own;
                F found = own + share * apart;
                if (keep) {
                    const F past = encode<F>(exposure * before.at(history.at + c));
                    const F wide = most * size_of<F>(apart);
                    const F held = smaller<F>(larger<F>(past, found - wide), found + wide);
                    const F beside = at_x >= 0.0f ? held : found;
                    found = at_y >= 0.0f ? beside : found;
                }
                const F light = decode<F>(found) / exposure;
                const F differs = apart == 0.0f ? F(0.0f) : share;
                const F alone = differs == 0.0f ? given : light;
                mixed[c] = size_of<F>(given) < __builtin_inff() ? alone : light;
            }
            store_triples<F>(out + 3 * x, mixed[0], mixed[1], mixed[2]);
        });
    }
}
EXPORT(mix_partner, mix_rows)

// Motion of the nearest render pixel, in pixels of the output.
static Status enlarge_motion_rows(Long first, Long last, Picture motion, Places rows,
                                  Places columns, View<const float, 1> ratio,
                                  NewPicture enlarged) {
    const Long h = motion.size[0], w = motion.size[1], width = columns.size[0];
    const Room<int> nearest(width);
    if (!nearest) return NO_MEMORY;
    for (Long x = 0; x < width; x++) nearest.at[x] = clip(Long(nearest_of(columns.at[x])), w);
    for (Long y = first; y < last; y++) {
        const float* from = motion(clip(Long(nearest_of(rows.at[y])), h));
        float* out = enlarged(y);
        across(0, width, EACH(F, Long x) {
            F moved[2];
            for (int c = 0; c < 2; c++) {
                const F found = gather<F, 2>(from + c, nearest.at + x);
                moved[c] = size_of<F>(found) < MOST_MOVED ? found * ratio.at[c] : F(MOST_MOVED);
            }
            store_pairs<F>(out + 2 * x, moved[0], moved[1]);
        });
    }
    return DONE;
}
EXPORT(enlarge_motion, enlarge_motion_rows)

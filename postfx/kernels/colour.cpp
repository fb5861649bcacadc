// Rows of colour.
#include "colour.h"
#include "views.h"

static Status apply_cube_rows(Long first, Long last, Picture colour, Given<Shaping> params,
                              Given<Matrix> matrix, Cube cube, NewPicture output) {
    const Long width = colour.size[1];
    const Shaper shaper(*params, *matrix);
    const LookUp cubes(cube, width);
    if (!cubes) return NO_MEMORY;
    for (Long y = first; y < last; y++) {
        const float* from = colour(y);
        across(0, width, EACH(F, Long x) {
            cubes.find<F>(shaper.shape<F>(colour_at<F>(from + 3 * x)), x);
        });
        cubes.put(output(y));
    }
    return DONE;
}
EXPORT(apply_cube, apply_cube_rows)

// Rows in which each colour is changed by itself.
template <class Change>
FN void each_colour(Long first, Long last, const Picture& colour, const NewPicture& output,
                    const Change& change) {
    for (Long y = first; y < last; y++) {
        const float* from = colour(y);
        float* out = output(y);
        across(0, colour.size[1], EACH(F, Long x) {
            store_colour<F>(out + 3 * x, change(F(), colour_at<F>(from + 3 * x)));
        });
    }
}

// A display's code values.

struct Display {
    Matrix matrix;
    float codes, most, exponent;  // whether colour is code values; light that clips; of luminance
};

// A table between its entries, at a place in [0, STEPS].
template <class F> FN F looked_up(const float* table, F place) {
    int places[Of<F>::COUNT];
    const typename Of<F>::Int at = whole(place);
    store_int<F>(places, at);
    const F low = gather<F>(table, places);
    return low + (place - number(at)) * (gather<F>(table + 1, places) - low);
}

template <class F> FN F decoded(F code, const float* table) {
    return looked_up<F>(table, within<F>(code, 0.0f, 1.0f) * float(STEPS));
}
template <class F> FN F encoded(F light, float most, F gain, const float* table) {
    const F unit = smaller<F>(within<F>(light, 0.0f, most) * gain, F(1.0f));
    return looked_up<F>(table, root_of(root_of(root_of(unit))) * float(STEPS));
}

static void encode_display_rows(Long first, Long last, Picture colour, Given<Display> params,
                                View<const float, 1> decode, View<const float, 1> encode,
                                NewPicture output) {
    const float most = params->most, exponent = params->exponent;
    each_colour(first, last, colour, output, EACH(F, const Colour<F>& given) {
        Colour<F> seen = finite<F>(given);
        if (params->codes > 0.0f) {
            seen = {decoded<F>(seen.r, decode.at), decoded<F>(seen.g, decode.at),
                    decoded<F>(seen.b, decode.at)};
        }
        const Colour<F> light = params->matrix.apply<F>(seen);
        F gain = F(1.0f);
        if (exponent != 0.0f) {
            const F luminance = RED * within<F>(light.r, 0.0f, most)
                              + GREEN * within<F>(light.g, 0.0f, most)
                              + BLUE * within<F>(light.b, 0.0f, most);
            const F power = exponent * log_of<F>(larger<F>(luminance, F(DARK)));
            gain = exp_of<F>(within<F>(power, -80.0f, 80.0f));
        }
        return Colour<F>{encoded<F>(light.r, most, gain, encode.at),
                         encoded<F>(light.g, most, gain, encode.at),
                         encoded<F>(light.b, most, gain, encode.at)};
    });
}
EXPORT(encode_display, encode_display_rows)

// Views that are formulas.
template <class Formula>
static void show_rows(Long first, Long last, Picture colour, Given<Showing> params,
                      NewPicture output) {
    each_colour(first, last, colour, output, EACH(F, const Colour<F>& given) {
        const Colour<F> light = finite<F>(given);
        const Shown<F> shown = show_light<Formula, F>(*params, light.r, light.g, light.b);
        return Colour<F>{shown.r, shown.g, shown.b};
    });
}
EXPORT(show_neutral, show_rows<Neutral>)
EXPORT(show_reinhard, show_rows<Reinhard>)

// A matrix alone.
static void convert_primaries_rows(Long first, Long last, Picture colour, Given<Matrix> matrix,
                                   NewPicture output) {
    each_colour(first, last, colour, output, EACH(F, const Colour<F>& given) {
        return matrix->apply<F>(given);
    });
}
EXPORT(convert_primaries, convert_primaries_rows)

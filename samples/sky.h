// The kernels of sky.py on a CPU: the sky of Preetham, Shirley and Smits (1999), and irradiance
// under it by Monte Carlo.
#include "rows.h"

constexpr float PI = 3.14159265f;
constexpr float SCALE = 0.1f;   // of kcd/m2
constexpr float GROUND = 0.3f;  // of the sky's light, below the horizon
constexpr double LATTICE[2] = {0.7548776662466927, 0.5698402909980532};  // R2, Roberts 2018

extern "C" double sin(double), cos(double), log(double);

struct Sky {
    float perez[3][6];  // A to E and the scale, of Y, x and y
    float sun[3];
};

template <class F> struct Light {
    F red, green, blue;
};

// Error below 1e-6: Abramowitz and Stegun (1964), 4.4.46.
template <class F> FN F arc_cosine(F cosine) {
    const F x = size_of<F>(cosine);
    F p = x * -0.0012624911f + 0.0066700901f;
    p = p * x - 0.0170881256f;
    p = p * x + 0.0308918810f;
    p = p * x - 0.0501743046f;
    p = p * x + 0.0889789874f;
    p = p * x - 0.2145988016f;
    p = p * x + 1.5707963050f;
    const F angle = p * root_of(1.0f - x);
    return cosine < 0.0f ? PI - angle : angle;
}

template <class F> FN F perez(const float (&of)[6], F up, F angle, F cosine) {
    const F towards_zenith = 1.0f + of[0] * exp_of<F>(of[1] / up);
    return of[5] * towards_zenith
           * (1.0f + of[2] * exp_of<F>(of[3] * angle) + of[4] * cosine * cosine);
}

// Colour of the sky in a direction, in tenths of kcd/m2.
template <class F> FN Light<F> radiance(const Sky& sky, F x, F y, F z) {
    const F up = larger<F>(size_of<F>(y), F(0.02f));
    const F cosine = within<F>(x * sky.sun[0] + y * sky.sun[1] + z * sky.sun[2], -1.0f, 1.0f);
    const F angle = arc_cosine<F>(cosine);
    const F cx = perez<F>(sky.perez[1], up, angle, cosine);
    const F cy = perez<F>(sky.perez[2], up, angle, cosine);
    const F share = within<F>((y + 0.1f) * 5.0f, 0.0f, 1.0f);
    const F above = GROUND + (1.0f - GROUND) * share * share * (3.0f - 2.0f * share);
    const F bright = perez<F>(sky.perez[0], up, angle, cosine) * SCALE * above;
    const F wide = bright * cx / cy, deep = bright * (1.0f - cx - cy) / cy;
    const F none = F(0.0f);
    return {larger<F>(3.2406f * wide - 1.5372f * bright - 0.4986f * deep, none),
            larger<F>(-0.9689f * wide + 1.8758f * bright + 0.0415f * deep, none),
            larger<F>(0.0557f * wide - 0.2040f * bright + 1.0570f * deep, none)};
}

// log(1 + colour) of the sky.
static void sky_rows(Long first, Long last, Given<Sky> sky, View<const float, 2> directions,
                     View<float, 2> logs) {
    across(first, last, EACH(F, Long p) {
        const float* at = directions(p);
        const Light<F> found =
            radiance<F>(*sky, pick<F, 3>(at), pick<F, 3>(at + 1), pick<F, 3>(at + 2));
        store_triples<F>(logs(p), log1p_of<F>(found.red), log1p_of<F>(found.green),
                         log1p_of<F>(found.blue));
    });
}
EXPORT(sample_sky, sky_rows)

// PCG (Jarzynski and Olano 2020).
static unsigned hash_of(unsigned number) {
    const unsigned state = number * 747796405u + 2891336453u;
    const unsigned word = ((state >> ((state >> 28) + 4)) ^ state) * 277803737u;
    return (word >> 22) ^ word;
}

static double fraction_of(double x) { return x - __builtin_floor(x); }

struct Drawn {
    float samples, seed;
};

// log(irradiance) by cosine-weighted samples; a normal of length 0 is empty: NaN.
static void irradiance_rows(Long first, Long last, Given<Sky> sky, View<const float, 2> normals,
                            Given<Drawn> params, View<float, 2> logs) {
    const int samples = int(params->samples);
    for (Long p = first; p < last; p++) {
        const float* n = normals(p);
        float* out = logs(p);
        if (n[0] == 0 && n[1] == 0 && n[2] == 0) {
            out[0] = out[1] = out[2] = __builtin_nanf("");
            continue;
        }
        // a frame around the normal: Duff 2017
        const double sign = n[2] >= 0 ? 1.0 : -1.0, a = -1 / (sign + n[2]), b = n[0] * n[1] * a;
        const unsigned state = hash_of(unsigned(p) + hash_of(unsigned(params->seed)));
        const double turn = hash_of(state) / 4294967296.0;
        const double shift = hash_of(state + 1) / 4294967296.0;
        double sums[3] = {};
        for (int s = 0; s < samples; s++) {  // a lattice, shifted from pixel to pixel
            const double u = fraction_of(turn + s * LATTICE[0]);
            const double angle = 2 * double(PI) * fraction_of(shift + s * LATTICE[1]);
            const double i = __builtin_sqrt(u) * cos(angle), j = __builtin_sqrt(u) * sin(angle);
            const double height = __builtin_sqrt(1 - u);
            const double x = i * (1 + sign * n[0] * n[0] * a) + j * b + height * n[0];
            const double y = i * sign * b + j * (sign + n[1] * n[1] * a) + height * n[1];
            const double z = -i * sign * n[0] - j * n[1] + height * n[2];
            const Light<float> light = radiance<float>(*sky, float(x), float(y), float(z));
            sums[0] += light.red;
            sums[1] += light.green;
            sums[2] += light.blue;
        }
        for (int c = 0; c < 3; c++) out[c] = float(log(double(PI) / samples * sums[c]));
    }
}
EXPORT(sample_irradiance, irradiance_rows)

// Light of a pixel without its reflectance.
#pragma once
#include "../number.h"
#include "denoise.h"

// Reflectance that colour is divided by, of the sum of both albedos.
template <class F> struct Tint {
    F red, green, blue;
};
template <class F> FN Tint<F> tinted(F red, F green, F blue) {
    const F r = within<F>(red, 0.0f, MOST_REFLECTANCE);
    const F g = within<F>(green, 0.0f, MOST_REFLECTANCE);
    const F b = within<F>(blue, 0.0f, MOST_REFLECTANCE);
    const F peak = larger<F>(larger<F>(r, g), b), least = LEAST_TINT * peak, one = F(1.0f);
    return {peak < EMITTER ? one : larger<F>(r, least) + ADDED,
            peak < EMITTER ? one : larger<F>(g, least) + ADDED,
            peak < EMITTER ? one : larger<F>(b, least) + ADDED};
}

// This frame's light without reflectance; a pixel that is too bright keeps its hue.
template <class F> struct Light {
    F rgb[3];
};
template <class F> FN Light<F> light_of(const F (&colour)[3], const F (&reflectance)[3],
                                        float exposure) {
    Light<F> light;
    F brightest = F(MAX_COLOUR);
    for (int c = 0; c < 3; c++) {
        const F exposed = within<F>(colour[c], 0.0f, MAX_FLOAT) * exposure;
        light.rgb[c] = smaller<F>(exposed / reflectance[c], F(MAX_LIGHT));
        brightest = larger<F>(light.rgb[c], brightest);
    }
    for (int c = 0; c < 3; c++) light.rgb[c] *= MAX_COLOUR / brightest;
    return light;
}

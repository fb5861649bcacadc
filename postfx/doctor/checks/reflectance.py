"""Albedos and roughness."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from postfx.colour.primaries import luminance
from postfx.doctor.findings import Finding, error, info, warning
from postfx.doctor.material import Material
from postfx.doctor.roughness import fit_roughness
from postfx.doctor.statistics import correlation, finite, noise_level, percent
from postfx.frame import Frame, Role
from postfx.sampling import local_mean

ALBEDOS = (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
NOISY = 0.012
MOST_ABOVE = 5.0  # percent of the pixels
BRIGHT = 0.5
SAME_NOISE = 0.5


def albedo_above_one(material: Material) -> Iterator[Finding]:
    """Reflectance above 1: more light than came in."""
    for role in ALBEDOS:
        if role not in material.middle:
            continue
        plane = finite(material.middle[role]).max(2)
        share = percent(plane > 1.001)
        if share > 0:
            evidence = f"{share:.3g} % of the pixels above 1, largest {plane.max():.3g}"
            cause = "a light or a reflection seen in the plane, lit colour instead of reflectance, or a scale"
            mend = "write reflectance without light; values above 1 are cut off"
            level = error if share > MOST_ABOVE else warning if share > 0.1 else info
            yield level(role, "albedo-above-one", evidence, cause, mend)


def albedo_noisy(material: Material) -> Iterator[Finding]:
    """Noise in flat areas of an albedo."""
    for role in ALBEDOS:
        if role not in material.middle:
            continue
        plane = np.clip(finite(material.middle[role]), 0, 4)
        level = noise_level(plane)
        used = plane.max(2) > 0
        if level is None or level < NOISY or level < 0.02 * float(plane[used].mean()):
            continue
        shared = _shared_noise(material.middle, plane)
        evidence = f"noise of {level:.3g} in the flattest quarter of the picture, mean {plane[used].mean():.3g}; "
        evidence += f"{shared:.2f} correlated with the colour's noise"
        lit = shared > SAME_NOISE
        cause = "the plane holds lit colour" if lit else "depth of field, motion blur or rough layers in the plane"
        mend = "write reflectance without light" if lit else "write it at the first hit, or with more samples"
        yield warning(role, "albedo-is-lit" if lit else "albedo-noisy", evidence, cause, mend)


def _shared_noise(frame: Frame, albedo: np.ndarray) -> float:
    if Role.COLOUR not in frame:
        return 0.0
    light, reflected = (np.log(luminance(np.maximum(finite(plane), 0)) + 1e-2)[..., None]
                        for plane in (frame[Role.COLOUR], albedo))
    return correlation(light - local_mean(light, 2), reflected - local_mean(reflected, 2))


def bright_metal(material: Material) -> Iterator[Finding]:
    """Diffuse and specular albedo bright in the same pixels: together they would reflect more than they get."""
    if not all(role in material.middle for role in ALBEDOS):
        return
    diffuse, specular = (finite(material.middle[role]) for role in ALBEDOS)
    metal = specular.max(2) > BRIGHT
    bright = metal & ((diffuse + specular).max(2) > 1.05)
    share, of_metal = percent(bright), 100 * bright.sum() / max(metal.sum(), 1)
    if share > 0.05 and of_metal > 30:
        evidence = (f"{share:.3g} % of the pixels ({of_metal:.0f} % of those with specular albedo above {BRIGHT}) "
                    f"reflect more than 1.05 in sum, {(diffuse + specular).max(2)[bright].mean():.3g} in the mean")
        yield warning(Role.DIFFUSE_ALBEDO, "metal-diffuse-bright", evidence, "base colour written as diffuse albedo of "
                      "metals too", "diffuse albedo = base colour x (1 - metallic); metals' colour is specular albedo")


def roughness_range(material: Material) -> Iterator[Finding]:
    """Roughness above 1."""
    if Role.ROUGHNESS in material.middle:
        plane = finite(material.middle[Role.ROUGHNESS])
        if (share := percent(plane > 1.001)) > 0.1:
            yield error(Role.ROUGHNESS, "roughness-range", f"{share:.3g} % above 1, largest {plane.max():.3g}",
                        "a gloss exponent or 0..255", "write linear roughness 0..1, or scale it in a profile")


def roughness_kind(material: Material) -> Iterator[Finding]:
    """Squared roughness, its root, or smoothness, by what specular albedo says."""
    frame = material.middle
    if Role.ROUGHNESS not in frame:
        return
    fit = fit_roughness(frame)
    if fit is None or not fit.is_telling:
        yield info(Role.ROUGHNESS, "roughness-untested", "whether roughness is linear, squared or smoothness cannot be "
                   "told", "it needs specular albedo that depends on roughness and view angle, depth and fov_x, and "
                   "smooth surfaces", "look at its picture (--pictures): mirrors are black, plaster is white")
        return
    kind, certain = fit.best, fit.certainty
    if kind.code and certain > 0:
        evidence = (f"specular albedo is explained with an error of {fit.errors[kind]:.3g} if the plane is "
                    f"{kind.name}, of {fit.as_it_is:.3g} as linear roughness ({fit.pixels} pixels); "
                    f"certainty {certain:.0%}")
        yield (error if certain >= 0.5 else warning)(Role.ROUGHNESS, kind.code, evidence, kind.cause, kind.mend)

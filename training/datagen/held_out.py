"""Views of procedural scenes that no training clip shows. Import after Mitsuba's variant is set."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from training.datagen.clip import other_path
from training.datagen.scenes.build import BuiltScene, Description
from training.datagen.scenes.draft import Draft, Probe, choose_path, probe
from training.datagen.scenes.lights import Environments
from training.datagen.scenes.motion import CameraPath, Cut
from training.datagen.scenes.procedural import draft
from training.datagen.tracing import Film, Tracer

# Traits of a view ---------------------------------------------------------------------------------
# Traits that a held-out view can be asked to show, and tests for them. Import after Mitsuba's
# variant is set.

Planes = dict[str, np.ndarray]
# points a side that are examined, and the width of an image in whose pixels motion is counted
GRID, UNIT = 64, 256
SHARE = 0.03  # a trait takes at least this part of the view
# a view that shows enough has at least this part of edges, and at most this part of darkness
EDGES, DARK = 0.15, 0.2
FLICKER = 1.15  # least quotient of brightest and darkest frame


@dataclass(frozen=True)
class Trait:
    """`has`: whether a scene may show the trait; `shows`: which of the first hits (N, C planes)
    do."""

    has: Callable[[Description], bool]
    shows: Callable[[Planes], np.ndarray] | None = None


def _moves(planes: Planes) -> np.ndarray:
    return np.linalg.norm(planes["motion"], axis=-1) > 0.3


def _metal(planes: Planes) -> np.ndarray:
    bright = planes["specular_albedo"].max(-1) > 0.35
    return bright & (planes["diffuse_albedo"].max(-1) < 0.02) & (planes["roughness"] < 0.75)


def _glass(planes: Planes) -> np.ndarray:
    clear = (planes["diffuse_albedo"].max(-1) == 0) & (planes["roughness"] == 0)
    return clear & (planes["specular_albedo"].min(-1) > 0) & (planes["specular_albedo"].max(-1)
                                                              < 0.3)


def _is_of(*kinds: str) -> Callable[[Description], bool]:
    return lambda description: any(material.kind in kinds for material in description.materials)


TRAITS = {
    "moving": Trait(lambda d: bool(d.movers), _moves),
    "bending": Trait(lambda d: bool(d.bends), _moves),
    "metal": Trait(_is_of("conductor", "roughconductor"), _metal),
    "glass": Trait(_is_of("dielectric"), _glass),
    "flicker": Trait(lambda d: bool(d.glows)),
}


def shows_enough(look: Probe) -> bool:
    """Whether a view has enough edges to tell methods apart, and is not mostly dark."""
    return look.edges() >= EDGES and (look.luminance < 0.003 * look.luminance.mean()).mean() <= DARK


def shows(tracer: Tracer, built: BuiltScene, path: CameraPath, trait: str, frames: int,
          seed: int) -> bool:
    """Whether a view shows a trait: in its middle frame or, for a flickering light, by the frames'
    brightness."""
    middle = frames // 2
    if trait == "flicker":
        return _flickers(tracer, built, path, frames, seed)
    built.move(middle, middle - 1)
    camera, centres = path.at(middle), (np.arange(GRID, dtype=np.float32) + 0.5) / GRID
    u, v = (mi.Float(axis.ravel()) for axis in np.meshgrid(centres, centres))
    planes = tracer.planes(built, camera, camera, (UNIT, UNIT), Film(u, v))
    hits = TRAITS[trait].shows
    assert hits is not None, "but flicker, all are seen in one frame"
    return bool(hits(planes).mean() >= SHARE)


def _flickers(tracer: Tracer, built: BuiltScene, path: CameraPath, frames: int, seed: int) -> bool:
    """Whether the light flickers: compares the two frames that differ most, from one place."""
    strengths = np.array([[glow(t) for glow in built.description.glows] for t in range(frames)])
    light = max(range(strengths.shape[1]), key=lambda k: np.ptp(strengths[:, k]))
    levels = []
    for frame in (int(strengths[:, light].argmin()), int(strengths[:, light].argmax())):
        built.move(frame, frame - 1)
        levels.append(probe(tracer, built, path.at(frames // 2), seed).level())
    return levels[1] > FLICKER * levels[0]


# Held-out views -----------------------------------------------------------------------------------

FIRST_SEED = 9000
"""Clips for training are drawn with seeds below 1000; from here on everything is for validation."""


@dataclass(frozen=True)
class Kind:
    """A wanted view: its family, the trait that its frames must show, and the frame of a cut.

    Families are 'interior', 'room', 'product' and 'outdoor'.
    """

    family: str | None = None
    trait: str | None = None
    cut: int | None = None
    frames: int = 8


@dataclass(frozen=True)
class HeldOut:
    """A scene, its camera path, a gain that gives its frames a sensible brightness, and how noisy
    it is.

    `samples` a pixel bring a reference to the requested error.
    """

    name: str
    built: BuiltScene
    path: CameraPath | Cut
    gain: float
    samples: float
    rng: np.random.Generator


def held_out_view(tracer: Tracer, seed: int, width: int, error: float, most_samples: float,
                  kind: Kind | None = None) -> HeldOut:
    """The view of a seed; the same for the same arguments.

    Skips views whose references would need more than `most_samples` samples a pixel for a root mean
    square error of `error` after x/(1+x). `width` of the noisy frames sets the speed of the camera.
    Raises ValueError for a seed that training may use.
    """
    if seed < FIRST_SEED:
        raise ValueError(f"seed {seed} may be a training clip's: take one from {FIRST_SEED} on")
    rng, maps, kind = np.random.default_rng([seed, 0]), Environments(None), kind or Kind()
    while True:
        drafted = draft(rng, maps)
        view = _view(tracer, drafted, rng, width, error, kind) if _fits(drafted, kind) else None
        if view and view.samples <= most_samples:
            return view
        del view
        gc.collect()


def _fits(drafted: Draft, kind: Kind) -> bool:
    d = drafted.description
    return kind.family in (None, d.name) and (kind.trait is None or TRAITS[kind.trait].has(d))


def _view(tracer: Tracer, drafted: Draft, rng: np.random.Generator, width: int, error: float,
          kind: Kind) -> HeldOut | None:
    """A view of a scene; None if none is usable."""
    built = BuiltScene(drafted.description)
    built.move(3.5, 2.5)
    chosen = choose_path(tracer, built, drafted.view, rng, width, drafted.near)
    if chosen is None or not shows_enough(chosen[2]):
        return None
    path: CameraPath | Cut
    path, gain, look = chosen
    if kind.trait and not shows(tracer, built, path, kind.trait, kind.frames,
                                int(rng.integers(1 << 31))):
        return None
    samples = look.samples_for(error, gain)
    if kind.cut is not None:
        other = other_path(tracer, built, drafted, rng, width, gain)
        if other is None or not shows_enough(other[1]):
            return None
        path = Cut(path, other[0], kind.cut)
        samples = max(samples, other[1].samples_for(error, gain))
    return HeldOut(drafted.description.name, built, path, gain, samples, rng)

"""Views of procedural scenes that no training clip shows. Import after Mitsuba's variant is set."""

from __future__ import annotations

import gc
from dataclasses import dataclass

import numpy as np

from training.factory import other_path
from training.scenes.build import BuiltScene
from training.scenes.draft import Draft
from training.scenes.lights import Environments
from training.scenes.motion import CameraPath, Cut
from training.scenes.procedural import draft
from training.scenes.views import choose_path
from training.tracing import Tracer
from training.traits import TRAITS, shows, shows_enough

FIRST_SEED = 9000
"""Clips for training are drawn with seeds below 1000; from here on everything is for validation."""


@dataclass(frozen=True)
class Kind:
    """What a view is to be: of a family, showing one of TRAITS within its frames, and cut at one of them.

    Families are 'interior', 'room', 'product' and 'outdoor'.
    """

    family: str | None = None
    trait: str | None = None
    cut: int | None = None
    frames: int = 8


@dataclass(frozen=True)
class HeldOut:
    """A scene, the path of its camera, the gain that gives its frames a sensible brightness, and how noisy they are.

    `samples` a pixel bring a reference to the error that was asked for.
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

    Views are passed over whose references would need more than `most_samples` samples a pixel for a root mean square
    error of `error` after x/(1+x). `width` of the noisy frames sets the speed of the camera. Raises ValueError for a
    seed that training may use.
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
    """A view of a scene; None where none is of use."""
    built = BuiltScene(drafted.description)
    built.move(3.5, 2.5)
    chosen = choose_path(tracer, built, drafted.view, rng, width, drafted.near)
    if chosen is None or not shows_enough(chosen[2]):
        return None
    path, gain, look = chosen
    if kind.trait and not shows(tracer, built, path, kind.trait, kind.frames, int(rng.integers(1 << 31))):
        return None
    samples = look.samples_for(error, gain)
    if kind.cut is not None:
        other = other_path(tracer, built, drafted, rng, width, gain)
        if other is None or not shows_enough(other[1]):
            return None
        path, samples = Cut(path, other[0], kind.cut), max(samples, other[1].samples_for(error, gain))
    return HeldOut(drafted.description.name, built, path, gain, samples, rng)

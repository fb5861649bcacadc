"""Views of procedural scenes that no training clip shows. Import after Mitsuba's variant is set."""

from __future__ import annotations

import gc
from dataclasses import dataclass

import numpy as np

from training.scenes.build import BuiltScene
from training.scenes.lights import Environments
from training.scenes.motion import CameraPath
from training.scenes.procedural import draft
from training.scenes.views import choose_path
from training.tracing import Tracer

FIRST_SEED = 9000
"""Clips for training are drawn with seeds below 1000; from here on everything is for validation."""


@dataclass(frozen=True)
class HeldOut:
    """A scene, the path of its camera, the gain that gives its frames a sensible brightness, and how noisy they are.

    `samples` a pixel bring a reference to the error that was asked for.
    """

    name: str
    built: BuiltScene
    path: CameraPath
    gain: float
    samples: float
    rng: np.random.Generator


def held_out_view(tracer: Tracer, seed: int, width: int, error: float, most_samples: float,
                  family: str | None = None) -> HeldOut:
    """The view of a seed; the same for the same arguments.

    Views are passed over whose references would need more than `most_samples` samples a pixel for a root mean square
    error of `error` after x/(1+x). `width` of the noisy frames sets the speed of the camera. `family` keeps to scenes
    of a name ('room', 'product', 'outdoor'). Raises ValueError for a seed that training may use.
    """
    if seed < FIRST_SEED:
        raise ValueError(f"seed {seed} may be a training clip's: take one from {FIRST_SEED} on")
    rng, maps = np.random.default_rng([seed, 0]), Environments(None)
    while True:
        drafted = draft(rng, maps)
        if family not in (None, drafted.description.name):
            continue
        built = BuiltScene(drafted.description)
        built.move(3.5, 2.5)
        chosen = choose_path(tracer, built, drafted.view, rng, width, drafted.near)
        samples = chosen[2].samples_for(error, chosen[1]) if chosen else np.inf
        if samples <= most_samples:
            return HeldOut(drafted.description.name, built, chosen[0], chosen[1], samples, rng)
        del built
        gc.collect()

"""What a held-out view is to show, and whether it does. Import after Mitsuba's variant is set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from training.scenes.build import BuiltScene, Description
from training.scenes.motion import CameraPath
from training.scenes.views import Probe, probe
from training.tracing import Film, Tracer

Planes = dict[str, np.ndarray]
GRID, UNIT = 64, 256  # points a side that are looked at, and the width of an image whose pixels motion counts
SHARE = 0.03  # of the view, at least, that a trait takes
EDGES, DARK = 0.15, 0.2  # least part of edges and most of darkness in a view that shows enough
FLICKER = 1.15  # least quotient of brightest and darkest frame


@dataclass(frozen=True)
class Trait:
    """`has` tells whether a scene may show it, `shows` which of the first hits (N, C planes) do."""

    has: Callable[[Description], bool]
    shows: Callable[[Planes], np.ndarray] | None = None


def _moves(planes: Planes) -> np.ndarray:
    return np.linalg.norm(planes["motion"], axis=-1) > 0.3


def _metal(planes: Planes) -> np.ndarray:
    bright = planes["specular_albedo"].max(-1) > 0.35
    return bright & (planes["diffuse_albedo"].max(-1) < 0.02) & (planes["roughness"] < 0.75)


def _glass(planes: Planes) -> np.ndarray:
    clear = (planes["diffuse_albedo"].max(-1) == 0) & (planes["roughness"] == 0)
    return clear & (planes["specular_albedo"].min(-1) > 0) & (planes["specular_albedo"].max(-1) < 0.3)


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
    """Whether a view has edges to tell methods apart by, and is not dark in large parts."""
    return look.edges() >= EDGES and (look.luminance < 0.003 * look.luminance.mean()).mean() <= DARK


def shows(tracer: Tracer, built: BuiltScene, path: CameraPath, trait: str, frames: int, seed: int) -> bool:
    """Whether a trait is seen: in the middle frame, or, of a flickering light, by the level of the frames."""
    middle = frames // 2
    if trait == "flicker":
        return _flickers(tracer, built, path, frames, seed)
    built.move(middle, middle - 1)
    camera, centres = path.at(middle), (np.arange(GRID, dtype=np.float32) + 0.5) / GRID
    u, v = (mi.Float(axis.ravel()) for axis in np.meshgrid(centres, centres))
    planes = tracer.planes(built, camera, camera, (UNIT, UNIT), Film(u, v))
    return TRAITS[trait].shows(planes).mean() >= SHARE


def _flickers(tracer: Tracer, built: BuiltScene, path: CameraPath, frames: int, seed: int) -> bool:
    """By the two frames between which the light changes most, seen from one place."""
    strengths = np.array([[glow(t) for glow in built.description.glows] for t in range(frames)])
    light = max(range(strengths.shape[1]), key=lambda k: np.ptp(strengths[:, k]))
    levels = []
    for frame in (int(strengths[:, light].argmin()), int(strengths[:, light].argmax())):
        built.move(frame, frame - 1)
        levels.append(probe(tracer, built, path.at(frames // 2), seed).level())
    return levels[1] > FLICKER * levels[0]

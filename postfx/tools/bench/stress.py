"""Frames that no renderer should write, to check that the passes' results are finite and in
range."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.models import GUIDED, PASS, UNSCALED, exact, split_ending
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library

Change = Callable[[Frame], Frame]
BRIGHTEST_OUTPUT = 4e4
"""Bound of the denoiser's exposed output: the denoiser limits light to 1e4 times reflectance (below
2), filters do not exceed that, and sharpening at most doubles it."""


def set_planes(**planes: float | Callable[[np.ndarray], np.ndarray]) -> Change:
    """Replace planes, if the frame has them, by a value or by a function of their content."""

    def change(frame: Frame) -> Frame:
        made = dict(frame.planes)
        for role in made.keys() & planes.keys():
            value = planes[role]
            made[role] = value(made[role]) if callable(value) else np.full_like(made[role], value)
        return replace(frame, planes=made)

    return change


def _expose(ev: int, colour: np.ndarray) -> np.ndarray:
    return np.asarray(colour * 2.0**ev, np.float32)


def _fireflies(colour: np.ndarray) -> np.ndarray:
    spotted = colour.copy()
    spotted[::7, ::5] = 1e6
    return spotted


_MISSES = dict(depth=1e10, normal=0, diffuse_albedo=0, specular_albedo=0, roughness=0, motion=0)
LIGHT_CHANGES: dict[str, Change] = ({
    f"{ev:+d} EV": set_planes(colour=partial(_expose, ev)) for ev in (-40, -20, 20, 40)
} | {
    "black": set_planes(colour=0), "denormal": set_planes(colour=1e-42),
    "constant": set_planes(colour=0.5),
    "largest half": set_planes(colour=65504), "1e10": set_planes(colour=1e10),
    "largest float": set_planes(colour=3.4e38), "negative": set_planes(colour=lambda c: -c),
    "NaN": set_planes(colour=np.nan), "infinite": set_planes(colour=np.inf),
    "minus infinite": set_planes(colour=-np.inf), "fireflies": set_planes(colour=_fireflies),
})
HARD: dict[str, Change] = LIGHT_CHANGES | {
    "normals 0": set_planes(normal=0), "normals NaN": set_planes(normal=np.nan),
    "albedos 0": set_planes(diffuse_albedo=0, specular_albedo=0),
    "albedos broken": set_planes(diffuse_albedo=np.nan, specular_albedo=np.inf),
    "roughness 0": set_planes(roughness=0), "roughness NaN": set_planes(roughness=np.nan),
    "depth 0": set_planes(depth=0), "depth infinite": set_planes(depth=np.inf),
    "depth NaN": set_planes(depth=np.nan), "depth denormal": set_planes(depth=1e-42),
    "depth negative": set_planes(depth=-1),
    "motion 1e6": set_planes(motion=1e6), "motion -1e6": set_planes(motion=-1e6),
    "motion 9e4": set_planes(motion=9e4), "motion NaN": set_planes(motion=np.nan),
    "motion infinite": set_planes(motion=np.inf),
    "misses": set_planes(**_MISSES), "black misses": set_planes(colour=0, **_MISSES),
    "everything NaN": set_planes(**dict.fromkeys(map(str, Role), np.nan)),
}
"""Name -> change of a frame; LIGHT_CHANGES change its colour alone."""


@dataclass(frozen=True)
class Outcome:
    """The result on a hard input: the largest exposed light, NaN if any is NaN. It is well if
    exposed light is finite and in [0, BRIGHTEST_OUTPUT], and tone-mapped light in [0, 1]."""

    model: str
    case: str
    highest: float
    well: bool


def stress(frames: Sequence[Frame], device: Device,
           models: Sequence[str] | None = None) -> Iterator[Outcome]:
    """Every hard input for every network, by tag (default: those for the device); 'm.int8.1x' is
    the network of 'm.int8' at render size. All frames but the last are changed, so that the last
    one has them in its history."""
    for model in models or tags(device):
        tag, unscaled = split_ending(model)[0], model.endswith(UNSCALED)
        denoise = Pipeline([DenoiseUpscale(model=tag, scale=1 if unscaled else 2)], device,
                           cuts="none", checks=False)
        given = ([replace(frame, guides={}, guide_size=None) for frame in frames] if unscaled
                 else frames)
        show = Pipeline([ToneMap()], device, cuts="none")
        for case, change in HARD.items():
            denoise.reset()
            hard = [*map(change, given[:-1]), given[-1]]
            results = [(denoise(frame)[Role.COLOUR], denoise.exposure_factor) for frame in hard]
            shown = [show(Frame({Role.COLOUR: colour}))[Role.COLOUR] for colour, _ in results]
            highest = float(np.max([colour.max() * factor for colour, factor in results]))
            lowest = float(np.min([colour.min() for colour, _ in results]))
            well = (0 <= lowest and highest <= BRIGHTEST_OUTPUT
                    and all(0 <= one.min() and one.max() <= 1 for one in shown))
            yield Outcome(model, case, highest, bool(well))


def tags(device: Device) -> list[str]:
    """Tags of the networks, in the precisions made for the device."""
    names = [name.removeprefix(f"{PASS}.")
             for name in Library().names() if name.startswith(f"{PASS}.")]
    other = ".fp16" if device.memory.host_visible else ".int8"
    found = [split_ending(name) for name in names]
    return [exact(tag) + ending
            for tag, ending in found if ending != GUIDED and not tag.endswith(other)]


def as_dict(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The outcomes in plain types; NaN becomes null."""
    rows = [asdict(one) | {"highest": one.highest if np.isfinite(one.highest) else None}
            for one in outcomes]
    return {"well": all(one.well for one in outcomes), "outcomes": rows}


def as_text(outcomes: Sequence[Outcome]) -> str:
    """A line per network, and one for each input with a bad result."""
    lines = []
    for model in dict.fromkeys(one.model for one in outcomes):
        own = [one for one in outcomes if one.model == model]
        lines.append(f"{model}: {sum(one.well for one in own)} of {len(own)} hard inputs give "
                     "light in range")
        lines += [f"  {one.case}: not in range, largest exposed light {one.highest:g}"
                  for one in own if not one.well]
    return "\n".join(lines)

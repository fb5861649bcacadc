"""Frames that no renderer should write, and whether what passes make of them is finite and in range."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.models import GUIDED, PASS, UNSCALED, exact, parted
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device, Library

Change = Callable[[Frame], Frame]
BRIGHTEST = 4e4
"""Exposed light that the denoiser's output stays below: it keeps 1e4 times reflectance, which is taken to be below 2,
its filters do not enlarge that, and sharpening at most doubles it."""


def changed(**planes: float | Callable[[np.ndarray], np.ndarray]) -> Change:
    """Replaces planes, by name and where the frame has them, by a value or by a function of what they hold."""

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
LIGHTS: dict[str, Change] = {
    f"{ev:+d} EV": changed(colour=partial(_expose, ev)) for ev in (-40, -20, 20, 40)
} | {
    "black": changed(colour=0), "denormal": changed(colour=1e-42), "constant": changed(colour=0.5),
    "largest half": changed(colour=65504), "1e10": changed(colour=1e10), "largest float": changed(colour=3.4e38),
    "negative": changed(colour=lambda c: -c), "NaN": changed(colour=np.nan), "infinite": changed(colour=np.inf),
    "minus infinite": changed(colour=-np.inf), "fireflies": changed(colour=_fireflies),
}
HARD: dict[str, Change] = LIGHTS | {
    "normals 0": changed(normal=0), "normals NaN": changed(normal=np.nan),
    "albedos 0": changed(diffuse_albedo=0, specular_albedo=0),
    "albedos broken": changed(diffuse_albedo=np.nan, specular_albedo=np.inf),
    "roughness 0": changed(roughness=0), "roughness NaN": changed(roughness=np.nan),
    "depth 0": changed(depth=0), "depth infinite": changed(depth=np.inf), "depth NaN": changed(depth=np.nan),
    "depth denormal": changed(depth=1e-42), "depth negative": changed(depth=-1),
    "motion 1e6": changed(motion=1e6), "motion -1e6": changed(motion=-1e6), "motion 9e4": changed(motion=9e4),
    "motion NaN": changed(motion=np.nan), "motion infinite": changed(motion=np.inf),
    "misses": changed(**_MISSES), "black misses": changed(colour=0, **_MISSES),
    "everything NaN": changed(**dict.fromkeys(map(str, Role), np.nan)),
}
"""Name -> what it makes of a frame; of its colour alone in LIGHTS."""


@dataclass(frozen=True)
class Outcome:
    """What came of a hard input: the largest exposed light, NaN where some was no number, and whether all is well:
    exposed light is finite and in [0, BRIGHTEST], and tone-mapped in [0, 1]."""

    model: str
    case: str
    highest: float
    well: bool


def stress(frames: Sequence[Frame], device: Device, models: Sequence[str] | None = None) -> Iterator[Outcome]:
    """Every hard input for every network, by tag (default: those for the device); 'm.int8.1x' is what 'm.int8' runs at
    render size. All frames but the last are changed, so that the last one has a history of them."""
    for model in models or tags(device):
        tag, unscaled = parted(model)[0], model.endswith(UNSCALED)
        denoise = Pipeline([DenoiseUpscale(model=tag, scale=1 if unscaled else None)], device, cuts="none")
        given = [replace(frame, guides={}, guide_size=None) for frame in frames] if unscaled else frames
        show = Pipeline([ToneMap()], device, cuts="none")
        for case, change in HARD.items():
            denoise.reset()
            hard = [*map(change, given[:-1]), given[-1]]
            results = [(denoise(frame)[Role.COLOUR], denoise.exposure) for frame in hard]
            shown = [show(Frame({Role.COLOUR: colour}))[Role.COLOUR] for colour, _ in results]
            highest = float(np.max([colour.max() * exposure for colour, exposure in results]))
            lowest = float(np.min([colour.min() for colour, _ in results]))
            well = 0 <= lowest and highest <= BRIGHTEST and all(0 <= one.min() and one.max() <= 1 for one in shown)
            yield Outcome(model, case, highest, bool(well))


def tags(device: Device) -> list[str]:
    """Networks, each in the precisions that are made for the device."""
    names = [name.removeprefix(f"{PASS}.") for name in Library().names() if name.startswith(f"{PASS}.")]
    other = ".fp16" if device.memory.host_visible else ".int8"
    found = [parted(name) for name in names]
    return [exact(tag) + ending for tag, ending in found if ending != GUIDED and not tag.endswith(other)]


def as_dict(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The outcomes in plain types; a light that is no number is null."""
    rows = [asdict(one) | {"highest": one.highest if np.isfinite(one.highest) else None} for one in outcomes]
    return {"well": all(one.well for one in outcomes), "outcomes": rows}


def as_text(outcomes: Sequence[Outcome]) -> str:
    """A line a network, and one for each input that is not well."""
    lines = []
    for model in dict.fromkeys(one.model for one in outcomes):
        own = [one for one in outcomes if one.model == model]
        lines.append(f"{model}: {sum(one.well for one in own)} of {len(own)} hard inputs give light in range")
        lines += [f"  {one.case}: not in range, largest exposed light {one.highest:g}" for one in own if not one.well]
    return "\n".join(lines)

"""Networks of the denoised upscaler: from a tag to the model that runs, and which of several fits a time budget."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from postfx.errors import PassOptionError
from postfx.passes.denoise.tiling import LEVELS
from postfx.runtime import Device, Library, PipelineState

PASS = "denoise_upscale"
EXACT = ".fp32"
"""Suffix of a tag for the network as trained, in float32."""
GUIDED, UNSCALED = ".guides", ".1x"
SPECIAL = {GUIDED: "when a frame has guides", UNSCALED: "where the output has the render size"}
"""Endings of the names of networks that are taken by themselves, and when."""
STAND_INS = {"l": "m"}
"""Networks that have none for the render size beside them, and whose is taken there, which is better."""


def exact(tag: str) -> str:
    """The tag with its precision; float32 if it has none: 'm' -> 'm.fp32'."""
    return tag if "." in tag else f"{tag}{EXACT}"


def parted(name: str) -> tuple[str, str]:
    """A tag or a model's name without its special ending, and that: 'm.int8.1x' -> 'm.int8', '.1x'."""
    ending = next((one for one in SPECIAL if name.endswith(one)), "")
    return name.removesuffix(ending), ending


def validate_tag(tag: str) -> str:
    """The option `model`; PassOptionError for a network that is taken by itself."""
    plain, ending = parted(tag)
    if ending:
        raise PassOptionError(f"model '{tag}' runs {SPECIAL[ending]}: give the model '{plain}'")
    return tag


def model_of(tag: str, ending: str = "", device: Device | None = None) -> str:
    """Name of the model for a tag: 'm.fp32' -> 'denoise_upscale.m', 'm.int8' -> 'denoise_upscale.m.int8'.

    Without a precision, a tag means the device's fast one if it exists (int8 on a CPU, fp16 on a GPU), else float32.
    Without a device it means the float32 model, which every such tag has. If a tag has no network for the render size,
    its stand-in's runs, or else the plain one.
    """
    if ending != UNSCALED:
        return _named(tag, ending, device)
    found = [_named(one, UNSCALED, device) for one in (tag, _stand_in(tag))]
    return next(filter(has_model, found), _named(tag, "", device))


def unscaled_remarks(tag: str) -> list[str]:
    """What a plan says of a network for which another stands in at the render size."""
    other = _stand_in(tag)
    if other == tag or model_of(tag, UNSCALED) != _named(other, UNSCALED, None):
        return []
    return [f"model '{tag}' has no network for 1x: '{other}' stands in, which is better there"]


def _stand_in(tag: str) -> str:
    """The stand-in at 1x, 'l.int8' -> 'm.int8'; a tag without one is its own."""
    size, dot, precision = tag.partition(".")
    return f"{STAND_INS.get(size, size)}{dot}{precision}"


def _named(tag: str, ending: str, device: Device | None) -> str:
    if tag.endswith(EXACT):
        return f"{PASS}.{tag.removesuffix(EXACT)}{ending}"
    if device is not None and "." not in tag:
        fast = f"{PASS}.{tag}.{'int8' if device.memory.host_visible else 'fp16'}{ending}"
        if has_model(fast):
            return fast
    return f"{PASS}.{tag}{ending}"


def has_model(model: str) -> bool:
    """Whether a model comes with postfx."""
    return model in Library().names()


def grid_of(models: Iterable[str]) -> int:
    """Pixels of the render size in a place of the coarsest level that one of some models computes: what the sides of
    its input are multiples of."""
    return max(_grid(Library().card(model).get("outputs", {}) if has_model(model) else {}) for model in models)


def doubts_planes(model: str) -> bool:
    """Whether a model's network says how far each pixel's planes are trusted, in its last hidden channel."""
    return has_model(model) and bool(Library().card(model).get("config", {}).get("trust"))


def _grid(outputs: Mapping[str, Mapping[str, Any]]) -> int:
    levels = [int(name[-1]) for name, facts in outputs.items() if "level" in name and not facts.get("constant")]
    return 1 << max(levels, default=LEVELS)


def load_network(device: Device, model: str, dims: Mapping[str, int]) -> PipelineState:
    """A model that comes with postfx, ready for the given sizes of its free dimensions."""
    return device.pipeline_state(Library(), model, dims)


def name_models(device: Device, models: Iterable[str]) -> None:
    """Name these models, if postfx ships them, as ones that may run later."""
    library = Library()
    for model in set(models) & set(library.names()):
        device.name_model(library, model)


FAMILY = {"s": 1.0, "m": 3.5, "l": 5.0}
"""Networks by size, fastest first, and about how many times as long as the first each takes in float32."""

FAST = {"s": 1.0, "m": 2.1, "l": 2.8}
"""The same in integers or half precision."""

ROOM = 0.85
"""Share of the budget that a slower network may be expected to take; the rest keeps it from going back at once."""

WEIGHT = 0.3
"""Of the last frame in the running mean of a network's time."""

PATIENCE, MOST_PATIENCE = 2, 256
"""Frames in a row that must allow a slower network: at first, and at most after it was too slow again and again."""

STEADY = 64
"""Frames on a slower rung after which its being too slow before is forgotten."""

TOO_LONG = 2
"""Frames in a row over the budget before a faster network is taken: one may be another program's fault."""


def family(model: str) -> tuple[str, ...]:
    """Tags up to `model`, fastest first, of its precision: 'm.int8' -> 's.int8', 'm.int8'. Other tags stand alone."""
    size, dot, precision = model.partition(".")
    if size not in FAMILY:
        return (model,)
    sizes = list(FAMILY)[: list(FAMILY).index(size) + 1]
    return tuple(f"{smaller}{dot}{precision}" for smaller in sizes)


def cost(model: str) -> float:
    """About how long a model 'denoise_upscale.m.int8' takes against the others of its family."""
    _, size, *rest = model.split(".")
    known = FAST if {"int8", "fp16"} & set(rest) else FAMILY
    return known.get(size, 1.0)


class Ladder:
    """Chooses a rung by the times of the frames so far.

    Args:
        costs: about how long each rung takes, in any unit, fastest first; only their ratios count.
        budget: milliseconds that a frame may take.

    Attributes:
        rung: what to run next. It starts at the fastest.
    """

    def __init__(self, costs: Sequence[float], budget: float) -> None:
        self.rung = 0
        self._costs, self._budget = tuple(costs), budget
        self._patience = PATIENCE
        self._time = 0.0
        self._frames = self._over = self._fits = 0
        self._go(0)

    def note_time(self, milliseconds: float) -> None:
        """Tell how long the last frame took; a rung's first frame is not counted, since it prepares what later ones
        find ready."""
        if self._frames:
            before = self._time or milliseconds
            self._time = before + WEIGHT * (milliseconds - before)
            self._over = self._over + 1 if milliseconds > self._budget else 0
            self._fits = self._fits + 1 if self._best(ROOM * self._budget) > self.rung and not self._over else 0
            self._decide(milliseconds)
        self._frames += 1

    def note_resize(self, ratio: float) -> None:
        """Tell that the next frame has so many times the pixels of the last one."""
        self._time *= ratio

    def _decide(self, milliseconds: float) -> None:
        if self._over >= TOO_LONG and self.rung:
            self._time = milliseconds
            self._patience = min(2 * self._patience, MOST_PATIENCE)
            self._go(min(self.rung - 1, self._best(self._budget)))
        elif self._fits >= self._patience:
            self._go(self._best(ROOM * self._budget))
        elif self._climbed and self._frames == STEADY:
            self._patience = PATIENCE

    def _best(self, limit: float) -> int:
        """The slowest rung that is expected to stay within a limit."""
        unit = self._time / self._costs[self.rung]
        return max((rung for rung, cost in enumerate(self._costs) if unit * cost <= limit), default=0)

    def _go(self, rung: int) -> None:
        self._climbed = rung > self.rung
        self.rung, self._time, self._frames, self._over, self._fits = rung, 0.0, 0, 0, 0

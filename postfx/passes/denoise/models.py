"""Networks of the denoised upscaler: from a tag to the model that runs, and which of several fits a
time budget."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from postfx.compiled.library import has_byte_products
from postfx.errors import ModelError, PassOptionError
from postfx.kernels.denoise import BLEND, FINE, KERNEL, MEMORY
from postfx.passes.denoise.geometry import PYRAMID_LEVELS
from postfx.runtime import Device, Library, PipelineState
from postfx.runtime.convolutions import Head
from postfx.runtime.models import check_card_beside
from postfx.system import usable_memory

PASS = "denoise_upscale"
HEADS = {"raw_fine": Head("fine", FINE, BLEND, MEMORY, side=2)} | {
    f"raw_level{level}": Head(f"level{level}", KERNEL + 1, KERNEL, KERNEL + 1)
    for level in range(1, PYRAMID_LEVELS + 1)}
"""Outputs that a GPU gives after their activations: weights of filters, shares, and states."""
EXACT_SUFFIX = ".fp32"
"""Suffix of a tag for the network as trained, in float32."""
FILE = ".onnx"
"""Suffix of a tag for a network in a file."""
GUIDED = ".guides"
UNSCALED = ".1x"
SPECIAL = {GUIDED: "when a frame has guides", UNSCALED: "where the output has the render size"}
"""Endings of the names of networks that are chosen automatically, and when."""
CLASSIC = "classic"
"""Tag, and name in place of a model, of the classical filter, which runs without a network."""
BEST_NETWORK = "xl"
"""The network where nobody chose one and nothing speaks against it."""
USUAL_NETWORK = "m"
"""The network for all else where nobody chose one."""
PIXEL_BYTES = 3900
"""Memory that `xl` takes for each render pixel on a CPU: 3,890 measured at 1280x720."""
GPU_PIXEL_BYTES = 5300
"""Bytes of memory for a pixel on a GPU: 5,259 measured at 1920x1080."""
ENLARGING_PIXEL_BYTES = 1000
"""What enlarging adds, to three times the size at most: 894 measured at 640x360 on a CPU."""
STAND_INS = {"l": "m", "xl": "m"}
"""Networks without a variant for the render size, or with one that filters no parts, and the
network whose variant is taken there."""
ENLARGING_STAND_INS = {"xl": "l"}
"""Networks whose variant for the render size runs before frames are enlarged, and the network that
enlarges noisy frames in their place, and such mixtures where they have none of their own."""


def exact(tag: str) -> str:
    """The tag with its precision; float32 if it has none: 'm' -> 'm.fp32'."""
    return tag if "." in tag else f"{tag}{EXACT_SUFFIX}"


def usual_network(size: tuple[int, int], scale: float, device: Device,
                  guided: bool = False) -> str:
    """The network for frames of a (width, height) on a device, where nobody chose one: the best
    one, if it is the best for them and their memory is there.

    Args:
        size: the render's.
        scale: output over render width.
        guided: whether frames have guides.
    """
    fits = (takes_best(scale, device, guided)
            and lacks_memory(size, scale, device) is None)
    return BEST_NETWORK if fits else USUAL_NETWORK


def takes_best(scale: float, device: Device, guided: bool = False) -> bool:
    """Whether frames take the best network where memory is enough: on a CPU, or on a GPU whose
    kernels are ours and whose free memory is known; not where guides are read, which the usual one
    does."""
    runs = device.memory.host_visible or device.gpu is not None
    return runs and not (guided and scale > 1)


def lacks_memory(size: tuple[int, int], scale: float, device: Device) -> str | None:
    """Why a device cannot run the best network on whole frames of a (width, height), enlarged so;
    None if it can. A GPU's memory is what other programs leave of it now."""
    width, height = size
    if device.gpu is None:
        each, there, has = PIXEL_BYTES, usable_memory(), "machine has {} GB"
    else:
        each, there, has = GPU_PIXEL_BYTES, device.gpu.free_bytes(), "GPU has {} GB free"
    needs = (each + ENLARGING_PIXEL_BYTES * (scale > 1)) * width * height
    if needs <= there:
        return None
    return (f"frames of {width}x{height} take {needs >> 30} GB, this {has.format(there >> 30)}: "
            f"{USUAL_NETWORK} runs; --model {BEST_NETWORK} with --memory works in tiles")


def split_ending(name: str) -> tuple[str, str]:
    """A tag or a model's name without its special ending, and the ending: 'm.int8.1x' -> 'm.int8',
    '.1x'."""
    ending = next((one for one in SPECIAL if name.endswith(one)), "")
    return name.removesuffix(ending), ending


# A tag is a plain word for a network that comes with postfx, FOLDER/TAG for one of another library,
# or FILE.onnx for this very file. Names of models follow: 'denoise_upscale.m',
# 'FOLDER/denoise_upscale.m', 'FOLDER/mine.onnx'.


def validate_tag(model: str, library: Library | None = None) -> str:
    """The tag for the options `model` and `library`.

    Raises PassOptionError for a network that is chosen automatically, ModelError for one that does
    not exist.
    """
    path = Path(os.path.expanduser(model))
    word = path.stem if model.endswith(FILE) else model
    plain, ending = split_ending(word)
    if ending:
        there = model.removesuffix(FILE).removesuffix(ending) + FILE * model.endswith(FILE)
        raise PassOptionError(f"model '{model}' runs {SPECIAL[ending]}: give the model '{there}'")
    if model.endswith(FILE):
        if library is not None:
            raise PassOptionError(f"model '{model}' is a file, which needs no library: leave "
                                  "library out")
        if not os.path.isfile(path):
            raise ModelError(f"model '{model}': no such file: check the path and its rights; "
                             "'postfx models' lists those that need none")
        check_card_beside(path)
        return str(path.absolute())
    if library is None or model == CLASSIC:
        check_is_there(model)
        return model
    if library.trust:
        raise PassOptionError("the denoised upscaler takes no networks on trust: give it "
                              f"{library.folders[0]} alone")
    found = library.path(f"{PASS}.{model.removesuffix(EXACT_SUFFIX)}")
    return f"{found.absolute().parent}/{model}"


def check_is_there(tag: str) -> None:
    """Raise ModelError that names the sizes for a tag that no network of postfx has."""
    if tag == CLASSIC:
        return
    library, name = find_model(model_of(tag))
    try:
        library.path(name)
    except ModelError as error:
        if not library.names():
            raise
        hint = re.search(": did you mean [^?]*\\?", str(error))
        meant = hint[0] if hint else ":"
        raise ModelError(f"no network '{short_tag(tag)}'{meant} give s, m, l, xl, classic or "
                         "FILE.onnx; 'postfx models' lists all") from None


def short_tag(tag: str) -> str:
    """A tag as users see it: without a folder."""
    return Path(tag).name.removesuffix(FILE).removeprefix(f"{PASS}.")


def find_model(model: str) -> tuple[Library, str]:
    """The library of a model, and its name there."""
    path = Path(model)
    return ((Library(path.parent), path.name.removesuffix(FILE)) if "/" in model
            else (Library(), model))


def model_of(tag: str, ending: str = "", device: Device | None = None,
             filters: bool = False) -> str:
    """Name of the model for a tag: 'm.fp32' -> 'denoise_upscale.m', 'm.int8' ->
    'denoise_upscale.m.int8'.

    Without a precision, a tag means the device's fast one if it exists (int8 on a CPU, fp16 on a
    GPU), else float32. Without a device it means the float32 model, which every such tag has. If a
    tag has no network for the render size, its stand-in's runs, or else the plain one. So it does
    where the network must predict ``filters``, which other pictures need, too, and gives the
    picture alone. If a tag has a network for the render size alone, another one enlarges.
    """
    enlarging = _stand_in(tag, ENLARGING_STAND_INS)
    if ending != UNSCALED:
        return _named(enlarging, ending, device)
    found = [_named(one, UNSCALED, device) for one in (tag, _stand_in(tag, STAND_INS))]
    fitting = (one for one in found if has_model(one) and not (filters and gives_picture(one)))
    return next(fitting, _named(enlarging, "", device))


def unscaled_remarks(tag: str) -> list[str]:
    """What a plan says about a network when another one stands in for it at the render size."""
    other = _stand_in(tag, STAND_INS)
    if other == tag or model_of(tag, UNSCALED) != _named(other, UNSCALED, None):
        return []
    size, _, precision = tag.partition(".")
    if precision and size in ENLARGING_STAND_INS:
        return [f"model '{tag}' has no network in {precision}: '{other}' stands in; give model "
                f"'{size}' for the better picture"]
    return [f"model '{tag}' has no network for 1x: '{other}' stands in, which is better there"]


def filter_model(tag: str, ending: str, device: Device | None = None) -> str:
    """Name of the model that filters what a tag's own cannot, as it gives the picture alone or sees
    a denoised one: the stand-in's, or else one of the tag itself."""
    found = _named(_stand_in(tag, STAND_INS), ending, device)
    return found if has_model(found) and not gives_picture(found) else model_of(tag, ending, device,
                                                                                filters=True)


def denoises_first(tag: str) -> bool:
    """Whether frames that are enlarged are denoised first by the tag's network for the render size,
    which must give the picture itself."""
    size = short_tag(tag).partition(".")[0]
    return size in ENLARGING_STAND_INS and gives_picture(model_of(tag, UNSCALED))


def mixture_model(tag: str, ending: str = "", device: Device | None = None) -> str:
    """Name of the model that enlarges frames which were denoised first: the tag's own, or the one
    that enlarges noisy frames."""
    own = _named(tag, "", device)
    return own if has_model(own) else model_of(tag, ending, device)


def enlarging_remarks(tag: str) -> list[str]:
    """What a plan says where another network stands in for one and nothing is denoised first."""
    other = short_tag(model_of(tag))
    size, _, precision = tag.partition(".")
    if denoises_first(tag) or size not in ENLARGING_STAND_INS or other == tag:
        return []
    if precision:
        return [f"model '{tag}' has no network in {precision}: '{other}' stands in; give model "
                f"'{size}' for the better picture"]
    return [f"model '{tag}' does not enlarge: '{other}' stands in"]


def _stand_in(tag: str, stand_ins: Mapping[str, str]) -> str:
    """The stand-in of a tag, 'l.int8' -> 'm.int8'; a tag without one is its own."""
    size, dot, precision = tag.partition(".")
    return f"{stand_ins.get(size, size)}{dot}{precision}"


def _named(tag: str, ending: str, device: Device | None) -> str:
    """The full name of the network of a tag for an ending, in the device's fast precision where
    there is one."""
    if tag == CLASSIC:
        return CLASSIC
    if tag.endswith(FILE):
        return f"{tag.removesuffix(FILE)}{ending}{FILE}"
    folder, slash, tag = tag.rpartition("/")
    begin = f"{folder}{slash}{PASS}"
    if tag.endswith(EXACT_SUFFIX):
        return f"{begin}.{tag.removesuffix(EXACT_SUFFIX)}{ending}"
    if device is not None and "." not in tag:
        fast = f"{begin}.{tag}.{'int8' if device.memory.host_visible else 'fp16'}{ending}"
        if has_model(fast):
            return fast
    return f"{begin}.{tag}{ending}"


def has_model(model: str) -> bool:
    """Whether a model exists; the classical filter always does."""
    library, name = find_model(model)
    return model == CLASSIC or name in library


def runs_classic(device: Device) -> bool:
    """Whether a device has the classical filter's kernels: as compiled rows or on a GPU."""
    return device.runs_rows or bool(device.gpu)


def grid_of(models: Iterable[str]) -> int:
    """Render pixels along a side of a cell of the coarsest level that any of these models computes:
    sides of their input are multiples of it."""
    return max(_grid(_card(model).get("outputs", {})) for model in models)


def doubts_planes(model: str) -> bool:
    """Whether a model's network says how far each pixel's planes are trusted, in its last hidden
    channel."""
    return bool(_card(model).get("config", {}).get("trust"))


def reads_mirrored(model: str) -> bool:
    """Whether a model's network reads the planes that follow mirrors and glass."""
    return any(name.endswith("mirrored") for name in _card(model).get("inputs", {}))


def predicts_error(model: str) -> bool:
    """Whether a model's network says how far off each pixel is expected to be."""
    return "error" in _card(model).get("outputs", {})


def gives_picture(model: str) -> bool:
    """Whether a model's network gives the picture itself, and no filters that parts and alpha could
    pass, too."""
    return "picture" in _card(model).get("outputs", {})


def blanks_volumes(model: str) -> bool:
    """Whether depth and albedo are left out for a model where they show what lies behind a
    volume."""
    return bool(_card(model).get("blanks_volumes", True))


# Render pixels that a network must see around active ones so that the result differs by less than
# 1e-3 from that of the whole frame. docs/lab/denoiser.md lists the differences. A card's own "halo"
# comes before them.
HALOS = {CLASSIC: 40, "s": 56, "m": 44, "l": 48}
"""By model size; the largest for other models."""
GUIDED_HALO = 96
"""Halo of models that read guides."""


def halo_of(models: Iterable[str]) -> int:
    """The halo that is enough for all of these models."""
    return max(_halo_in_card(model) or _halo(model) for model in models)


# Render pixels that a network sees around each at most, counted by its convolutions: nothing
# farther away changes a bit of what it gives.
NETWORK_REACHES_PX = {CLASSIC: 72, "s": 136, "m": 64, "l": 64}
"""By model size."""
GUIDED_REACH = 224
"""Reach of models that read guides, in render pixels."""


def reach_of(models: Iterable[str]) -> int:
    """How far the results of all of these models depend on pixels; 0 if that is not known."""
    reaches = [_halo_in_card(model) or _reach(model) for model in models]
    return max(reaches) if all(reaches) else 0


def _reach(model: str) -> int:
    if "/" in model or model.endswith(FILE):
        return 0
    if model.endswith(GUIDED):
        return GUIDED_REACH
    return NETWORK_REACHES_PX.get(model if model == CLASSIC else model.split(".")[1], 0)


def seamless(models: Iterable[str]) -> int:
    """Halo of tiles side by side. A measured one is larger than around masks, as every seam shows:
    with it integer networks agree, too, frame after frame."""
    return max(_halo_in_card(model) or _halo(model) * 4 // 3 for model in models)


def _halo(model: str) -> int:
    if model.removesuffix(FILE).endswith(GUIDED):
        return GUIDED_HALO
    if model in HALOS:
        return HALOS[model]
    size = "" if "/" in model else model.split(".")[1]  # of other libraries, nothing was measured
    return HALOS.get(size, max(HALOS.values()))


def _halo_in_card(model: str) -> int:
    """All pixels that a model's network sees around each, by its card; 0 if it says nothing."""
    halo = _card(model).get("halo")
    return halo if isinstance(halo, int) else 0


def _card(model: str) -> dict[str, Any]:
    library, name = find_model(model)
    return library.card(name) if name in library else {}


def _grid(outputs: Mapping[str, Mapping[str, Any]]) -> int:
    levels = [int(name[-1])
              for name, facts in outputs.items() if "level" in name and not facts.get("constant")]
    return 1 << max(levels, default=PYRAMID_LEVELS)


def load_network(device: Device, model: str, dims: Mapping[str, int]) -> PipelineState:
    """A model, ready for the given sizes of its free dimensions."""
    library, name = find_model(model)
    return device.pipeline_state(library, name, dims, heads=HEADS,
                                 codes=device.runs_rows and has_byte_products())


def name_models(device: Device, models: Iterable[str]) -> None:
    """Announce these models, if they exist, as ones that may run later."""
    for model in set(filter(has_model, models)) - {CLASSIC}:
        device.name_model(*find_model(model))


FAMILY = {CLASSIC: 0.5, "s": 1.0, "m": 3.5, "l": 5.0, "xl": 26.0}
"""The classical filter and networks by size, fastest first, and about how many times as long as 's'
each takes in float32."""

FAST = {CLASSIC: 0.5, "s": 1.0, "m": 2.1, "l": 2.8, "xl": 22.0}
"""As `FAMILY`, in integers or half precision."""

TWO_STAGES_COST = 36.0
"""As `FAMILY`, for both networks of `xl` where frames are enlarged: 4793 ms on a CPU, `s` 132."""

ROOM = 0.85
"""Share of the budget that a slower network may be expected to take; the rest keeps it from going
back at once."""

WEIGHT = 0.3
"""Weight of the last frame in the running mean of a network's time."""

# Frames in a row that must allow a slower network.
PATIENCE = 2
"""At first."""
MOST_PATIENCE = 256
"""At most, after it was too slow again and again."""

STEADY = 64
"""Frames on a slower rung after which its being too slow before is forgotten."""

TOO_LONG = 2
"""Frames in a row over the budget before a faster network is taken: one may be another program's
fault."""


def family(tag: str) -> tuple[str, ...]:
    """Tags up to this one, fastest first, of its precision: 'm.int8' -> 'classic', 's.int8',
    'm.int8'. Other tags stand alone, and so do those of other libraries."""
    folder, slash, word = tag.rpartition("/")
    size, dot, precision = word.partition(".")
    if size not in FAMILY or tag.endswith(FILE) or tag == CLASSIC:
        return (tag,)
    sizes = list(FAMILY)[: list(FAMILY).index(size) + 1]
    return tuple(one if one == CLASSIC else f"{folder}{slash}{one}{dot}{precision}"
                 for one in sizes)


def cost(model: str) -> float:
    """About how long a model 'denoise_upscale.m.int8' takes against the others of its family."""
    if model == CLASSIC:
        return FAST[CLASSIC]
    _, size, *rest = f"{find_model(model)[1]}..".split(".")
    known = FAST if {"int8", "fp16"} & set(rest) else FAMILY
    return known.get(size, 1.0)


class Ladder:
    """Chooses a rung by the times of the frames so far.

    Args:
        costs: about how long each rung takes, in any unit, fastest first; only their ratios count.
        budget: milliseconds that a frame may take.
        first: the rung to start at.
        most_patience: frames in a row at most that must allow a slower rung which was too slow
            before.

    Attributes:
        rung: what to run next.
    """

    def __init__(self, costs: Sequence[float], budget: float, first: int = 0,
                 most_patience: int = MOST_PATIENCE) -> None:
        self.rung, self._most_patience = first, most_patience
        self._costs, self._budget = tuple(costs), budget
        self._patience = PATIENCE
        self._time = 0.0
        self._frames = self._over = self._fits = 0
        self._go(first)

    def note_time(self, milliseconds: float) -> None:
        """Tell how long the last frame took; a rung's first frame is not counted, since it prepares
        what later ones find ready."""
        self._frames += 1
        if self._frames > 1:
            before = self._time or milliseconds
            self._time = before + WEIGHT * (milliseconds - before)
            self._over = self._over + 1 if milliseconds > self._budget else 0
            self._fits = (self._fits + 1
                          if self._best(ROOM * self._budget) > self.rung and not self._over else 0)
            self._decide(milliseconds)

    def note_resize(self, ratio: float) -> None:
        """Tell by what factor the next frame has more pixels than the last one."""
        self._time *= ratio

    def _decide(self, milliseconds: float) -> None:
        if self._over >= TOO_LONG and self.rung:
            self._time = milliseconds
            self._patience = min(2 * self._patience, self._most_patience)
            self._go(min(self.rung - 1, self._best(self._budget)))
        elif self._fits >= self._patience:
            self._go(self._best(ROOM * self._budget))
        elif self._climbed and self._frames == STEADY:
            self._patience = PATIENCE

    def _best(self, limit: float) -> int:
        """The slowest rung that is expected to stay within a limit."""
        unit = self._time / self._costs[self.rung]
        return max((rung for rung, cost in enumerate(self._costs) if unit * cost <= limit),
                   default=0)

    def _go(self, rung: int) -> None:
        self._climbed = rung > self.rung
        self.rung, self._time, self._frames, self._over, self._fits = rung, 0.0, 0, 0, 0

"""Networks of the denoised upscaler: from a tag to the model that runs, and what its card tells.

A tag is what users give: a plain word for a network that comes with postfx ('m', 'm.int8'),
FOLDER/TAG for one of another library, or FILE.onnx for this very file. Names of models follow from
it: 'denoise_upscale.m', 'FOLDER/denoise_upscale.m', 'FOLDER/mine.onnx'. A name may have an ending
for models that are chosen by themselves: '.1x' at the render's size, '.guides' with guides.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from postfx.errors import ModelError, PassOptionError
from postfx.kernels.denoise import BLEND, FINE, KERNEL, MEMORY
from postfx.passes.denoise.geometry import PYRAMID_LEVELS
from postfx.runtime import Device, Library, PipelineState
from postfx.runtime.convolutions import Head
from postfx.runtime.models import check_card_beside

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
STAND_INS = {"l": "m", "xl": "m"}
"""Network -> network that stands in for it at the render's size, if it has none for that size or
one that cannot filter parts."""
ENLARGING_STAND_INS = {"xl": "l"}
"""Network that denoises before frames are enlarged -> network that enlarges noisy frames in its
place, and denoised ones if it has no network of its own for these."""


def exact(tag: str) -> str:
    """The tag with its precision; float32 if it has none: 'm' -> 'm.fp32'."""
    return tag if "." in tag else f"{tag}{EXACT_SUFFIX}"


def split_ending(name: str) -> tuple[str, str]:
    """A tag or a model's name without its special ending, and the ending: 'm.int8.1x' -> 'm.int8',
    '.1x'."""
    ending = next((one for one in SPECIAL if name.endswith(one)), "")
    return name.removesuffix(ending), ending


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


@lru_cache  # a run asks with every frame
def network_name(tag: str, model: str) -> str:
    """The users' name for the network that runs for their short tag: the tag, with its size
    replaced where a model of another size stands in."""
    asked, dot, precision = tag.partition(".")
    size = short_tag(model).partition(".")[0]
    return tag if size == asked else f"{size}{dot}{precision}"


def find_model(model: str) -> tuple[Library, str]:
    """The library of a model, and its name there."""
    path = Path(model)
    return ((Library(path.parent), path.name.removesuffix(FILE)) if "/" in model
            else (Library(), model))


def model_of(tag: str, ending: str = "", device: Device | None = None,
             filters: bool = False) -> str:
    """Name of the model for a tag: 'm.fp32' -> 'denoise_upscale.m', 'm.int8' ->
    'denoise_upscale.m.int8'.

    A tag without a precision means the device's fast one if it exists (int8 on a CPU, fp16 on a
    GPU), else float32. Without a device it means float32, which every such tag has. At the render's
    size, a tag without a network for it takes its stand-in's, or else the one that enlarges. A tag
    that has a network for the render's size alone takes another one to enlarge.

    Args:
        ending: of the name, see `SPECIAL`.
        filters: whether the network must predict filters. One that gives the picture alone is then
            passed over.
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
    """Name of the model that filters parts and alpha for a tag whose own network cannot: the
    stand-in's, or else another one of the tag."""
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
    """Whether a model's network gives the picture itself, and so no filters for parts and alpha."""
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
    """Halo of tiles that lie side by side. Where it was measured it is larger than around masks, as
    every seam shows: with it integer networks agree, too, frame after frame."""
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
                                 own_kernels=device.runs_rows)


def name_models(device: Device, models: Iterable[str]) -> None:
    """Announce these models, if they exist, as ones that may run later."""
    for model in set(filter(has_model, models)) - {CLASSIC}:
        device.name_model(*find_model(model))

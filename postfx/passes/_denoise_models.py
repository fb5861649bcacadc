"""From the tag of a network, as the user gives it, to the model that runs on a device."""

from __future__ import annotations

from postfx.passes import _denoise_graph
from postfx.passes.base import PassOptionError
from postfx.runtime import Device

PASS = "denoise_upscale"
EXACT = ".fp32"
"""Ends a tag that asks for the network as it was trained, in float32."""
GUIDED, UNSCALED = ".guides", ".1x"
SPECIAL = {GUIDED: "when a frame has guides", UNSCALED: "where the output has the render size"}
"""Endings of the names of networks that are taken by themselves, and when."""
WITH_UNSCALED = "m"
"""The largest network that has one for the render size beside it."""


def exact(tag: str) -> str:
    """The tag of the float32 network where none of another precision was asked for: 'm' -> 'm.fp32'."""
    return tag if "." in tag else f"{tag}{EXACT}"


def parted(name: str) -> tuple[str, str]:
    """A tag or a model's name without its special ending, and that: 'm.int8.1x' -> 'm.int8', '.1x'."""
    ending = next((one for one in SPECIAL if name.endswith(one)), "")
    return name.removesuffix(ending), ending


def checked_tag(tag: str) -> str:
    """The option `model`; PassOptionError for a network that is taken by itself."""
    plain, ending = parted(tag)
    if ending:
        raise PassOptionError(f"model '{tag}' runs {SPECIAL[ending]}: give the model '{plain}'")
    return tag


def model_of(tag: str, ending: str = "", device: Device | None = None) -> str:
    """Name of the model for a tag: 'm.fp32' -> 'denoise_upscale.m', 'm.int8' -> 'denoise_upscale.m.int8'.

    A tag without a precision takes the fast one of the device where there is one, int8 on a CPU and fp16 on a GPU, else
    float32. Without a device: the float32 model, which every tag without a precision has. Where there is no network for
    the render size, the plain one runs.
    """
    found = _named(tag, ending, device)
    return found if ending != UNSCALED or _denoise_graph.has_model(found) else _named(tag, "", device)


def unscaled_remarks(tag: str) -> list[str]:
    """What a plan says of a network that has none for the render size beside it, where another has."""
    if model_of(tag, UNSCALED).endswith(UNSCALED) or not _denoise_graph.has_model(model_of(WITH_UNSCALED, UNSCALED)):
        return []
    return [f"model '{tag}' has no network for 1x: '{WITH_UNSCALED}' is better there from some samples a pixel on"]


def _named(tag: str, ending: str, device: Device | None) -> str:
    if tag.endswith(EXACT):
        return f"{PASS}.{tag.removesuffix(EXACT)}{ending}"
    if device is not None and "." not in tag:
        fast = f"{PASS}.{tag}.{'int8' if device.memory.host_visible else 'fp16'}{ending}"
        if _denoise_graph.has_model(fast):
            return fast
    return f"{PASS}.{tag}{ending}"

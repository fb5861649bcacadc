"""From the tag of a network, as the user gives it, to the model that runs on a device."""

from __future__ import annotations

from postfx.errors import PassOptionError
from postfx.passes import _denoise_graph
from postfx.runtime import Device

PASS = "denoise_upscale"
EXACT = ".fp32"
"""Ends a tag that asks for the network as it was trained, in float32."""
GUIDED, UNSCALED = ".guides", ".1x"
SPECIAL = {GUIDED: "when a frame has guides", UNSCALED: "where the output has the render size"}
"""Endings of the names of networks that are taken by themselves, and when."""
STAND_INS = {"l": "m"}
"""Networks that have none for the render size beside them, and whose is taken there, which is better."""


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
    the render size, that of the tag's stand-in runs, or the plain one.
    """
    if ending != UNSCALED:
        return _named(tag, ending, device)
    found = [_named(one, UNSCALED, device) for one in (tag, _stand_in(tag))]
    return next(filter(_denoise_graph.has_model, found), _named(tag, "", device))


def unscaled_remarks(tag: str) -> list[str]:
    """What a plan says of a network for which another stands in at the render size."""
    other = _stand_in(tag)
    if other == tag or model_of(tag, UNSCALED) != _named(other, UNSCALED, None):
        return []
    return [f"model '{tag}' has no network for 1x: that of '{other}' stands in, which is better there"]


def _stand_in(tag: str) -> str:
    """'l.int8' -> 'm.int8'; a tag for which there is none is its own."""
    size, dot, precision = tag.partition(".")
    return f"{STAND_INS.get(size, size)}{dot}{precision}"


def _named(tag: str, ending: str, device: Device | None) -> str:
    if tag.endswith(EXACT):
        return f"{PASS}.{tag.removesuffix(EXACT)}{ending}"
    if device is not None and "." not in tag:
        fast = f"{PASS}.{tag}.{'int8' if device.memory.host_visible else 'fp16'}{ending}"
        if _denoise_graph.has_model(fast):
            return fast
    return f"{PASS}.{tag}{ending}"

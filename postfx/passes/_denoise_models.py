"""From the tag of a network, as the user gives it, to the model that runs on a device."""

from __future__ import annotations

from postfx.passes import _denoise_graph
from postfx.runtime import Device

PASS = "denoise_upscale"
GUIDED = ".guides"
EXACT = ".fp32"
"""Ends a tag that asks for the network as it was trained, in float32."""


def exact(tag: str) -> str:
    """The tag of the float32 network where none of another precision was asked for: 'm' -> 'm.fp32'."""
    return tag if "." in tag else f"{tag}{EXACT}"


def model_of(tag: str, guided: bool = False, device: Device | None = None) -> str:
    """Name of the model for a tag: 'm.fp32' -> 'denoise_upscale.m', 'm.int8' -> 'denoise_upscale.m.int8'.

    A tag without a precision takes the fast one of the device where there is one, int8 on a CPU and fp16 on a GPU, else
    float32. Without a device: the float32 model, which every tag without a precision has.
    """
    end = GUIDED * guided
    if tag.endswith(EXACT):
        return f"{PASS}.{tag.removesuffix(EXACT)}{end}"
    if device is not None and "." not in tag:
        fast = f"{PASS}.{tag}.{'int8' if device.memory.host_visible else 'fp16'}{end}"
        if _denoise_graph.has_model(fast):
            return fast
    return f"{PASS}.{tag}{end}"

"""The network where nobody chose one: the best one, if it suits the frames and there is memory."""

from __future__ import annotations

from postfx.runtime import Device
from postfx.runtime.own_convolutions import operators_library
from postfx.runtime.session import CPU
from postfx.system import usable_memory

BEST_NETWORK = "xl"
"""The network where nobody chose one and nothing speaks against it."""
USUAL_NETWORK = "m"
"""The network for all else where nobody chose one."""
PIXEL_BYTES = 2600
"""Memory that `xl` takes for each render pixel on a CPU: 2,533 measured at 1280x720."""
PLAIN_PIXEL_BYTES = 4200
"""The same where none of its convolutions are ours: 3,960 measured."""
GPU_PIXEL_BYTES = 2200
"""Bytes of memory for a pixel on a GPU: 2,144 measured at 1920x1080."""
ENLARGING_PIXEL_BYTES = 1000
"""What enlarging adds, to three times the size at most: 894 measured at 640x360 on a CPU."""


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
        has_own = device.placement.provider == CPU and operators_library() is not None
        each = PIXEL_BYTES if has_own else PLAIN_PIXEL_BYTES
        there, has = usable_memory(), "machine has {} GB"
    else:
        each, there, has = GPU_PIXEL_BYTES, device.gpu.free_bytes(), "GPU has {} GB free"
    needs = (each + ENLARGING_PIXEL_BYTES * (scale > 1)) * width * height
    if needs <= there:
        return None
    return (f"frames of {width}x{height} take {needs >> 30} GB, this {has.format(there >> 30)}: "
            f"{USUAL_NETWORK} runs; --model {BEST_NETWORK} with --memory works in tiles")

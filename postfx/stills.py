"""Denoising a picture that is in arrays, in one call."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from postfx.errors import FrameError
from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.default_network import usual_network
from postfx.passes.denoise.options import validate_scale
from postfx.passes.denoise.remarks import NO_HISTORY_REMARK
from postfx.pipeline import Pipeline
from postfx.plan import Plan
from postfx.runtime import Device, default_device
from postfx.system import host_floats


class SupportsDLPack(Protocol):
    """An array of any library that can be shared by DLPack, such as NumPy, PyTorch or JAX."""

    def __dlpack__(self, *, stream: Any = ...) -> Any: ...

    def __dlpack_device__(self) -> Any: ...


def denoise(
    color: SupportsDLPack | None = None,
    *,
    colour: SupportsDLPack | None = None,
    albedo: SupportsDLPack | None = None,
    specular_albedo: SupportsDLPack | None = None,
    normal: SupportsDLPack | None = None,
    roughness: SupportsDLPack | None = None,
    depth: SupportsDLPack | None = None,
    scale: float = 1.0,
    model: str | None = None,
    strength: float = 1.0,
    exposure: str | float = "auto",
    device: str | None = None,
) -> Any:
    """Denoise one picture, and enlarge it by `scale`.

    The arrays are of any library with DLPack; meanings, units and ranges are those of
    `postfx.ROLES`. Each picture is denoised alone: for sequences, in which the frames before help,
    there is `postfx.Pipeline`. Networks stay loaded between calls with the same options. Calls from
    several threads take turns.

    Where `color` lies on a GPU, as a CUDA tensor, all of it happens there: nothing but the
    metering's look at the picture goes through the host's memory. All planes are then float32
    without gaps, and `color` has three channels.

    Args:
        color, colour: (height, width, 3) scene-linear radiance, or with alpha (height, width, 4),
            premultiplied. Either spelling.
        albedo, specular_albedo: (height, width, 3) reflectance.
        normal: (height, width, 3) in world space.
        roughness: (height, width) or (height, width, 1).
        depth: likewise, along the view axis.
        scale, strength: as for `postfx.DenoiseUpscale`.
        model: likewise; None for 'xl' where memory is enough for it, else 'm'.
        exposure: 'auto', or stops: what the picture is exposed by before the network sees it; the
            result is not.
        device: 'cpu', 'cuda', 'cuda:1' or 'auto'; None for the default device, or the GPU where
            `color` lies.

    Returns a float32 array (scale * height, scale * width, 3), or 4 where there is alpha; other
    libraries take it without a copy, as in `torch.from_dlpack(result)`. For a `color` on a GPU it
    is an array there, of the library of `color` if that has `from_dlpack`, else a `postfx.Tensor`.

    Raises FrameError for arrays that do not fit together, and other `postfx.PostfxError`s for
    options that cannot be.
    """
    if (color is None) == (colour is None):
        raise FrameError("denoise takes one picture: give color, the first argument, or colour")
    picture = colour if color is None else color
    aids = {Role.DIFFUSE_ALBEDO: albedo, Role.SPECULAR_ALBEDO: specular_albedo, Role.NORMAL: normal,
            Role.ROUGHNESS: roughness, Role.DEPTH: depth}
    planes: dict[Role, Any] = {role: plane for role, plane in aids.items() if plane is not None}
    _refuse_other_sizes(picture, planes)
    gpu = _gpu_of(picture)
    place = device if gpu is None or device is not None else f"cuda:{gpu}"
    if model is None:
        model = _choose_network(picture, scale, place)
    with _DENOISER_LOCK:
        pipeline = _find_pipeline(scale, model, strength, exposure, place)
        pipeline.reset()
        return (_on_host(pipeline, picture, planes) if gpu is None
                else _on_gpu(pipeline, picture, planes))


def _refuse_other_sizes(picture: Any, planes: Mapping[Role, Any]) -> None:
    """FrameError for an array that has not the picture's size, by the name of its argument."""
    size: tuple[int, ...] = getattr(picture, "shape", ())[:2]
    for role, plane in planes.items():
        other: tuple[int, ...] = getattr(plane, "shape", ())[:2]
        if len(size) == len(other) == 2 and tuple(other) != tuple(size):
            name = "albedo" if role is Role.DIFFUSE_ALBEDO else role
            raise FrameError(f"{name} is {other[1]}x{other[0]}, color {size[1]}x{size[0]}: give "
                             "arrays of one size")


def _choose_network(picture: Any, scale: float, place: str | None) -> str:
    """The network for a picture of any library, if nobody chose one."""
    shape: tuple[int, ...] = getattr(picture, "shape", ())
    height, width = (shape[0], shape[1]) if len(shape) > 1 else (0, 0)
    return _network_at((width, height), validate_scale(scale) or 1.0,
                       None if place is None else str(place))


@lru_cache(maxsize=64)
def _network_at(size: tuple[int, int], scale: float, place: str | None) -> str:
    """The network for a size, which stays once it is chosen: a GPU has less free memory while
    earlier pipelines hold theirs."""
    return usual_network(size, scale, default_device() if place is None else Device(place))


def _on_host(pipeline: Pipeline, given: Any, planes: Mapping[Role, Any]) -> np.ndarray:
    """A picture in the host's memory, of 3 or 4 channels."""
    picture = host_floats(given, "color")
    if picture.ndim != 3 or picture.shape[2] != 4:
        return pipeline(Frame({Role.COLOUR: picture} | dict(planes)))[Role.COLOUR]
    result = pipeline(Frame({Role.COLOUR: picture[..., :3], Role.ALPHA: picture[..., 3:]}
                            | dict(planes)))
    return np.concatenate([result[Role.COLOUR], result[Role.ALPHA]], -1)


def _on_gpu(pipeline: Pipeline, given: Any, planes: Mapping[Role, Any]) -> Any:
    """A picture on the pipeline's device; the result lies there, too."""
    if getattr(given, "shape", (0, 0, 3))[-1] != 3:
        raise FrameError(f"color is {tuple(given.shape)} on a GPU, where it has three channels: "
                         "give color[..., :3], and denoise alpha as an array in the host's memory")
    lent: dict[Role | str, Any] = {Role.COLOUR: given,
                                   **{str(role): plane for role, plane in planes.items()}}
    found = pipeline.on_device(lent, reset=True)[Role.COLOUR]
    library = sys.modules.get(type(given).__module__.partition(".")[0])
    return (library.from_dlpack(found) if library is not None and hasattr(library, "from_dlpack")
            else found)


def _gpu_of(array: Any) -> int | None:
    """Number of the GPU in whose memory an array lies, None for the host's."""
    if not hasattr(array, "__dlpack_device__"):
        return None
    kind, number = array.__dlpack_device__()
    return int(number) if int(kind) in _GPU_KINDS else None


def _find_pipeline(*options: Any) -> Pipeline:
    """The pipeline of these options."""
    try:
        return _pipeline(*options, os.getpid())
    except TypeError:  # what has no hash is no option: a pipeline of its own says of which
        return _pipeline.__wrapped__(*options, os.getpid())


class _Stills(Pipeline):
    """Frames that belong to no sequence, so that nothing is missed without motion."""

    def _told_remarks(self, plan: Plan) -> list[str]:
        return [remark for remark in plan.remarks if NO_HISTORY_REMARK not in remark]


@lru_cache(maxsize=4)
def _pipeline(scale: float, model: str, strength: float, exposure: str | float, device: str | None,
              process: int) -> Pipeline:
    """A pipeline with these options, of this process: threads do not survive a fork."""
    return _Stills([DenoiseUpscale(scale=scale, model=model, strength=strength)],
                   None if device is None else Device(device), exposure)


_DENOISER_LOCK = threading.Lock()
_GPU_KINDS = (2, 13)
"""DLPack's numbers of CUDA's memory, and of memory that CUDA manages on both sides."""

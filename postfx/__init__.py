"""postfx: post-processing of rendered image sequences: denoise, upscale, tone-map.

    import postfx

    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="xl")])  # without it: m, which is faster
    for frame in postfx.read_sequence("shot/noisy.####.exr"):
        postfx.write_frame(f"out/clean.{frame.number:04d}.exr", passes(frame))

A single picture in arrays takes one call: `postfx.denoise(color, albedo=albedo, normal=normal)`.
What is worth telling on the way goes to the logger "postfx".

Everything public is named here and loaded on first use.
"""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from postfx.version import __version__

# read by ONNX Runtime as it is loaded, here and in workers
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

if TYPE_CHECKING:
    from postfx.errors import PostfxError
    from postfx.frame import ROLES, Frame, FrameSpec, Role
    from postfx.interpolate import Between, Interpolator
    from postfx.interpolate.on_device import DeviceInterpolator
    from postfx.io.sequence import Sequence, read_sequence
    from postfx.io.writer import write_frame
    from postfx.passes.composite import BothWays, Overlay
    from postfx.passes.denoise import DenoiseUpscale
    from postfx.passes.denoise.options import RenderSize
    from postfx.passes.oidn import Oidn
    from postfx.passes.partner import MixPartner, Partner
    from postfx.passes.scene import Irradiance, Occlusion, SceneShading
    from postfx.passes.tonemap import ToneMap
    from postfx.pipeline import Pipeline
    from postfx.presenter import Presenter
    from postfx.runtime import Device, Library
    from postfx.stills import denoise
    from postfx.system import models_dir
    from postfx.temporal.reverse_order import Backwards, RunUp

_HOMES = {
    "Backwards": "postfx.temporal.reverse_order",
    "Between": "postfx.interpolate",
    "BothWays": "postfx.passes.composite",
    "DenoiseUpscale": "postfx.passes.denoise",
    "Device": "postfx.runtime",
    "DeviceInterpolator": "postfx.interpolate.on_device",
    "Frame": "postfx.frame",
    "FrameSpec": "postfx.frame",
    "Interpolator": "postfx.interpolate",
    "Irradiance": "postfx.passes.scene",
    "Library": "postfx.runtime",
    "MixPartner": "postfx.passes.partner",
    "Occlusion": "postfx.passes.scene",
    "Oidn": "postfx.passes.oidn",
    "Overlay": "postfx.passes.composite",
    "Partner": "postfx.passes.partner",
    "Pipeline": "postfx.pipeline",
    "PostfxError": "postfx.errors",
    "Presenter": "postfx.presenter",
    "ROLES": "postfx.frame",
    "Role": "postfx.frame",
    "RenderSize": "postfx.passes.denoise.options",
    "RunUp": "postfx.temporal.reverse_order",
    "SceneShading": "postfx.passes.scene",
    "Sequence": "postfx.io.sequence",
    "ToneMap": "postfx.passes.tonemap",
    "denoise": "postfx.stills",
    "models_dir": "postfx.system",
    "read_sequence": "postfx.io.sequence",
    "write_frame": "postfx.io.writer",
}

__all__ = [
    "Backwards",
    "Between",
    "BothWays",
    "DenoiseUpscale",
    "Device",
    "DeviceInterpolator",
    "Frame",
    "FrameSpec",
    "Interpolator",
    "Irradiance",
    "Library",
    "MixPartner",
    "Occlusion",
    "Oidn",
    "Overlay",
    "Partner",
    "Pipeline",
    "PostfxError",
    "Presenter",
    "ROLES",
    "RenderSize",
    "Role",
    "RunUp",
    "SceneShading",
    "Sequence",
    "ToneMap",
    "denoise",
    "models_dir",
    "read_sequence",
    "write_frame",
    "__version__",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        # Python's own hint needs to know the module
        raise AttributeError(f"module 'postfx' has no attribute '{name}'", name=name,
                             obj=sys.modules[__name__])
    from postfx.workers import finished_before_the_end

    with finished_before_the_end():  # libraries in C++ come with it
        module = import_module(_HOMES[name])
    value = globals()[name] = getattr(module, name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})

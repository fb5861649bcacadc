"""Views: colour pipelines that turn exposed scene-linear Rec.709 into sRGB-encoded display colour, through OpenColorIO.

A view is a display and view of any OpenColorIO config, or a LUT file of any format that OpenColorIO reads.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache

import numpy as np

from postfx.colour import ACESCG, REC709, matrix_between
from postfx.colour.displays import KINDS
from postfx.colour.ocio import DISPLAYS, Transform, file_transform
from postfx.errors import ColourError
from training.tonemap.model import CUBE, lattice

ACES_CONFIG = "cg-config-v4.0.0_aces-v2.0_ocio-v2.5"  # built into OpenColorIO 2.5
ACES_LINEAR = "Linear Rec.709 (sRGB)"
BLENDER_CONFIG = "$BLENDER_OCIO"
SRGB = "srgb"
ONLY_SRGB = "looks are learnt for sRGB, and 'postfx run --display' shows them on others: give that for sRGB"
NO_BLENDER = (
    "this look is a view of Blender's OpenColorIO config: set BLENDER_OCIO to its datafiles/colormanagement/config.ocio"
    " (in an installed Blender, or in the wheel that 'pip download --no-deps bpy' gives)"
)


@dataclass(frozen=True)
class Ocio:
    """A display and view; `config` is a built-in config's name or a file, `source` its name of linear Rec.709."""

    config: str
    display: str
    view: str
    source: str = ""
    look: str = ""


@dataclass(frozen=True)
class Lut:
    """A look-up table as `postfx.colour.ocio.file_transform` names it: 'FILE,input=SPACE'."""

    file: str


View = Ocio | Lut
ACES2 = Ocio(ACES_CONFIG, "sRGB - Display", "ACES 2.0 - SDR 100 nits (Rec.709)")
AGX = Ocio(BLENDER_CONFIG, "sRGB", "AgX")
NEUTRAL = Ocio(BLENDER_CONFIG, "sRGB", "Khronos PBR Neutral")


def exact_view(view: View, rgb: np.ndarray) -> np.ndarray:
    """The view of (..., 3) exposed scene-linear Rec.709 by the pipeline itself; float32 in [0, 1]."""
    if isinstance(view, Lut):
        try:
            return _table(view).apply(rgb @ matrix_between(REC709, ACESCG).T).astype(np.float32)
        except ColourError as error:
            raise SystemExit(str(error)) from None
    out = np.ascontiguousarray(rgb, np.float32).reshape(-1, 1, 3).copy()
    _processor(view).applyRGB(out)
    return out.reshape(rgb.shape).clip(0.0, 1.0)


def bake(view: View, size: int = CUBE) -> np.ndarray:
    """The view at the corners of the tone mapper's cube: (size,size,size,3) float32 that half precision holds."""
    return exact_view(view, lattice(size)).astype(np.float16).astype(np.float32)


def _table(view: Lut) -> Transform:
    found = file_transform(view.file)
    if found.display.name != SRGB:
        raise SystemExit(f"{view.file}: is for {found.display.kind.title}: {ONLY_SRGB}")
    return found


@cache
def _processor(view: Ocio) -> object:
    import PyOpenColorIO as OCIO

    try:
        return _display(OCIO, view).getDefaultCPUProcessor()
    except OCIO.Exception as error:
        raise SystemExit(f"{view.config}: {error}") from None


def _config(ocio: object, name: str) -> object:
    """A built-in config by name, or one from a file."""
    if name in {entry[0] for entry in ocio.BuiltinConfigRegistry().getBuiltinConfigs()}:
        return ocio.Config.CreateFromBuiltinConfig(name)
    if name == BLENDER_CONFIG and "BLENDER_OCIO" not in os.environ:
        raise SystemExit(NO_BLENDER)
    try:
        return ocio.Config.CreateFromFile(os.path.expandvars(name))
    except ocio.Exception as error:
        raise SystemExit(f"{name}: {error}") from None


def _display(ocio: object, view: Ocio) -> object:
    shown = next((kind.title for name, kind in KINDS.items() if view.display in DISPLAYS[name] and name != SRGB), None)
    if shown:
        raise SystemExit(f"{view.display}: is for {shown}: {ONLY_SRGB}")
    config = _config(ocio, view.config)
    source = view.source or _linear_rec709(config)
    pipeline = ocio.LegacyViewingPipeline()
    pipeline.setDisplayViewTransform(ocio.DisplayViewTransform(source, view.display, view.view))
    if view.look:
        pipeline.setLooksOverrideEnabled(True)
        pipeline.setLooksOverride(view.look)
    return pipeline.getProcessor(config)


def _linear_rec709(config: object) -> str:
    """The config's name of linear Rec.709."""
    for name in (ACES_LINEAR, "lin_rec709", "Linear Rec.709", "Utility - Linear - sRGB", "lin_srgb"):
        if config.getColorSpace(name):
            return name
    raise SystemExit("the config has no linear Rec.709 under a usual name: give its name with --source")

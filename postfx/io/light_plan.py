"""How light becomes the picture of an OpenEXR file: decided once for all frames that are written
alike.

The frames of a sequence have the same planes, size, windows and header attributes. So the channels,
their types, their windows and the header are settled for the first one, and a plan is kept. A later
frame with the same key takes it: only what differs is written anew, such as a time code.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import OpenImageIO as oiio

from postfx.caching import LRUCache
from postfx.frame import Frame, Role
from postfx.io.encoder import display_of
from postfx.io.exr import Header
from postfx.io.exr.passthrough import enlargement_of, select_attributes
from postfx.io.exr.picture import PictureHeader, set_attributes, tag_light, type_of
from postfx.io.windows import WINDOW_ATTRIBUTES, output_windows
from postfx.version import __version__

ERROR_CHANNEL = "error.V"
OVERLAY_LAYER = ("overlay.R", "overlay.G", "overlay.B", "overlay.A")
MOST_LIGHT_PLANS = 32
"""That are kept: a sequence has one for each view, and for each kind of header that its frames
have."""
_CODING = ("dwaa", "dwab", "lj2k")
"""Compressions that alter colours."""
_ROUNDING = "b44"
"""How the names of compressions begin that alter all half floats."""
_CODED = ("r", "g", "b", "y", "ry", "by")
"""Last words of the names of colours' channels."""


def find_light_plan(frame: Frame, half: bool, compression: str,
                    provenance: Mapping[str, Any]) -> tuple[LightPlan, Header]:
    """The plan of a frame, and the header of its picture."""
    key = (
        frame.spec,
        tuple([tuple(frame.metadata.get(name, ())) for name in WINDOW_ATTRIBUTES]),
        tuple([(name, type_of(value, name)) for name, value in frame.metadata.items()]),
        tuple([(name, type_of(value, name)) for name, value in provenance.items()]),
        tuple(frame.part_sources.items()),
        half,
        compression,
    )
    plan = _LIGHT_PLANS.find(key)
    header = plan.header.tell(plan.given(frame, provenance)) if plan else None
    if plan is None or header is None:
        plan = _LIGHT_PLANS.keep(key, LightPlan(frame, half, compression, provenance, key))
        header = plan.header.tell(plan.given(frame, provenance))
    assert header is not None, "the plan is of this frame"
    return plan, header


class LightPlan:
    """How the light of frames is written that are alike.

    Attributes:
        windows: of the output.
        display: whose code values are decoded; None for light.
        planes: that are written behind the colour, in their order before the parts and behind them.
        parts: names of the parts that are written.
        names: of the channels, in the order of the pixels.
        kinds: what each channel belongs to, for messages.
        altered: which channels a compression alters so that NaN is lost, and infinity or NaN may be
            made of large light.
        header: of the picture, into which a frame's own values are put.
        half: whether channels are half floats.
        compression: as `write_frame` has it.
        is_enlarged: whether frames have another size than their input.
        key: what these frames have in common.
    """

    def __init__(self, frame: Frame, half: bool, compression: str,
                 provenance: Mapping[str, Any], key: object) -> None:
        self.half, self.compression, self.key = half, compression, key
        self.windows, self.display = output_windows(frame), display_of(frame)
        self.is_enlarged = enlargement_of(frame) is not None

        # Beside light of the scene also what it is composited with, and the parts that add up to
        # it.
        is_of_scene = frame.encoding == "scene-linear"
        alpha = (Role.ALPHA,) if Role.ALPHA in frame else ()
        overlay = (Role.OVERLAY,) if Role.OVERLAY in frame and is_of_scene else ()
        error = (Role.ERROR,) if Role.ERROR in frame else ()
        self.planes = (*alpha, *overlay), error
        self.parts = tuple(sorted(frame.parts)) if is_of_scene else ()
        further = (*(OVERLAY_LAYER if overlay else ()), *_name_parts(frame, self.parts),
                   *((ERROR_CHANNEL,) if error else ()))
        self.names = ("R", "G", "B", *(("A",) if alpha else ()), *further)
        self.kinds = [*("light",) * 3, *("alpha",) * len(alpha),
                      *(name.rpartition(".")[0] or name for name in further)]
        self.altered = _find_altered(self.names, half, compression)

        # The header. Its attributes may have other values in a later frame.
        spec = oiio.ImageSpec(self.windows.data.width, self.windows.data.height, len(self.names),
                              "half" if half else "float")
        spec.channelnames = self.names
        spec.x, spec.y, full = self.windows.data.x0, self.windows.data.y0, self.windows.display
        spec.full_x, spec.full_y, spec.full_width, spec.full_height = (full.x0, full.y0, full.width,
                                                                       full.height)
        selected = select_attributes(frame)
        set_attributes(spec, selected)
        if self.display:
            tag_light(spec, self.display.kind.primaries, self.display.white)
        spec.attribute("compression", compression)
        self._selected = [name for name, value in selected.items() if type_of(value, name)]
        given = self.given(frame, provenance)
        set_attributes(spec, {name: given[name] for name in (_VERSION, *provenance)})
        self.header = PictureHeader(spec, given)

    def given(self, frame: Frame, provenance: Mapping[str, Any]) -> dict[str, Any]:
        """The attributes of a frame's header that frames have values of their own of."""
        selected = {name: frame.metadata[name] for name in self._selected}
        return {**selected, _VERSION: __version__, **provenance}


_VERSION = "postfx:version"
_LIGHT_PLANS: LRUCache[object, LightPlan] = LRUCache(MOST_LIGHT_PLANS)


def _name_parts(frame: Frame, parts: tuple[str, ...]) -> list[str]:
    """Channels of parts, under the names that they had."""
    names: list[str] = []
    for name in parts:
        source, count = frame.part_sources.get(name), frame.parts[name].shape[2]
        letters = ("V",) if count == 1 else ("R", "G", "B")
        names += source.channels if source else [f"{name}.{letter}" for letter in letters]
    return names


def _find_altered(names: tuple[str, ...], half: bool, compression: str) -> np.ndarray:
    if compression.startswith(_ROUNDING):
        return np.full(len(names), half)
    return np.array([compression.startswith(_CODING)
                     and name.lower().rpartition(".")[2] in _CODED for name in names])

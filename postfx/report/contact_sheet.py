"""A frame's planes as small pictures on a page."""

from __future__ import annotations

from typing import Any

import numpy as np

from postfx.doctor.pictures import picture
from postfx.frame import Frame, Role
from postfx.report.pictures import png_uri, reduced

LONGEST = 480


def contact_sheet(frame: Frame) -> list[dict[str, Any]]:
    """Of each plane and guide its 'name', 'src' (a data URI, at most 480 pixels wide or high) and 'size'."""
    planes = {str(role): _entry(plane, role) for role, plane in frame.planes.items()}
    planes |= {f"guide {role}": _entry(plane, role) for role, plane in frame.guides.items()}
    return [{"name": name, **entry} for name, entry in planes.items()]


def _entry(plane: np.ndarray, role: Role) -> dict[str, Any]:
    pixels = np.rint(reduced(picture(plane, role), LONGEST)).astype(np.uint8)
    return {"src": png_uri(pixels), "size": plane.shape[1::-1]}

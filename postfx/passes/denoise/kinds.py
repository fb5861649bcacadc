"""The kinds of parts, as a table: how each differs from light while it is filtered."""

from __future__ import annotations

from dataclasses import dataclass

from postfx.frame import ALBEDOS, Role
from postfx.planes import LARGEST_FLOAT


@dataclass(frozen=True)
class Kind:
    """One kind of parts.

    Attributes:
        divided: reflectance that it is divided by while it is filtered.
        is_seen: whether it is there only where it, or in files the colour that it is divided by,
            shows light.
        is_sparse: whether such light misses pixels by chance.
        on_surface: whether it comes from the surface that the frame's planes show.
        span: values that become 0 and 1 while it is filtered; None: the frame's least and largest.
        bounds: of the values that leave.
        is_detailed: whether its detail is like light's, so that it can come back.
        stays: whether a point keeps its value when the camera moves; others have no history.
        are_vectors: whether they have length 1.
        are_distances: whether their reciprocals are filtered, and separately which pixels have one.
        is_filtered: else it is only brought to the output's size.
    """

    divided: tuple[Role, ...] = ()
    is_seen: bool = False
    is_sparse: bool = False
    on_surface: bool = True
    span: tuple[float, float] | None = (0.0, 1.0)
    bounds: tuple[float, float] = (0.0, LARGEST_FLOAT)
    is_detailed: bool = True
    stays: bool = True
    are_vectors: bool = False
    are_distances: bool = False
    is_filtered: bool = True

    @property
    def is_like_picture(self) -> bool:
        """Whether it has all of the picture's reflectance."""
        return self.divided == ALBEDOS


LIGHT_KIND = Kind(divided=ALBEDOS)
KINDS = {
    "light": LIGHT_KIND,
    "diffuse": Kind(divided=(Role.DIFFUSE_ALBEDO,), is_seen=True, is_sparse=True),
    "specular": Kind(divided=(Role.SPECULAR_ALBEDO,), is_seen=True, is_sparse=True),
    "scatter": Kind(on_surface=False),
    "emission": Kind(is_seen=True),
    "albedo": Kind(),
    "normal": Kind(span=(-1.0, 1.0), bounds=(-1.0, 1.0), is_detailed=False, are_vectors=True),
    "position": Kind(span=None, bounds=(-LARGEST_FLOAT, LARGEST_FLOAT), is_detailed=False,
                     stays=False),
    "depth": Kind(is_detailed=False, stays=False, are_distances=True),
    "mist": Kind(bounds=(0.0, 1.0)),
    "shadow": Kind(),
    "ao": Kind(),
    "factor": Kind(is_filtered=False)}

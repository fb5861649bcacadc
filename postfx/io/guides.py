"""Guides, planes at output size: among a frame's own files, or in files of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from postfx.errors import GuideError, MissingPlaneError
from postfx.frame import OUTPUT_SIZE_ROLES, GuideSpec, Role
from postfx.io.convert import Camera
from postfx.io.layout import Header, Layout, Match


@dataclass
class GuideLayout:
    """Where the guides of a frame are, and what the header of their file says about the camera."""

    path: Path
    planes: dict[Role, Match]
    camera: Camera

    def __post_init__(self) -> None:
        if len({match.size for match in self.planes.values()}) > 1:
            sizes = ", ".join(f"{role} {match.size[0]}x{match.size[1]}" for role, match in self.planes.items())
            raise GuideError(f"{self.path}: guides differ in size: {sizes}: render them at one size, the output's")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return next(iter(self.planes.values())).size

    def spec(self) -> GuideSpec:
        """Size and roles."""
        return GuideSpec(*self.size, tuple(self.planes), str(self.path))


def larger_planes(layout: Layout) -> GuideLayout | None:
    """Planes larger than the colour, taken out of the layout; None when there are none.

    They are guides when the same file set holds the colour at render size.
    """
    if Role.COLOUR not in layout.planes:
        return None
    size = layout.planes[Role.COLOUR].size
    found = {role: layout.planes[role] for role in OUTPUT_SIZE_ROLES if _is_larger(layout.planes.get(role), size)}
    if not found:
        return None
    for role in found:
        del layout.planes[role]
    first = next(iter(found.values())).channels[0]
    jitter = Header(replace(layout, attributes=first.part.attributes)).camera().jitter
    return GuideLayout(first.file.path, found, replace(layout.camera, jitter=jitter))


def drop_smaller_planes(layout: Layout) -> None:
    """Take planes that are smaller than the colour out of the layout, where the colour is a picture that postfx wrote:
    they are the render's, kept beside it."""
    colour = layout.planes.get(Role.COLOUR)
    if colour is None or not colour.channels[0].part.is_picture:
        return
    smaller = [role for role, match in layout.planes.items() if match.size[0] < colour.size[0]]
    for role in smaller:
        del layout.planes[role]
    if smaller:
        layout.warnings.append(f"planes {', '.join(smaller)} are of the render before it was enlarged: not read")


def planes_that_guide(layout: Layout, path: Path) -> GuideLayout:
    """Guides out of files of their own. Raises MissingPlaneError when they hold none."""
    found = {role: layout.planes[role] for role in OUTPUT_SIZE_ROLES if role in layout.planes}
    if not found:
        raise MissingPlaneError(
            f"{path}: holds none of the planes that guide ({', '.join(OUTPUT_SIZE_ROLES)}) by profile "
            f"{layout.profile.name}: render one of them, or name it in a profile (--profile FILE.toml)"
        )
    return GuideLayout(path, found, layout.camera)


def _is_larger(match: Match | None, size: tuple[int, int]) -> bool:
    return match is not None and match.size != size and match.size[0] >= size[0] and match.size[1] >= size[1]

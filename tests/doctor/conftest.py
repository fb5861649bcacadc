"""Frames of unbroken sequences, and what the doctor says of frames."""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from postfx.doctor import Finding
from postfx.doctor.inspection import examine
from postfx.doctor.material import Material
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence

ROOM = Path(__file__).parent.parent.parent / "samples" / "room"
FRAMES = "1-5"


@cache
def frames_of(folder: Path) -> tuple[Frame, ...]:
    return tuple(read_sequence(folder / "noisy.####.exr", frames=FRAMES))


def middle_of(frame: Frame, width: int, height: int) -> Frame:
    """The middle of a picture, seen by the same camera with a smaller field of view."""
    top, left = (frame.spec.height - height) // 2, (frame.spec.width - width) // 2
    planes = {role: np.ascontiguousarray(plane[top : top + height, left : left + width])
              for role, plane in frame.planes.items()}
    part = width / frame.spec.width
    fov_x = (frame.fov_x
             and float(2 * np.degrees(np.arctan(part * np.tan(np.radians(frame.fov_x) / 2)))))
    return replace(frame, planes=planes, fov_x=fov_x)


COLOUR, DEPTH, MOTION, NORMAL = Role.COLOUR, Role.DEPTH, Role.MOTION, Role.NORMAL
ALBEDO, SPECULAR = Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO
USED = {
    "fit_rotation": (DEPTH, NORMAL), "fit_depth_kinds": (DEPTH, NORMAL),
    "explain_by_camera": (DEPTH, NORMAL),
    "surface_normals": (DEPTH, NORMAL), "_is_averaged": (DEPTH, NORMAL), "unit_normals": (NORMAL,),
    "normals_of_depth": (DEPTH,), "fit_depth_scale": (DEPTH, MOTION),
    "find_movers": (ALBEDO, SPECULAR, NORMAL, MOTION),
    "fit_roughness": (SPECULAR, DEPTH, Role.ROUGHNESS, NORMAL),
    "measure_slopes": (COLOUR, ALBEDO, NORMAL, DEPTH), "_repeated": (COLOUR, ALBEDO, MOTION),
    "_identical": (COLOUR,), "prepare_plane": (), "_feature": (), "_errors_of_variants": (),
    "smooth_points": (), "noise_level": (),
    "_edges": (), "_enlarged_how": (), "_extremes": (), "_reflectance": (),
}
"""What the doctor computes of planes and the header alone, and of which planes; else of those that
are given."""


def _key(value: object, roles: tuple[Role, ...]) -> object:
    if isinstance(value, Frame):
        matrix = None if value.world_to_camera is None else value.world_to_camera.tobytes()
        planes = tuple(id(value.planes[role]) if role in value else None for role in roles)
        return (planes, value.jitter, value.fov_x, matrix, value.reset,
                str(value.metadata.get("pixelAspectRatio")))
    if isinstance(value, np.ndarray):  # a window of a plane is another array over the same memory
        return value.__array_interface__["data"][0], value.shape, value.strides
    if isinstance(value, tuple | list):
        return tuple(_key(one, roles) for one in value)
    return value if isinstance(value, str | float | int | None) else id(value)


@pytest.fixture
def same_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What follows from the same planes is computed once for all that a test diagnoses, as it
    breaks one at a time."""
    for name, roles in USED.items():
        # arguments are kept, so that no other plane gets their place
        seen: dict[object, tuple[object, object]] = {}

        def once(*arguments, function=None, roles=roles, seen=seen):
            roles = roles or tuple(argument for argument in arguments if isinstance(argument, Role))
            key = _key(arguments, roles)
            if key not in seen:
                seen[key] = function(*arguments), arguments
            return seen[key][0]

        for module in [module
                       for path, module in sys.modules.items() if path.startswith("postfx.doctor")]:
            if hasattr(module, name):
                monkeypatch.setattr(module, name, partial(once, function=getattr(module, name)))


@pytest.fixture(scope="session")
def room() -> list[Frame]:
    """Five frames of the sample."""
    return list(frames_of(ROOM))


@pytest.fixture
def shared_frames(shared_dir: Path) -> Callable[[str], list[Frame]]:
    """Five frames of a sequence that other software rendered, by name."""
    return lambda name: list(frames_of(shared_dir / "sequences" / name))


@pytest.fixture
def diagnose() -> Callable[[list[Frame]], list[Finding]]:
    """Findings of frames."""
    return lambda frames: examine(Material(frames))

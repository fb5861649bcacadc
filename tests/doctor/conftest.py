"""Frames of unbroken sequences, and what the doctor says of frames."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from postfx.doctor import examine
from postfx.doctor.findings import Finding
from postfx.doctor.material import Material
from postfx.frame import Frame
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
    fov_x = frame.fov_x and float(2 * np.degrees(np.arctan(part * np.tan(np.radians(frame.fov_x) / 2))))
    return replace(frame, planes=planes, fov_x=fov_x)


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

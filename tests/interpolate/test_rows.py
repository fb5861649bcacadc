"""Kernels of frames between frames: the same bits at every level of the processor, whatever they
are given."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from postfx import Between
from postfx.compiled import build, library
from postfx.compiled.library import Rows
from postfx.frame import Frame, Role
from postfx.interpolate import blend, choose, paths, timing
from postfx.motion import flow
from postfx.motion.estimated import motion_of
from postfx.runtime import Device
from postfx.temporal.reverse_motion import HistoryLength, premultiply, share_by_length
from postfx.tools.bench.baselines import Accumulator, HostKernels
from tests.conftest import REPOSITORY

SOURCES = [*sorted((build.KERNELS / "interpolate").glob("*.cpp")), build.KERNELS / "accumulate.cpp"]
NAMES = [name for source in SOURCES
         for name in re.findall(r"^EXPORT\((\w+),", source.read_text("utf-8"), re.M)]
SPREADING = {"search_flow", "spread_flow", "enlarge_flow", "find_overlay", "fill_holes",
             "estimate_average", "estimate_sample", "sum_sparks", "grow_marks"}
"""Kernels of which one number may change many others: motion spreads from patch to patch, and so
on."""
MOST_CHANGED = 1000
"""Numbers of one result that three bad ones may change: pixels that read a cell or a window around
one."""
pytestmark = pytest.mark.usefixtures("every_level")
FUSED = [level for level in library.levels() if level != "baseline"] or ["baseline"]
Call = tuple[int, int, list[np.ndarray]]


def frames(count: int) -> list[Frame]:
    """A square over a wall that stands still at the bottom, with sparks, a label that is burnt in,
    and every plane."""
    height, width = 66, 82
    y, x = np.indices((height, width)).astype(float)
    made = []
    for n in range(count):
        wall = np.stack([np.exp(np.sin(0.4 * (x + 3 * n) + k) * np.sin(0.3 * (y - n)))
                         for k in range(3)], -1)
        there = (np.abs(x - 30 - 6 * n) < 12) & (np.abs(y - 25 - 2 * n) < 9)
        still = y > 56
        colour = np.where(there[..., None], 3 + np.sin(x + y)[..., None], wall)
        colour[still] = 1 + 0.1 * n + 0.2 * np.sin(x)[still][:, None]
        motion = np.where(there[..., None], (-6.0, -2.0), (3.0, -1.0)) * ~still[..., None]
        for k in range(3):
            colour[np.hypot(y - 15 - 3 * n, x - 60 + 20 * k - 2 * n) < 1.5] = 900
        colour[3:8, 4:20] = np.where(np.arange(16) % 5 < 2, 0.9, 0.1)[:, None]
        motion[np.random.default_rng(n).random((height, width)) < 0.02] = 1e10
        depth = np.where(there, 2.0, 9.0)
        planes = {Role.COLOUR: colour, Role.MOTION: motion, Role.DEPTH: depth[..., None],
                  Role.ALPHA: there[..., None] * 1.0, Role.NORMAL: wall / 3,
                  Role.DIFFUSE_ALBEDO: np.clip(colour, 0, 1),
                  Role.SPECULAR_HIT_DISTANCE: (x > 50)[..., None] * 3.0}
        made.append(Frame({role: np.ascontiguousarray(plane, np.float32)
                           for role, plane in planes.items()},
                          number=n + 1))
    return made


@pytest.fixture(scope="module")
def calls() -> dict[str, list[Call]]:
    """What each kernel is called with, at most twice, while frames are made."""
    found: dict[str, list[Call]] = {}
    bind = Rows.bind

    def keep(rows: Rows, first: int, last: int, arrays: Sequence[np.ndarray]) -> None:
        if rows.name in NAMES and len(found.setdefault(rows.name, [])) < 2:
            found[rows.name].append((first, last, [array.copy() for array in arrays]))

    def watched(rows: Rows, arrays: Sequence[np.ndarray]) -> Any:
        bound = bind(rows, arrays)
        # the others write as many rows as they work on
        picture = {"compose": 1, "tone_rows": 0}.get(rows.name)
        last = (next(len(one) for one in reversed(arrays) if len(one)) if picture is None
                else len(arrays[picture]))
        keep(rows, 0, last, arrays)
        return bound

    def watched_call(rows: Rows, first: int, last: int, *arrays: np.ndarray) -> None:
        keep(rows, first, last, arrays)
        bind(rows, arrays)(first, last)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Rows, "bind", watched)
        patch.setattr(Rows, "__call__", watched_call)
        shown = frames(4)
        before = Between(*shown[:3])
        before.frame(0.25)
        Between(*shown[1:], last=before).frame(0.6)
        Between(*(Frame({Role.COLOUR: frame[Role.COLOUR]}) for frame in shown[:2])).frame(0.5)
        lengths = HistoryLength()
        first, second = [lengths(frame) for frame in shown[:2]]
        share = np.empty(first.shape, np.float32)
        share_by_length(first, second, share)
        premultiply(share, shown[0][Role.COLOUR], np.empty((*share.shape, 4), np.float32))
        motion_of(shown[1], shown[0])
        accumulator = Accumulator(HostKernels(Device("cpu", threads=1)))
        for frame in shown[:2]:
            accumulator(frame[Role.COLOUR], frame)
    return found


def written(name: str, level: str, call: Call) -> list[np.ndarray]:
    """Arrays after a call at a level."""
    first, last, arrays = call
    copies = [array.copy() for array in arrays]
    Rows(name, level=level)(first, last, *copies)
    return copies


def test_every_kernel_has_its_turn(calls: dict[str, list[Call]]) -> None:
    missing = {*NAMES} - {*calls}
    assert missing <= {"estimate_put", "estimate_move", "estimate_sample"}, missing
    assert len(NAMES) == len({*NAMES}) > 40


@pytest.mark.parametrize("name", NAMES)
def test_every_level_gives_the_same_bits_whatever_is_given(name: str,
                                                           calls: dict[str, list[Call]]) -> None:
    for first, last, arrays in calls.get(name, []):
        clean = written(name, FUSED[0], (first, last, arrays))
        planes = [k for k, array in enumerate(arrays)
                  if array.dtype == np.float32 and array.size > 400]
        for bad, value in [(None, 0.0),
                           *((k, value) for k in planes for value in (np.nan, np.inf, -np.inf))]:
            given = [array.copy() for array in arrays]
            if bad is not None:
                given[bad].reshape(-1)[np.random.default_rng(1)
                                       .integers(0, given[bad].size, 3)] = value
            wanted = written(name, FUSED[0], (first, last, given))
            for level in FUSED[1:]:
                for one, other in zip(written(name, level, (first, last, given)), wanted,
                                      strict=True):
                    np.testing.assert_array_equal(one, other, f"{level} {bad} {value}")
            for k, (one, other) in enumerate(zip(wanted, clean, strict=True)):
                if name not in SPREADING and k != bad:
                    same = (one == other if one.dtype.kind != "f"
                            else (one == other) | np.isnan(one) & np.isnan(other))
                    assert (~same).sum() <= MOST_CHANGED, f"{bad} {value} {k}"


def test_constants_of_the_kernels_are_those_of_python() -> None:
    checked = 0
    modules = {module.__name__.rpartition(".")[2]: module
               for module in (blend, choose, flow, paths, timing)}
    for source in (build.KERNELS / "interpolate").glob("*.[hc]*"):
        module = modules.get(source.stem)
        text = source.read_text("utf-8")
        for name, value in re.findall(r"^constexpr (?:float|int) ([A-Z_]+) = (-?[\d.e+-]+)f?;",
                                      text, re.M):
            known = getattr(module, name, None)
            if isinstance(known, int | float | np.number):
                assert np.float32(value) == np.float32(
                    known
                ), f"{source.relative_to(REPOSITORY)}: {name}"
                checked += 1
    assert checked > 35

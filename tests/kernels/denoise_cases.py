"""Random arguments for the upscaler's kernels, and a way to run a kernel on a device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from postfx.kernels import Kernel
from postfx.kernels.denoise import BLEND, FINE, GUIDE_PLANES, MEMORY, MIRRORED_PLANES, NEAR_CELL
from postfx.kernels.denoise.alpha import CORRECT, FIT, GATHER
from postfx.kernels.denoise.classic import ATROUS, RESOLVE
from postfx.kernels.denoise.classic import GATHER as CLASSIC_GATHER
from postfx.kernels.denoise.features import FEATURE, GUIDE, MIRROR, TRUST
from postfx.kernels.denoise.history import HISTORY, KEEP, REACTIVE, REFLECTIONS, RESIZE, SPREAD_MASK
from postfx.kernels.denoise.network_io import (
    OPEN,
    OPEN_ERROR,
    OPEN_FINE,
    OPEN_FINE_PRODUCTS,
    OPEN_PHASED,
    OPEN_PRODUCTS,
    PACK,
    STORE,
    STORE_RINGED,
)
from postfx.kernels.denoise.output import ASSEMBLE, DETAIL, JUDGE, RESTORE, STRENGTH
from postfx.kernels.denoise.parts import (
    ACCUMULATE_PART,
    BALANCE,
    DECODE,
    DECODE_ONE,
    REFLECT,
    UPSAMPLE_LIGHT,
)
from postfx.kernels.denoise.prepare import ACCUMULATE, DILATE, MEANS, SCALE, means_size
from postfx.kernels.denoise.pyramid import (
    ENLARGE_ALPHA,
    FILTER,
    LEVEL,
    MIX_LEVELS,
    POOL,
    REMODULATE,
    REMODULATE_BOTH,
)
from postfx.kernels.denoise.upsample import (
    BLEND_PICTURE,
    UPSAMPLE,
    UPSAMPLE_GUIDED,
    UPSAMPLE_UNSCALED,
)
from postfx.kernels.image import ENLARGE_OVERLAY, OVER, OVER_ALPHA, RESAMPLE, positions
from postfx.kernels.partner import ENLARGE_MOTION, MIX_PARTNER
from postfx.passes.denoise.geometry import Size, Sizes, Window
from postfx.runtime import ArgumentTable, Device
from postfx.runtime.states import parse

KERNELS = (
    SCALE, DILATE, HISTORY, FEATURE,
    GUIDE, MIRROR, TRUST, ACCUMULATE, POOL,
    MIX_LEVELS, REMODULATE_BOTH, MEANS,
    FILTER, REMODULATE, UPSAMPLE, UPSAMPLE_GUIDED, UPSAMPLE_UNSCALED, BLEND_PICTURE,
    RESIZE, REFLECTIONS, JUDGE, DETAIL,
    RESTORE, STRENGTH, RESAMPLE, REACTIVE,
    SPREAD_MASK, KEEP, ENLARGE_OVERLAY, OVER, OVER_ALPHA, ASSEMBLE,
    PACK, OPEN, OPEN_FINE, OPEN_PHASED, OPEN_ERROR,
    OPEN_PRODUCTS, OPEN_FINE_PRODUCTS, STORE,
    STORE_RINGED,
    REFLECT, ACCUMULATE_PART, UPSAMPLE_LIGHT, BALANCE, GATHER, LEVEL, ENLARGE_ALPHA, FIT, CORRECT,
    DECODE, DECODE_ONE,
    MIX_PARTNER, ENLARGE_MOTION,
)
IN_ROWS_ALONE = (CLASSIC_GATHER, ATROUS, RESOLVE)
"""Kernels without a portable definition."""
MOST_CODE = 255
BAD = (np.nan, np.inf, -np.inf, -3.0, 3e38)
FRAME = ("colour", "part", "diffuse_albedo", "specular_albedo", "normal", "roughness", "depth",
         "motion", "last_depth",
         "image", "strength", "reactive", "opaque_colour", *GUIDE_PLANES, *MIRRORED_PLANES)


class Case(NamedTuple):
    """Sizes of a run; `heads` are the channels of the network's output that the filter kernels look
    at, `part` the first row and column, height and width of the part of the frame that is worked
    on, None for all of it."""

    h: int
    w: int
    height: int
    width: int
    heads: int = FINE
    part: tuple[int, int, int, int] | None = None

    @property
    def window(self) -> Window:
        grid = 4 if self.part and (self.part[0] | self.part[1]) % 16 else 16
        sizes = Sizes(Size(self.h, self.w), Size(self.height, self.width), grid)
        return Window(sizes, *(self.part or (0, 0, self.h, self.w)))

    @property
    def second(self) -> int:
        """1 where cells of the pyramid begin before the part, in both directions."""
        return self.h % 2

    def sizes(self) -> dict[str, int]:
        """Value of every symbol in the kernels' shapes."""
        window = self.window
        hp, wp = window.padded_size
        return {**self._asdict(), "hp": hp, "wp": wp, "half_hp": hp // 2, "half_wp": wp // 2,
                "finer_h": 2 * hp - self.second - self.h % 3,
                "finer_w": 2 * wp - self.second - self.w % 3,
                "coarse_h": hp // 2 + self.second, "coarse_w": wp // 2 + self.second,
                "ringed_hp": hp + 2, "ringed_wp": wp + 2, "th": window.rows, "tw": window.columns,
                "out_th": window.out.rows, "out_tw": window.out.columns,
                "padded_h": window.rows + 2, "padded_w": window.columns + 2, "channels": 4,
                "wide": 8, "controls": FINE,
                "tiles": 3, "parts": 1 + self.w % 3, "planes": (1, 3, 6)[self.w % 3],
                **dict.fromkeys(("reached_h", "reached_w"), 1 if self.h % 2 else 9),
                "near_h": 1 if self.w % 3 == 2 else -(-self.h // NEAR_CELL),
                "near_w": 1 if self.w % 3 == 2 else -(-self.w // NEAR_CELL),
                **self._one_or_all("motion", self.h % 2),
                **self._one_or_all("weight", self.h % 3 == 0),
                **self._one_or_all("strength", self.w % 2),
                **{f"level{i}_{side}": size for i in range(1, 5)
                   for side, size in zip("hw", window.level(i), strict=True)},
                "alpha_h": -(-self.h // NEAR_CELL), "alpha_w": -(-self.w // NEAR_CELL),
                "tile_h": window.rows, "tile_w": window.columns, "rows": self.h, "columns": self.w,
                "cells_h": -(-window.rows // 8), "cells_w": -(-window.columns // 8),
                **dict(zip(("means_h", "means_w"), means_size(window.rows, window.columns),
                           strict=True)),
                "tiles_high": -(-self.h // 16), "tiles_wide": -(-self.w // 16),
                **self._keep(window)}

    def _one_or_all(self, name: str, one: int) -> dict[str, int]:
        """Sizes of a plane of the output, or of one pixel that stands for all."""
        return {f"{name}_h": 1 if one else self.height, f"{name}_w": 1 if one else self.width}

    def _keep(self, window: Window) -> dict[str, int]:
        """One number for all pixels in half of the cases."""
        return ({"keep_h": 1, "keep_w": 1} if self.h % 2
                else {"keep_h": window.rows, "keep_w": window.columns})

    def __str__(self) -> str:
        return "-".join(map(str, (f"{self.h}x{self.w}", f"{self.height}x{self.width}", self.heads,
                                  *(self.part or ()))))


ODD = Case(45, 77, 90, 154)
CASES = (Case(64, 64, 128, 128), ODD, Case(33, 47, 89, 127), Case(34, 66, 51, 99, 26),
         Case(51, 30, 153, 90, 25),
         Case(3, 40, 4, 52), Case(1, 1, 2, 2), Case(90, 120, 180, 240, part=(48, 64, 48, 64)),
         Case(75, 91, 113, 137, part=(44, 4, 32, 88)))
"""Twice as large, from even and odd sizes; at any scale; without the fine head's channels; narrow;
one pixel; parts that end beyond the frame, with first rows and columns that differ."""


def runs_of(kernel: Kernel) -> list[tuple[Case, bool]]:
    """Cases of a kernel, each with clean planes and with bad ones."""
    mixes = "coarse" in kernel.reads
    return [(case, bad) for case in CASES if not mixes or case.heads > 25 for bad in (False, True)]


def case_for(kernel: Kernel, case: Case) -> Case:
    """The case, with an output of the render size for the kernel that runs only there."""
    unscaled = kernel.name.startswith((UPSAMPLE_UNSCALED.name, BLEND_PICTURE.name))
    return case._replace(height=case.h, width=case.w) if unscaled else case


def shape(kernel: Kernel, binding: str, case: Case) -> tuple[int, ...]:
    """Shape of a binding in a case."""
    case = case_for(kernel, case)
    dims = [parse(size) for size in kernel.shapes[binding]]
    return tuple(dim.factor * (case.sizes()[dim.symbol] if dim.symbol else 1) for dim in dims)


def arguments(kernel: Kernel, case: Case, seed: int = 0,
              bad: bool = False) -> dict[str, np.ndarray]:
    """Arguments that a kernel reads, with the ranges of real ones; `bad` puts values into the frame
    that no file should hold."""
    case = case_for(kernel, case)
    random = np.random.default_rng([seed, *case[:5], *(case.part or ())])
    values = {name: _value(name, shape(kernel, name, case), case, random) for name in kernel.reads}
    if "near" in kernel.writes:  # alike in some areas
        (h, w, _), alpha = values["alpha"].shape, values["alpha"]
        areas = (random.random((-(-h // 20), -(-w // 20), 1)).repeat(20, axis=0)
                 .repeat(20, axis=1)[:h, :w])
        values["alpha"] = np.where(areas > 0.5, alpha, areas > 0.2)
    for name in set(FRAME) & values.keys() if bad else ():
        flat = values[name].reshape(-1)
        flat[random.integers(0, flat.size,
                             max(1, flat.size // 9))] = random.choice(BAD, max(1, flat.size // 9))
    return {name: np.ascontiguousarray(value, element_type(kernel, name))
            for name, value in values.items()}


def element_type(kernel: Kernel, binding: str) -> str:
    return kernel.types.get(binding, "float32")


def _value(name: str, size: tuple[int, ...], case: Case, random: np.random.Generator) -> np.ndarray:
    unit = random.random(size)
    if name in ("fine", "heads"):
        gates = np.arange(size[1])[:, None, None]
        wide = np.exp(4 * unit - 2)
        return np.where(gates < BLEND, wide, np.where(gates < MEMORY, unit, 2 * unit - 1))
    if name == "params":  # at the render size half of the cases have no jitter
        jitter = random.uniform(-0.5, 0.5, 2) * ((case.h, case.w) != (case.height, case.width)
                                                 or case.w % 2)
        return np.array([1.7, *jitter, 0.8])
    if name == "step":  # of the classical filter
        return np.array([(1, 2, 16)[case.h % 3]])
    if name == "surface":
        return np.concatenate((2 * unit[:3] - 1, unit[3:4], unit[4:] - 0.5))
    if name == "means":  # one cell where planes are not doubted
        return unit[:1, :1] if case.h % 2 else unit
    if name in ("raw", "raw_fine", "phased_fine"):
        return random.normal(0, 4, size)
    if name == "log_error":
        return 18 * unit - 16
    if name == "products":
        return random.normal(0, 400, size)
    if name == "scaling":
        return np.stack([0.005 + 0.01 * unit[0], 4 * unit[1] - 2])
    if name == "coding" and len(size) > 1:  # half of the channels have negative values, too
        return np.where(np.arange(size[1]) % 2, [[MOST_CODE // 2], [MOST_CODE // 2 + 1]],
                        [[MOST_CODE], [0]])
    if name == "planes":
        return 3 * unit - 1
    if name == "area":
        return np.array([min(case.window.rows, case.h - case.window.top),
                         min(case.window.columns, case.w - case.window.left)])
    if name == "firsts":
        rows, columns = zip(*map(case.window.finer, range(1, 5)), strict=True)
        return np.array([places[0] for places in (*rows, *columns)])
    if name in ("finer_rows", "finer_columns"):
        return 2 * np.arange(size[0]) - case.second
    if name in ("coarse_rows", "coarse_columns"):
        return (np.arange(size[0]) + case.second) // 2
    if name in (places := case.window.places()):
        return places[name]
    if name == "places":
        return _places(case, random)
    if name in ("frame_rows", "frame_columns"):
        return 3 + np.arange(size[0])
    if name in ("rows", "at_rows"):
        return positions(case.h, case.height, 0.3)
    if name == "columns":
        return positions(case.w, case.width, -0.4)
    if name == "at_columns":  # beyond either side
        return positions(case.w, case.width, 0.4 if case.h % 2 else -0.4)
    if name == "radiance":
        return np.pad(20 * unit[:, 1:-1, 1:-1] ** 3, ((0, 0), (1, 1), (1, 1)), "edge")
    if name in ("motion", "moved"):  # every eighth column is still
        return random.normal(0, 3, size) * (np.arange(size[1]) % 8 > 0)[:, None]
    if name in ("normal", "guide_normal", "denoising_normal"):
        return 2 * unit - 1
    if name in ("depth", "last_depth", "guide_depth"):
        return np.where(random.random(size) < 0.05, 1e10, 1 + 9 * unit)
    if name in ("history", "warped", "picture"):
        return 5 * unit**3
    if name == "sums":
        # neither faint nor loud; between filtered or not; and loud or not
        power = (4.0, 0.18, 32.0, 4.0)[case.h % 4]
        counted = np.concatenate((256 + 0 * unit[..., :1], power * unit[..., 1:2] ** 4,
                                  unit[..., 2:]), -1)
        # where nothing is judged, all are 0
        return counted * (unit[..., :1] > (0.3 if case.h % 3 == 0 else -1))
    if name == "judged":
        return unit > (0.3 if case.h % 3 == 0 else -1)
    if name == "difference":
        return np.array([1.7, 3.0, 0.1])
    if name in ("reactive", "last_reactive", "keep"):  # whole numbers, too
        return np.clip(2 * unit - 0.5, 0, 1)
    if name == "coding":  # of a part: half of them light, others with values below 0
        return np.array([-1.0, 0.5, 1.5] if case.h % 2 else [0.0, 1.0, 1e4])
    if name == "decoding":  # of distances, other values and vectors
        return np.array([-1.0, -1e10, 0.5, 2.0, -1.0] if case.h % 3 == 0
                        else [2.0, -1.0, -0.8, 0.9, case.h % 3 - 1])
    if name == "near":  # cells that are worked on, and those around them
        found = np.pad(unit > (0.5 if size == (1, 1) else 0.8), 1)
        around = np.max([found[j:j + size[0], i:i + size[1]] for j in range(3) for i in range(3)],
                        axis=0)
        return found[1:-1, 1:-1] + 1.0 * around
    if name == "reached":
        return np.ones(size) if size[1] == 1 else unit > 0.3
    if name == "complete":
        return np.array([case.w % 3 - 1])
    if name == "settings":  # of a mixture: half of the cases have a history
        return np.array([1.7, 0.5, case.w % 2, 0.8 if case.h % 2 else 1.0])
    if name in ("part", "colour", "opaque_colour", "denoised", "partner"):
        return 40 * unit**4
    # with holes, where the history does not know a pixel
    if name in ("past", "state", "next_state"):
        unit[..., 3][random.random(size[:2]) < 0.05] = -1 / 30 if name == "past" else 0
        return 30 * unit
    return {"depth_scale": 1 + unit}.get(name, unit)


def _places(case: Case, random: np.random.Generator) -> np.ndarray:
    """Places of tiles that overlap, that end beyond what is written, and that leave some of it
    out."""
    places = []
    for _ in range(3):
        top, left = random.integers(0, case.h // 2 + 4), random.integers(0, case.w // 2 + 4)
        bottom, right = top + case.window.rows, left + case.window.columns
        inner = (top + 2, left + 1, bottom - random.integers(3), right - 1)
        places.append([top, left, top + random.integers(2), left, bottom, right, *inner])
    return np.array(places)


def in_frame(kernel: Kernel, results: Mapping[str, np.ndarray],
             case: Case) -> dict[str, np.ndarray]:
    """Results without what lies beyond the frame at output size, which may be anything."""
    case = case_for(kernel, case)
    out, cut = case.window.out, {}
    for name, value in results.items():
        ends_beyond = kernel.shapes[name][-3:-1] == ("out_th", "out_tw")
        cut[name] = (value[..., : case.height - out.top, : case.width - out.left, :] if ends_beyond
                     else value)
    return cut


def _unwritten(size: tuple[int, ...], dtype: str) -> np.ndarray:
    return np.full(size, 77 if dtype == "uint8" else np.nan, dtype)


def run(kernel: Kernel, device: Device, inputs: Mapping[str, np.ndarray],
        case: Case) -> dict[str, np.ndarray]:
    """What a kernel writes, on a device."""
    state = device.compute_state(kernel)
    empty = {name: _unwritten(shape(kernel, name, case), element_type(kernel, name))
             for name in kernel.writes}
    written = {name: device.wrap(name, array) for name, array in empty.items()}
    read = {name: device.wrap(name, value) for name, value in inputs.items()}
    commands = device.command_buffer(kernel.name)
    with commands.compute_encoder("run") as encoder:
        encoder.dispatch(state, ArgumentTable(state, read | written))
    commands.commit()
    commands.wait(timeout=60)
    return in_frame(kernel, {name: tensor.download() for name, tensor in written.items()}, case)

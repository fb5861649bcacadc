"""Kernels in float32 against their own definitions in float64: docs/lab/stability.md shows the
bounds.

Four ways to compute them: compiled rows, portable definitions by ONNX Runtime, and CUDA sources,
run on the host and, where there is one, on a GPU.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from postfx.frame import Role
from postfx.kernels import Kernel, find_source
from postfx.kernels.denoise.history import REFLECTIONS
from postfx.runtime import Device
from tests.kernels import denoise_cases, host_cuda, tonemap_cases
from tests.passes import mirror_scene
from tests.stress.scenes import portable

torch = pytest.importorskip("torch")

from tests.kernels.test_cuda_kernels import by_cuda  # noqa: E402
from tests.kernels.test_tonemap_kernels import DEFINITIONS as TONE  # noqa: E402
from tests.passes.test_denoise_reflections import PLANES, params_of  # noqa: E402
from training.denoise.export import KERNELS as DENOISE  # noqa: E402

PAGE = Path(__file__).resolve().parent.parent.parent / "docs/lab/stability.md"
ROUNDED = 2e-7
"""Bound of kernels that do a handful of operations a value: twice the spacing of float32 below 1,
1.2e-7, at most."""
BOUNDS = {
    "denoise_dilate": 0.0, "denoise_spread": 0.0, "denoise_assemble": 0.0,
    "denoise_pack": 0.0, "checkerboard": 0.0,
    "denoise_scale": ROUNDED, "denoise_guides": ROUNDED, "denoise_mix": ROUNDED,
    "denoise_remodulate": ROUNDED, "denoise_remodulate_both": ROUNDED, "denoise_judge": ROUNDED,
    "denoise_detail": ROUNDED, "denoise_restore": ROUNDED, "denoise_strength": ROUNDED,
    "denoise_keep": ROUNDED, "denoise_open": ROUNDED, "denoise_open_fine": ROUNDED,
    "denoise_open_phased": ROUNDED, "overlay_over": ROUNDED,
    "denoise_mirrored": ROUNDED, "denoise_open_error": ROUNDED,
    "overlay_over_alpha": ROUNDED, "mix_partner": 5e-6, "enlarge_motion": ROUNDED,
    "smooth": ROUNDED, "light": ROUNDED, "follow": ROUNDED, "expose": ROUNDED, "apply_cube": 5e-7,
    "convert_primaries": 5e-7, "lowres": 5e-7, "denoise_trust": 1e-6, "denoise_accumulate": 1e-6,
    "encode_display": 5e-7, "denoise_pool": 1e-6, "denoise_filter": 5e-7, "denoise_resize": 5e-7,
    "denoise_reactive": 5e-7, "denoise_history": 2e-6, "denoise_features": 5e-6,
    "denoise_upsample": 2e-6, "denoise_upsample_guided": 2e-6, "denoise_upsample_unscaled": 2e-6,
    "denoise_blend_picture": 2e-6, "denoise_means": 5e-7,
    "resample": 5e-6, "slice_apply": 1e-5, "overlay_enlarge": 2e-5,
    "denoise_reflections": 2e-5, "denoise_open_products": 2e-6, "denoise_open_fine_products": 2e-6,
    "denoise_accumulate_part": 5e-6, "denoise_upsample_light": 2e-6, "denoise_balance": 5e-7,
    "denoise_correct": 2e-5, "denoise_gather": 2e-6, "denoise_fit": 5e-5,
    "denoise_alpha_level": ROUNDED, "denoise_enlarge_alpha": 2e-6,
    "denoise_reflectance": ROUNDED, "denoise_decode": ROUNDED, "denoise_decode_one": ROUNDED,
    "denoise_store": 0.004, "denoise_store_ringed": 0.004,  # one of 255 codes
}
"""Kernel -> largest error of an element by the largest value of what is written."""
LEAST_STEP = float(np.finfo(np.float32).smallest_subnormal)
"""Denormal values are rounded to multiples of this."""
PORTABLE_HISTORY = 1e-5
"""That of the portable kernels of `MOVED`: ONNX takes positions from -1 to 1 over the picture,
which are rounded."""
MOVED = "denoise_history", "denoise_gather"
PLACES = ("host", pytest.param("GPU", marks=pytest.mark.gpu))
Arrays = dict[str, np.ndarray]
Way = Callable[[Kernel, Arrays, denoise_cases.Case], Arrays]
Ways = Callable[[Kernel], dict[str, Way]]
HELD = [kernel for kernel in denoise_cases.KERNELS if kernel is not REFLECTIONS]
"""Without the one that does nothing on random planes, and has a scene of its own."""
CASES = (denoise_cases.Case(17, 5, 34, 10), denoise_cases.Case(20, 24, 39, 48),
         denoise_cases.Case(33, 47, 66, 94))
VALUES: dict[str, Callable[[np.ndarray], np.ndarray | float]] = {
    "0": lambda plane: 0, "denormal": lambda plane: 1e-42, "-1": lambda plane: -1,
    "largest half": lambda plane: 65504, "1e10": lambda plane: 1e10,
    "+40 EV": lambda plane: plane * 2.0**40, "-40 EV": lambda plane: plane * 2.0**-40,
    "fireflies": lambda plane: np.where(np.arange(plane.size).reshape(plane.shape) % 97, plane,
                                        1e6),
}
"""What a plane of the frame holds, from what it held."""
ROW = re.compile(r"^\| (?P<bound>\S+) \| (?P<names>`\w+`(?:, `\w+`)*) \|$", re.MULTILINE)


def exact(definition: type, inputs: list[np.ndarray]) -> list[np.ndarray]:
    """What a definition gives in float64 of the same numbers, also where it says float32."""
    wide = [torch.from_numpy(value).to(_wide(value)) for value in inputs]
    as_float64 = (patch.multiple(torch.Tensor, float=torch.Tensor.double),
                  patch.object(torch, "float32", torch.float64))
    with torch.no_grad(), as_float64[0], as_float64[1]:
        found = definition().double()(*wide)
    return [value.numpy() for value in (found if isinstance(found, tuple) else (found,))]


def _wide(value: np.ndarray) -> torch.dtype:
    return torch.float64 if value.dtype == np.float32 else torch.from_numpy(value).dtype


def exact_upscaler(kernel: Kernel, case: denoise_cases.Case) -> dict[str, np.ndarray]:
    inputs = denoise_cases.arguments(kernel, case)
    results = exact(DENOISE[kernel], [inputs[name] for name in kernel.reads])
    return denoise_cases.in_frame(kernel, dict(zip(kernel.writes, results, strict=True)), case)


def has_cuda(kernel: Kernel) -> bool:
    return host_cuda.COMPILER is not None and find_source(kernel)


def bound(kernel: Kernel, way: str) -> float:
    return (PORTABLE_HISTORY if kernel.name in MOVED and way.startswith("portable")
            else BOUNDS[kernel.name])


def assert_near(kernel: Kernel, way: str, found: dict[str, np.ndarray],
                wanted: dict[str, np.ndarray], white: float = 0.0) -> None:
    """Errors by the largest value of what is written, or by `white` where all of it is darker."""
    for name, value in found.items():
        assert wanted[name].dtype == (np.float64 if value.dtype == np.float32 else value.dtype)
        error = np.abs(value.astype(np.float64) - wanted[name].astype(np.float64)).max()
        largest = max(np.abs(wanted[name]).max(), white)
        most = bound(kernel, way) * largest + LEAST_STEP
        assert error <= most, f"{kernel.name}, {way}: {name} {error:.2g} of {largest:.2g}"


@pytest.fixture(params=PLACES)
def ways(request: pytest.FixtureRequest, cpu: Device) -> Ways:
    """The ways to compute a kernel: all of the host, or a GPU's."""

    def on(device: Device) -> Way:
        return lambda kernel, *rest: denoise_cases.run(kernel, device, *rest)

    def by_source(kernel: Kernel, inputs: Arrays, case: denoise_cases.Case) -> Arrays:
        shapes = {name: denoise_cases.shape(kernel, name, case) for name in kernel.writes}
        return denoise_cases.in_frame(kernel, by_cuda(kernel, inputs, shapes), case)

    if request.param == "GPU":
        on_gpu = on(request.getfixturevalue("gpu"))
        return lambda kernel: {"GPU": on_gpu}
    host = {"compiled": on(cpu), "portable": on(portable(cpu))}
    return lambda kernel: {**host, "CUDA": by_source} if has_cuda(kernel) else host


def planes_of(kernel: Kernel) -> list[str]:
    """What a kernel reads of a frame's planes."""
    return sorted({*denoise_cases.FRAME} & {*kernel.reads})


@pytest.mark.parametrize("kernel", HELD, ids=lambda kernel: kernel.name)
def test_error_of_the_upscalers_kernels(ways: Ways, kernel: Kernel) -> None:
    for case in CASES:
        inputs, wanted = denoise_cases.arguments(kernel, case), exact_upscaler(kernel, case)
        for name, way in ways(kernel).items():
            assert_near(kernel, name, way(kernel, inputs, case), wanted)


def with_values(inputs: Arrays, name: str, values: str) -> Arrays:
    plane = inputs[name]
    return {**inputs, name: np.broadcast_to(VALUES[values](plane), plane.shape).astype(plane.dtype)}


@pytest.mark.parametrize("kernel", [one for one in HELD if planes_of(one)],
                         ids=lambda kernel: kernel.name)
def test_error_on_hard_values(ways: Ways, kernel: Kernel) -> None:
    """In one plane of the frame after the other."""
    case = CASES[1]
    for values, name in product(VALUES, planes_of(kernel)):
        inputs = with_values(denoise_cases.arguments(kernel, case), name, values)
        wanted = exact(DENOISE[kernel], [inputs[read] for read in kernel.reads])
        wanted = denoise_cases.in_frame(kernel, dict(zip(kernel.writes, wanted, strict=True)), case)
        for label, way in ways(kernel).items():
            assert_near(kernel, f"{label}, {name} {values}", way(kernel, inputs, case), wanted)


@pytest.mark.parametrize("scene", ["floor", "ball", "ball at the edges"])
def test_error_of_reflections(ways: Ways, scene: str) -> None:
    before, now = (mirror_scene.frame(number, ball=scene != "floor") for number in (3, 4))
    height, width = now[Role.DEPTH].shape[:2]
    part = (np.s_[height // 3:height // 2, width // 3:width // 2] if scene == "ball at the edges"
            else np.s_[:])
    inputs = {name: now[role][part].copy()
              for name, role in zip(REFLECTIONS.reads, PLANES, strict=False)}
    inputs = {**inputs, "camera": params_of(before, now)}
    height, width = now[Role.DEPTH][part].shape[:2]
    (wanted,) = exact(DENOISE[REFLECTIONS], [inputs[name] for name in REFLECTIONS.reads])
    for name, way in ways(REFLECTIONS).items():
        found = way(REFLECTIONS, inputs, denoise_cases.Case(height, width, height, width))
        assert_near(REFLECTIONS, name, found, {"reflected": wanted})


def assert_tone_mapper(ways: Ways, kernel: Kernel, inputs: Arrays, size: tuple[int, int],
                       white: float = 0.0) -> None:
    wanted = dict(zip(kernel.writes, exact(TONE[kernel], list(inputs.values())), strict=True))
    for name, way in ways(kernel).items():
        assert_near(kernel, name, way(kernel, inputs, denoise_cases.Case(*size, *size)), wanted,
                    white)


@pytest.mark.parametrize("kernel", TONE, ids=lambda kernel: kernel.name)
def test_error_of_the_tone_mappers_kernels(ways: Ways, kernel: Kernel) -> None:
    """Also on hard values."""
    sizes = tonemap_cases.sizes(kernel)[:3]
    for size in sizes:
        assert_tone_mapper(ways, kernel, tonemap_cases.arguments(kernel, *size), size)
    for values in VALUES if "colour" in kernel.reads else ():
        inputs = with_values(tonemap_cases.arguments(kernel, *sizes[0]), "colour", values)
        assert_tone_mapper(ways, kernel, inputs, sizes[0], white=1.0)


def test_the_table_has_the_bounds_that_are_asserted() -> None:
    rows = [(float(row["bound"]), re.findall(r"`(\w+)`", row["names"])) for row in
            ROW.finditer(PAGE.read_text(encoding="utf-8"))]
    assert {name: bound for bound, names in rows for name in names} == BOUNDS
    assert re.search(rf"the portable `denoise_history`[^:]*: {PORTABLE_HISTORY:g}\b",
                     PAGE.read_text(encoding="utf-8"))
    assert {kernel.name for kernel in (*HELD, REFLECTIONS, *TONE)} == set(BOUNDS)

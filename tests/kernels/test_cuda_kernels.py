"""The CUDA kernels, run on the host, against the compiled rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from postfx.kernels import Kernel, find_source
from postfx.kernels.denoise import IN_HALF, MIX
from postfx.kernels.denoise.alpha import NEAR_ALPHA
from postfx.kernels.denoise.output import DETAIL, JUDGE, TILE
from postfx.kernels.denoise.prepare import ACCUMULATE
from postfx.kernels.denoise.pyramid import FILTER_MIXED, FILTER_SHADED, POOLS
from postfx.runtime import Device
from tests.kernels import host_cuda, tonemap_cases
from tests.kernels.denoise_cases import (
    IN_ROWS_ALONE,
    KERNELS,
    ODD,
    arguments,
    element_type,
    in_frame,
    run,
    runs_of,
    shape,
)
from tests.kernels.test_denoise_kernels import assert_same

pytestmark = pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")

ON_GPU = [POOLS, FILTER_MIXED, FILTER_SHADED, NEAR_ALPHA, *IN_HALF.values()]
"""Kernels that run on a GPU alone."""
WRITTEN = [*(kernel for kernel in (*KERNELS, *IN_ROWS_ALONE) if find_source(kernel)), *ON_GPU]


@pytest.fixture(scope="module")
def compiled() -> Device:
    return Device("cpu", threads=2)


def by_cuda(kernel: Kernel, inputs: dict[str, np.ndarray],
            shapes: dict[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    found = {name: np.full(shapes[name], np.nan, element_type(kernel, name))
             for name in kernel.writes}
    host_cuda.run(kernel, inputs | found)
    return found


@pytest.mark.parametrize("kernel", WRITTEN, ids=lambda kernel: kernel.name)
def test_cuda_kernels_compute_what_the_compiled_rows_do(kernel: Kernel, compiled: Device) -> None:
    for case, bad in runs_of(kernel):
        inputs = arguments(kernel, case, bad=bad)
        found = by_cuda(kernel, inputs, {name: shape(kernel, name, case) for name in kernel.writes})
        assert_same(in_frame(kernel, found, case), run(kernel, compiled, inputs, case),
                    f"{case} {bad}")


def test_the_last_channels_of_the_fine_head_are_enough(compiled: Device) -> None:
    """A network that gives the picture itself has no others."""
    inputs = arguments(ACCUMULATE, ODD)
    inputs["fine"] = inputs["fine"][:, MIX:].copy()
    found = by_cuda(ACCUMULATE, inputs, {name: shape(ACCUMULATE, name, ODD)
                                         for name in ACCUMULATE.writes})
    assert_same(in_frame(ACCUMULATE, found, ODD), run(ACCUMULATE, compiled, inputs, ODD))


@pytest.mark.parametrize("kernel", [kernel for kernel in (*tonemap_cases.KERNELS,
                                                          *tonemap_cases.ON_GPU)
                                    if find_source(kernel)],
                         ids=lambda kernel: kernel.name)
def test_kernels_of_the_tone_mapper_compute_what_the_compiled_rows_do(kernel: Kernel) -> None:
    for height, width in tonemap_cases.sizes(kernel):
        inputs = tonemap_cases.arguments(kernel, height, width)
        (name,) = kernel.writes
        size = tuple({"height": height, "width": width}.get(axis, axis)
                     for axis in kernel.shapes[name])
        wanted = np.full(size, np.nan, np.float32)
        kernel.rows(0, size[kernel.row_axis[1]], *inputs.values(), wanted)
        assert_same(by_cuda(kernel, inputs, {name: size}), {name: wanted}, f"{height}x{width}")


@pytest.mark.parametrize("case", tonemap_cases.PACES, ids=lambda case: case.name)
def test_how_much_is_kept(case: tonemap_cases.Pace) -> None:
    inputs = dict(zip(tonemap_cases.FOLLOW.reads, case.arguments(), strict=True))
    found = by_cuda(tonemap_cases.FOLLOW, inputs, {"after": (1, 4)})
    np.testing.assert_allclose(found["after"], [case.after], atol=1e-6)


@pytest.mark.parametrize("case", tonemap_cases.HOLDS, ids=lambda case: case.name)
def test_exposure_that_is_held(case: tonemap_cases.Hold) -> None:
    inputs = dict(zip(tonemap_cases.EXPOSE.reads, case.arguments(), strict=True))
    found = by_cuda(tonemap_cases.EXPOSE, inputs, {"result": (3,)})
    toe, scale = tonemap_cases.SHAPER
    np.testing.assert_allclose(found["result"], np.float32([case.factor, toe / 1.5, scale]),
                               rtol=2e-7)


def test_smooth_ignores_the_past_when_nothing_is_kept() -> None:
    inputs = tonemap_cases.arguments(tonemap_cases.SMOOTH_GRID, 1, 1)
    inputs["previous"][:], inputs["keep"][:] = np.nan, 0.0
    found = by_cuda(tonemap_cases.SMOOTH_GRID, inputs, {"result": tonemap_cases.GRID_SHAPE})
    np.testing.assert_array_equal(found["result"], inputs["current"])


def noise_and_pattern(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Noise on the left, a pattern on the right."""
    share = np.clip((np.arange(width) - 200) / 200, 0, 1)
    pattern = np.sin(0.9 * np.arange(width)) * np.sin(0.7 * np.arange(height))[:, None]
    return (1 - share) * random.normal(0, 0.1, (height, width)) + share * 0.1 * pattern


def faint_and_visible(random: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Noise that rises from what nobody sees to what can be seen."""
    return random.normal(0, 10 ** np.linspace(-3.5, -2, width), (height, width))


@pytest.mark.parametrize("what", [noise_and_pattern, faint_and_visible])
@pytest.mark.parametrize("evidence", [1.0, 0.6])
def test_detail_is_told_from_noise_tile_by_tile(evidence: float,
                                                what: Callable[..., np.ndarray]) -> None:
    """A frame of many tiles of both kinds and between them."""
    h, w = 150, 630
    denoised = np.full((h, w, 3), 0.5, np.float32)
    removed = what(np.random.default_rng(0), h, w)
    inputs = {"colour": (denoised + removed[..., None]).astype(np.float32), "denoised": denoised,
              "params": np.float32([1, 0, 0, 1])}
    tiles = -(-h // TILE), -(-w // TILE)
    inputs["judged"] = np.ones((*tiles, 1), np.float32)
    inputs["judged"][3:5, 7:20] = 0
    sums = np.empty((*tiles, JUDGE.shapes["sums"][2]), np.float32)
    JUDGE.rows(0, tiles[0], *inputs.values(), sums)
    assert_same(by_cuda(JUDGE, inputs, {"sums": sums.shape}), {"sums": sums})
    detail = np.empty((*tiles, 1), np.float32)
    known = np.zeros_like(detail)
    known[6, ::3] = 0.75
    DETAIL.rows(0, tiles[0], sums, np.float32([evidence]), known, detail)
    assert np.ptp(detail) > 0.5 and (detail >= known).all()
    found = by_cuda(DETAIL, {"sums": sums, "evidence": np.float32([evidence]), "known": known},
                    {"detail": detail.shape})
    assert_same(found, {"detail": detail})

"""The tone mapper's kernels: compiled rows and portable ONNX definitions against the torch
definitions."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest

from postfx.colour import REC2020
from postfx.colour.views import neutral, reinhard
from postfx.compiled import library
from postfx.compiled.library import Rows
from postfx.kernels import Kernel
from postfx.kernels.colour import (
    APPLY_CUBE,
    BRIGHTEST,
    CONVERT_PRIMARIES,
    ENCODE_DISPLAY,
    SHOW_NEUTRAL,
    SHOW_REINHARD,
)
from postfx.kernels.image import CHECKERBOARD
from postfx.kernels.tonemap import EXPOSE, FOLLOW, LIGHT, LOWRES, SLICE_APPLY, SMOOTH_GRID
from postfx.system import models_dir
from tests.kernels.tonemap_cases import (
    HOLDS,
    PACES,
    SHAPER,
    SHOWING,
    Hold,
    Pace,
    arguments,
    sizes,
)

torch = pytest.importorskip("torch")

from training.kernels import tonemap as tonemap_kernels  # noqa: E402
from training.tonemap.model import default_shaper, look_up, shape  # noqa: E402

pytestmark = pytest.mark.usefixtures("every_level")
TOLERANCE = 1e-5

DEFINITIONS = {
    SLICE_APPLY: tonemap_kernels.SliceApply,
    LOWRES: tonemap_kernels.Lowres,
    LIGHT: tonemap_kernels.Light,
    FOLLOW: tonemap_kernels.Follow,
    SMOOTH_GRID: tonemap_kernels.Smooth,
    EXPOSE: tonemap_kernels.Expose,
    ENCODE_DISPLAY: tonemap_kernels.EncodeDisplay,
    APPLY_CUBE: tonemap_kernels.ApplyCube,
    CONVERT_PRIMARIES: tonemap_kernels.ConvertPrimaries,
    CHECKERBOARD: tonemap_kernels.Checkerboard,
}
CASES = [
    pytest.param(kernel, height, width, id=f"{kernel.name}-{height}x{width}")
    for kernel in DEFINITIONS
    for height, width in sizes(kernel)
]


def by_definition(kernel: Kernel, inputs: list[np.ndarray]) -> np.ndarray:
    with torch.no_grad():
        return DEFINITIONS[kernel]()(*map(torch.from_numpy, inputs)).numpy()


def by_rows(kernel: Kernel, inputs: list[np.ndarray], like: np.ndarray, bands: int) -> np.ndarray:
    output = np.full(like.shape, np.nan, like.dtype)
    count = output.shape[kernel.row_axis[1]]
    edges = [count * band // bands for band in range(bands + 1)]
    for y0, y1 in zip(edges, edges[1:], strict=False):
        kernel.rows(y0, y1, *inputs, output)
    return output


@pytest.mark.parametrize(("kernel", "height", "width"), CASES)
def test_compiled_rows_match_the_definition(kernel: Kernel, height: int, width: int) -> None:
    inputs = list(arguments(kernel, height, width).values())
    wanted = by_definition(kernel, inputs)
    assert np.isfinite(wanted).all()
    np.testing.assert_allclose(by_rows(kernel, inputs, wanted, 1), wanted, atol=TOLERANCE)


@pytest.mark.parametrize(("kernel", "height", "width"), CASES)
def test_portable_definition_matches(kernel: Kernel, height: int, width: int) -> None:
    inputs = list(arguments(kernel, height, width).values())
    session = onnxruntime.InferenceSession(models_dir() / "kernels" / f"{kernel.name}.onnx")
    found = session.run(list(kernel.writes), dict(zip(kernel.reads, inputs, strict=True)))[0]
    np.testing.assert_allclose(found, by_definition(kernel, inputs), atol=TOLERANCE)


@pytest.mark.parametrize("kernel",
                         [kernel for kernel in DEFINITIONS if isinstance(kernel.rows, Rows)],
                         ids=lambda kernel: kernel.name)
def test_every_level_gives_the_same_bits(kernel: Kernel) -> None:
    """Beside values that a file should not hold; without fused products, nearly the same."""
    for height, width in sizes(kernel):
        inputs = list(arguments(kernel, height, width).values())
        like, found = by_definition(kernel, inputs), {}
        for level in library.levels():
            found[level] = np.full(like.shape, np.nan, like.dtype)
            Rows(kernel.rows.name, level=level)(0, like.shape[kernel.row_axis[1]], *inputs,
                                                found[level])
        lowest = found.pop("baseline", None)
        for level, output in found.items():
            np.testing.assert_array_equal(output, found["v3"], f"{height}x{width} {level}")
        if lowest is not None:
            np.testing.assert_allclose(lowest, like, atol=TOLERANCE)


@pytest.mark.parametrize("kernel", [SHOW_NEUTRAL, SHOW_REINHARD], ids=lambda kernel: kernel.name)
def test_views_are_their_formulas_with_the_same_bits_at_every_level(kernel: Kernel) -> None:
    for height, width in sizes(kernel):
        given = arguments(kernel, height, width)
        held = np.nan_to_num(given["colour"], posinf=BRIGHTEST, neginf=-BRIGHTEST)
        light = held.astype(np.float64) @ SHOWING[1:10].reshape(3, 3).T * SHOWING[0]
        light = light.clip(0, BRIGHTEST)
        wanted = neutral(light) if kernel is SHOW_NEUTRAL else reinhard(light, REC2020, SHOWING[-1])
        found = {}
        for level in library.levels():
            found[level] = np.full(wanted.shape, np.nan, np.float32)
            Rows(kernel.rows.name, level=level)(0, height, *given.values(), found[level])
            np.testing.assert_allclose(found[level], wanted, rtol=1e-5, atol=1e-5)
        lowest = found.pop("baseline", None)  # without fused products
        for level, output in found.items():
            np.testing.assert_array_equal(output, found["v3"], f"{height}x{width} {level}")
        assert lowest is None or np.isfinite(lowest).all()


@pytest.mark.parametrize("kernel", DEFINITIONS, ids=lambda kernel: kernel.name)
def test_bands_give_the_same_bits_as_one_run(kernel: Kernel) -> None:
    inputs = list(arguments(kernel, 67, 129).values())
    wanted = by_definition(kernel, inputs)
    np.testing.assert_array_equal(by_rows(kernel, inputs, wanted, 5),
                                  by_rows(kernel, inputs, wanted, 1))


def test_lowres_of_a_flat_picture_is_flat_and_a_firefly_hardly_moves_it() -> None:
    colour = np.full((540, 960, 3), 0.18, np.float32)
    shaper = [x.numpy() for x in default_shaper()]
    low = np.empty((1, 3, 256, 256), np.float32)
    LOWRES.rows(0, 256, colour, *shaper, low)
    flat = float(low[0, 0, 0, 0])
    np.testing.assert_allclose(low, flat, atol=1e-5)
    colour[100, 100] = 1e4
    LOWRES.rows(0, 256, colour, *shaper, low)
    assert low.max() - flat < 0.2
    assert (np.abs(low - flat) > 1e-5).sum() <= 3 * 4


def test_light_beyond_the_range_keeps_its_hue() -> None:
    """Orange light of 2 and of 2000 times white are the same orange in the shaper, not yellow."""
    orange = np.float32([[[600.0, 200.0, 10.0]]]) * np.float32([1, 1000])[:, None, None]
    shaped = shape(torch.from_numpy(orange).permute(0, 2, 1)[..., None],
                   *default_shaper())[..., 0, 0]
    torch.testing.assert_close(shaped[1], shaped[0], atol=1e-6, rtol=0)


def test_cube_gives_its_corners_and_greys_of_its_diagonal() -> None:
    cube = np.random.default_rng(3).random((5, 5, 5, 3)).astype(np.float32)
    axis = torch.linspace(0, 1, 5)
    corners = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij")).flatten(1)[None, :, None]
    found = look_up(corners, torch.from_numpy(cube))[0, :, 0].T
    np.testing.assert_allclose(found, cube.reshape(-1, 3), atol=1e-6)
    grey = look_up(torch.full((1, 3, 1, 1), 0.3), torch.from_numpy(cube)).flatten()
    np.testing.assert_allclose(grey, 0.8 * cube[1, 1, 1] + 0.2 * cube[2, 2, 2], atol=1e-6)


@pytest.mark.parametrize("case", PACES, ids=lambda case: case.name)
def test_how_much_is_kept(case: Pace) -> None:
    """In each form; the light is 8 stops."""
    inputs = case.arguments()
    wanted = by_definition(FOLLOW, inputs)
    np.testing.assert_allclose(wanted, [case.after], atol=1e-6)
    np.testing.assert_allclose(by_rows(FOLLOW, inputs, wanted, 1), wanted, rtol=2e-7)
    session = onnxruntime.InferenceSession(models_dir() / "kernels" / "follow.onnx")
    found = session.run(["after"], dict(zip(FOLLOW.reads, inputs, strict=True)))[0]
    np.testing.assert_allclose(found, wanted, rtol=2e-7)


@pytest.mark.parametrize("case", HOLDS, ids=lambda case: case.name)
def test_exposure_that_is_held(case: Hold) -> None:
    """In each form: stops are mixed, and toe over exposure stands for the frame's own exposure."""
    inputs = case.arguments()
    wanted = np.array([case.factor, SHAPER[0] / 1.5, SHAPER[1]], np.float32)
    session = onnxruntime.InferenceSession(models_dir() / "kernels" / "expose.onnx")
    portable = session.run(["result"], dict(zip(EXPOSE.reads, inputs, strict=True)))[0]
    for found in (by_definition(EXPOSE, inputs), by_rows(EXPOSE, inputs, wanted, 1), portable):
        np.testing.assert_allclose(found, wanted, rtol=2e-7)


def test_smooth_ignores_the_past_when_nothing_is_kept() -> None:
    current = np.random.default_rng(0).normal(size=(1, 16, 16, 8, 12)).astype(np.float32)
    result = np.empty_like(current)
    SMOOTH_GRID.rows(0, 16, np.full_like(current, np.nan), current, np.zeros((1, 4), np.float32),
                     result)
    np.testing.assert_array_equal(result, current)

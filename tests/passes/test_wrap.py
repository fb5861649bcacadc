"""Panoramas: the right edge goes on at the left one, in one frame, at 2x and over time."""

from __future__ import annotations

import numpy as np
import pytest

import postfx
from postfx.cli.main import main
from postfx.errors import PassOptionError
from postfx.frame import Frame, Role

WIDTH, HEIGHT, STEP, FRAMES = 256, 64, 6, 3
BOUND = 2e-3
"""Of log(1 + light): what networks see beyond the margin changes less."""


def panorama(number: int, turned: int = 0) -> Frame:
    """A noisy picture around the whole horizon, which turns by STEP pixels to the right a frame;
    and its motion."""
    across, down = np.meshgrid(np.arange(WIDTH) - STEP * number, np.arange(HEIGHT))
    angle = 2 * np.pi * across / WIDTH
    clean = np.stack([1.2 + np.sin(k * angle + down / 9) for k in (1, 3, 8)], -1)
    noisy = clean * np.random.default_rng(number).gamma(4, 1 / 4, clean.shape)
    planes = {Role.COLOUR: noisy,
              Role.MOTION: np.broadcast_to(np.float32([-STEP, 0]), (HEIGHT, WIDTH, 2))}
    planes = {role: np.ascontiguousarray(np.roll(plane, turned, 1), np.float32)
              for role, plane in planes.items()}
    return Frame(planes, number)


def denoised(scale: float, wrap: str, turned: int = 0, frames: int = FRAMES,
             **header) -> list[np.ndarray]:
    passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=scale, model="s.fp32")], wrap=wrap,
                             exposure=0, checks=False)
    shot = (panorama(number, turned).copy_with(metadata=header) for number in range(1, frames + 1))
    return [np.log1p(passes(frame)[Role.COLOUR]) for frame in shot]


@pytest.fixture(scope="module")
def around() -> list[np.ndarray]:
    return denoised(1, "x")


def test_a_turned_panorama_gives_the_turned_result(around):
    """Frame after frame, with motion across the edge: where the edge is makes no difference."""
    turned = denoised(1, "x", WIDTH // 2)
    for here, there in zip(around, turned, strict=True):
        assert here.shape == (HEIGHT, WIDTH, 3)
        np.testing.assert_allclose(np.roll(there, -WIDTH // 2, 1), here, atol=BOUND)
    plain, turned = (denoised(1, "none", by)[-1] for by in (0, WIDTH // 2))
    # there is a seam without
    assert np.abs(np.roll(turned, -WIDTH // 2, 1) - plain).max() > 10 * BOUND


def test_enlarged_panoramas_have_no_seam_either():
    for scale in (1.5, 2):
        (here,), (there,) = (denoised(scale, "x", by, 1) for by in (0, WIDTH // 2))
        assert here.shape == (HEIGHT * scale, WIDTH * scale, 3)
        np.testing.assert_allclose(np.roll(there, -int(WIDTH * scale) // 2, 1), here, atol=BOUND)


def test_a_header_that_says_so_is_enough(around, tmp_path):
    (found,) = denoised(1, "auto", 0, 1, textureformat="LatLong Environment")
    np.testing.assert_array_equal(found, around[0])
    openexr = pytest.importorskip("OpenEXR")
    header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage,
              "envmap": openexr.ENVMAP_LATLONG}
    openexr.File(header, {"RGB": panorama(1)[Role.COLOUR]}).write(str(tmp_path / "in.0001.exr"))
    common = ["run", str(tmp_path / "in.####.exr"), "--model", "s.fp32", "--bits", "32", "-o"]
    for name, options in (("auto", []), ("x", ["--wrap", "x"]), ("none", ["--wrap", "none"])):
        assert main([*common, str(tmp_path / f"{name}.####.exr"), *options]) == 0
    auto, x, none = (next(iter(postfx.read_sequence(tmp_path / f"{name}.0001.exr")))[Role.COLOUR]
                     for name in ("auto", "x", "none"))
    np.testing.assert_array_equal(auto, x)
    assert np.abs(none - x)[:, :4].max() > 1e-2


def test_motion_the_long_way_round_is_the_short_way(around):
    passes = postfx.Pipeline([postfx.DenoiseUpscale(model="s.fp32")], wrap="x", exposure=0,
                             checks=False)
    for number in range(1, FRAMES + 1):
        frame = panorama(number)
        # as a renderer writes it that takes the difference of columns
        frame.planes[Role.MOTION][:, :STEP, 0] += WIDTH
        found = np.log1p(passes(frame)[Role.COLOUR])
    np.testing.assert_array_equal(found, around[-1])


def test_what_cannot_be_is_refused():
    with pytest.raises(PassOptionError, match="give auto, x, none"):
        postfx.Pipeline([postfx.DenoiseUpscale()], wrap="y")
    passes = postfx.Pipeline([postfx.DenoiseUpscale(size=(300, 75))], wrap="x")
    with pytest.raises(PassOptionError, match="without a seam: give a scale"):
        passes(panorama(1))

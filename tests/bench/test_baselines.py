"""Accumulation along the motion at output size."""

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.runtime import Device
from postfx.tools.bench.baselines import LONGEST_AVERAGE_FRAMES, Accumulator, HostKernels, Oidn


@pytest.fixture(scope="module")
def kernels():
    return HostKernels(Device("cpu", 2))


def frame(motion=(0.0, 0.0), depth=2.0, normal=(0.0, 0.0, 1.0), **facts):
    planes = {Role.COLOUR: np.zeros((8, 12, 3), np.float32),
              Role.MOTION: np.tile(np.float32(motion), (8, 12, 1)),
              Role.DEPTH: np.full((8, 12, 1), depth, np.float32),
              Role.NORMAL: np.tile(np.float32(normal), (8, 12, 1))}
    return Frame(planes, **facts)


def flat(value):
    return np.full((16, 24, 3), value, np.float32)


def test_still_frames_are_averaged(kernels):
    accumulate = Accumulator(kernels)
    for number, value in enumerate([1.0, 3.0, 5.0], 1):
        result = accumulate(flat(value), frame())
        assert np.allclose(result, (1 + value) / 2), number


def test_a_sky_is_averaged_too(kernels):
    accumulate = Accumulator(kernels)
    sky = frame(depth=1e10, normal=(0, 0, 0))
    accumulate(flat(1), sky)
    assert np.allclose(accumulate(flat(3), sky), 2)


def test_the_mean_goes_back_ten_frames_at_most(kernels):
    accumulate = Accumulator(kernels)
    for _ in range(30):
        accumulate(flat(0), frame())
    assert np.allclose(accumulate(flat(1), frame()), 1 / LONGEST_AVERAGE_FRAMES)


@pytest.mark.parametrize("other", [{"depth": 2.5}, {"normal": (1.0, 0.0, 0.0)}, {"reset": True}])
def test_another_surface_starts_anew(kernels, other):
    accumulate = Accumulator(kernels)
    accumulate(flat(1), frame())
    assert np.array_equal(accumulate(flat(3), frame(**other)), flat(3))


def test_motion_leads_to_where_it_was(kernels):
    accumulate = Accumulator(kernels)
    before = np.random.default_rng(1).random((16, 24, 3), np.float32)
    accumulate(before, frame())
    result = accumulate(flat(0), frame(motion=(1.5, -1.0)))  # render pixels: 3 and 2 of the output
    assert np.allclose(result[2:, :-3], before[:-2, 3:] / 2, atol=1e-6)
    assert not result[:2].any() and not result[:, -3:].any()


def test_between_pixels_it_is_linear(kernels):
    accumulate = Accumulator(kernels)
    ramp = np.tile(np.arange(24, dtype=np.float32)[None, :, None], (16, 1, 3))
    accumulate(ramp, frame())
    result = accumulate(flat(0), frame(motion=(0.25, 0.0)))
    assert np.allclose(result[:, :-1], (ramp[:, :-1] + 0.5) / 2)


def test_without_depth_and_normals_every_place_is_the_same_surface(kernels):
    accumulate = Accumulator(kernels)
    bare = Frame({role: frame()[role] for role in (Role.COLOUR, Role.MOTION)})
    accumulate(flat(1), bare)
    assert np.allclose(accumulate(flat(3), bare), 2)


def test_enlarging_keeps_flat_light_and_counts_time(kernels):
    before = kernels.milliseconds
    result = kernels.enlarge(np.full((8, 12, 3), 7.0, np.float32), 20, 30, (0.2, -0.3))
    assert np.allclose(result, 7, rtol=1e-5) and result.shape == (20, 30, 3)
    assert kernels.milliseconds > before


def noisy_edge():
    """A frame whose colour hides an edge in noise, and whose planes show it, with noise of their
    own."""
    random = np.random.default_rng(5)
    edge = np.repeat(np.float32(np.arange(64) < 32)[None, :, None] * [0.4, 0.5, 0.6] + 0.2, 64, 0)
    colour = edge * random.gamma(0.5, 2.0, edge.shape)
    albedo = (edge + random.normal(0, 0.15, edge.shape)).clip(0, 1)
    normal = np.tile(np.float32([0, 0, 1]), (64, 64, 1))
    planes = {Role.COLOUR: colour, Role.DIFFUSE_ALBEDO: albedo, Role.NORMAL: normal}
    return edge, Frame({role: plane.astype(np.float32) for role, plane in planes.items()})


def test_open_image_denoise_takes_planes_in_four_ways():
    pytest.importorskip("pyoidn")
    edge, given = noisy_edge()
    errors = {way: np.square(Oidn("high", "cpu", 2, way)(given) - edge).mean()
              for way in ("clean", "prefiltered", "raw", "none")}
    assert len(set(errors.values())) == 4
    assert errors["prefiltered"] < errors["none"]
    bare = Frame({Role.COLOUR: given[Role.COLOUR]})
    alone = Oidn("high", "cpu", 2, "none")
    assert np.array_equal(alone(bare), alone(given))


def test_denoising_albedo_comes_before_the_others():
    pytest.importorskip("pyoidn")
    _, given = noisy_edge()
    denoise = Oidn("high", "cpu", 2)
    black = np.zeros_like(given[Role.DIFFUSE_ALBEDO])
    both = Frame(given.planes | {Role.DIFFUSE_ALBEDO: black,
                                 Role.DENOISING_ALBEDO: given[Role.DIFFUSE_ALBEDO]})
    assert np.array_equal(denoise(both), denoise(given))

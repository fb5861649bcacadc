"""The denoised upscaler with the model that ships, run through a pipeline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.errors import PassOptionError
from postfx.frame import Frame, Role
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.planes import ABSENT
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.passes.denoise_frames import PLANES, flat, noisy


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def run(frames: list[Frame], device: Device, exposure: float | str = 0.0, **options) -> list[Frame]:
    pipeline = Pipeline([DenoiseUpscale(**{"scale": 2, **options})], device, exposure=exposure)
    return [pipeline(frame) for frame in frames]


def colours(frames: list[Frame]) -> list[np.ndarray]:
    return [frame[Role.COLOUR] for frame in frames]


@pytest.mark.parametrize("scale", [0.9, 3.1, [2], "two", (1, 2)])
def test_a_scale_out_of_range_is_an_error(scale: object) -> None:
    with pytest.raises(PassOptionError, match="scale .*: give a number from 1 to 3"):
        DenoiseUpscale(scale=scale)


@pytest.mark.parametrize(("scale", "size"),
                         [(1, (37, 50)), (1.5, (56, 75)), (2, (74, 100)), (3, (111, 150))])
def test_output_has_the_scaled_size_and_no_jitter(scale: float, size: tuple[int, int],
                                                  device: Device) -> None:
    (result,) = run([noisy(1)], device, scale=scale)
    assert result[Role.COLOUR].shape == (*size, 3)
    assert result.jitter == (0.0, 0.0)
    assert set(result.planes) == {Role.COLOUR}


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 3), (17, 5), (5, 17), (16, 16), (33, 48)])
@pytest.mark.parametrize("scale", [1, 1.3, 2, 3])
def test_small_and_odd_sizes(size: tuple[int, int], scale: float, device: Device) -> None:
    for colour in colours(run([noisy(1, *size), noisy(2, *size)], device, scale=scale)):
        assert colour.shape[:2] == tuple(round(side * scale) for side in size)
        assert np.isfinite(colour).all() and colour.min() >= 0


def test_history_matters_and_a_reset_drops_it(device: Device) -> None:
    first, second, cut = noisy(1), noisy(2), noisy(2, reset=True)
    alone = run([second], device)[0][Role.COLOUR]
    assert np.abs(run([first, second], device)[1][Role.COLOUR] - alone).max() > 1e-3
    np.testing.assert_array_equal(run([first, cut], device)[1][Role.COLOUR], alone)


def test_without_motion_every_frame_stands_alone(device: Device) -> None:
    planes = tuple(role for role in PLANES if role != Role.MOTION)
    frames = [noisy(number, planes=planes) for number in (1, 2)]
    np.testing.assert_array_equal(run(frames, device)[1][Role.COLOUR],
                                  run(frames[1:], device)[0][Role.COLOUR])


@pytest.mark.parametrize("role",
                         [role for role in PLANES if role not in (Role.COLOUR, Role.MOTION)])
def test_a_missing_plane_is_as_good_as_its_neutral_value(role: Role, device: Device) -> None:
    lacking, filled = [], []
    for number in (1, 2):
        frame = noisy(number)
        neutral = np.full_like(frame[role], ABSENT[role])
        filled.append(Frame({**frame.planes, role: neutral}, number, frame.jitter))
        lacking.append(Frame({k: v for k, v in frame.planes.items() if k != role}, number,
                             frame.jitter))
    for found, wanted in zip(colours(run(lacking, device)), colours(run(filled, device)),
                             strict=True):
        assert np.isfinite(found).all()
        np.testing.assert_array_equal(found, wanted)


def test_colour_alone_is_enough(device: Device) -> None:
    frames = [noisy(number, planes=(Role.COLOUR,)) for number in (1, 2)]
    assert all(np.isfinite(colour).all() for colour in colours(run(frames, device)))


def test_jitter_is_read_from_the_frame(device: Device) -> None:
    left, right = (noisy(1, jitter=(x, 0.0)) for x in (-0.4, 0.4))
    difference = run([left], device)[0][Role.COLOUR] - run([right], device)[0][Role.COLOUR]
    assert np.abs(difference).max() > 1e-2


@pytest.mark.parametrize("exposures", [(1.0, 1.0, 1.0), (1.0, 4.0, 0.25)],
                         ids=["steady", "changing"])
def test_exposure_never_changes_the_brightness(exposures: tuple[float, ...],
                                               device: Device) -> None:
    frames = [flat(number, 0.3, exposure=np.log2(exposure))
              for number, exposure in enumerate(exposures)]
    for colour in colours(run(frames, device, exposure="metadata")):
        np.testing.assert_allclose(colour, 0.3, rtol=1e-3)


def test_a_darker_scene_with_more_exposure_is_the_same_picture(device: Device) -> None:
    bright = noisy(1)
    dark = Frame({**bright.planes, Role.COLOUR: bright[Role.COLOUR] / 8}, 1, bright.jitter)
    found = run([dark], device, exposure=3.0)[0][Role.COLOUR]
    wanted = run([bright], device)[0][Role.COLOUR]
    np.testing.assert_allclose(found * 8, wanted, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("scale", [1, 2])
def test_the_sun_keeps_its_hue(scale: int, device: Device) -> None:
    frame = flat(1, 0.3)
    frame[Role.COLOUR][6:11, 6:11] = 40_000, 20_000, 5_000
    (result,) = run([frame], device, scale=scale)
    sun = result[Role.COLOUR][8 * scale, 8 * scale]
    np.testing.assert_allclose(sun / sun[0], (1, 0.5, 0.125), rtol=0.02)
    assert sun[0] > 4_000


def test_alpha_is_kept_and_enlarged(device: Device) -> None:
    frame = noisy(1, 16, 24, planes=(*PLANES, Role.ALPHA), jitter=(0.0, 0.0))
    frame.planes[Role.ALPHA][:, :12], frame.planes[Role.ALPHA][:, 12:] = 1.0, 0.0
    (result,) = run([frame], device)
    alpha = result[Role.ALPHA][..., 0]
    assert alpha.shape == (32, 48)
    np.testing.assert_array_equal(alpha[:, :22], 1.0)
    np.testing.assert_array_equal(alpha[:, 26:], 0.0)
    assert (np.diff(alpha[0]) <= 0).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -5.0], ids=str)
def test_bad_values_in_any_plane_give_a_finite_picture(bad: float, device: Device) -> None:
    frames = [noisy(number, planes=(*PLANES, Role.ALPHA)) for number in (1, 2)]
    for place, role in enumerate(frames[0].planes):
        frames[0][role][4 * place:4 * place + 3, 5] = bad
    for frame in run(frames, device):
        assert all(np.isfinite(plane).all() for plane in frame.planes.values())


def test_bad_pixels_harm_no_other_part_of_the_picture(device: Device) -> None:
    """A block that is too large to be repaired from its rim."""
    good, broken = flat(1, 0.3, 64, 96), flat(1, 0.3, 64, 96)
    broken[Role.COLOUR][4:10, 5:11] = np.nan
    touched = (np.abs(run([broken], device)[0][Role.COLOUR] - run([good], device)[0][Role.COLOUR])
               .max(2) > 3e-3)
    assert touched.any()
    assert not touched[:, 150:].any() and not touched[100:].any()


def test_frame_by_frame_equals_a_run(device: Device) -> None:
    frames = [noisy(number) for number in (1, 2, 3)]
    upscale = Pipeline([DenoiseUpscale(scale=2)])
    single = [upscale(frame)[Role.COLOUR] for frame in frames]
    for one, other in zip(single, run(frames, device, "auto"), strict=True):
        np.testing.assert_array_equal(one, other[Role.COLOUR])


def test_two_runs_give_the_same_bits(device: Device) -> None:
    frames = [noisy(number) for number in (1, 2, 3)]
    for one, other in zip(colours(run(frames, device)), colours(run(frames, device)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_lost_guides_are_remarked() -> None:
    everything = noisy(1).spec
    bare = Frame({Role.COLOUR: noisy(1)[Role.COLOUR]}).spec
    assert DenoiseUpscale().remarks(everything) == ()
    alone, blurred = DenoiseUpscale().remarks(bare)
    assert "no motion vectors" in alone and "normal" in blurred and "motion" not in blurred


def hazy(number: int, share: float) -> Frame:
    """A frame whose depth hits and misses at random in this share of its rows."""
    frame = noisy(number, 48, 64)
    depth = frame.planes[Role.DEPTH].copy()
    rows = round(48 * share)
    depth[:rows][np.random.default_rng(number).random((rows, 64, 1)) < 0.5] = 1e10
    return replace(frame, planes={**frame.planes, Role.DEPTH: depth})


@pytest.mark.parametrize("model", ["s", "classic"])
def test_depth_and_albedo_are_left_out_where_depth_is_noise(device: Device, model: str) -> None:
    shares = (0.0, 0.6, 0.34, 0.2)  # 0.34 is too little noise to begin, and enough to go on
    frames = [hazy(number, share) for number, share in enumerate(shares)]
    lost = (Role.DEPTH, Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO)
    bare = [replace(f, planes={**f.planes, **{role: np.full_like(f.planes[role], role is Role.DEPTH)
                                              for role in lost}})
            if number in (1, 2) else f for number, f in enumerate(frames)]
    pipeline, other = (Pipeline([DenoiseUpscale(scale=2, model=model)], device, exposure=0.0,
                                cuts="none")
                       for _ in range(2))
    for number, (frame, wanted) in enumerate(zip(frames, bare, strict=True)):
        np.testing.assert_array_equal(pipeline(frame)[Role.COLOUR], other(wanted)[Role.COLOUR],
                                      f"frame {number}")
    told = {item.what: item.why for item in pipeline.explain().skips}
    assert told["depth and albedo of 2 frames in denoise_upscale"] == "depth is noise, as in fog"

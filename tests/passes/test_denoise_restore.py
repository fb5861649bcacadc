"""Clean input stays as it is: what the network takes for noise though it is detail is given
back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.kernels.denoise.output import DETAIL, JUDGE, SUMS
from postfx.passes.denoise import DenoiseUpscale, output
from postfx.pipeline import Pipeline
from postfx.runtime import Device

HEIGHT, WIDTH = 93, 118
Y, X = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
PICTURE = (0.4 + 0.25 * np.sin(X / 23)
           + 0.12 * np.sign(np.sin(X * 1.9) * np.sin(Y * 1.3)))[..., None].repeat(3, 2)


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def frame(samples: int, seed: int = 0, **kept) -> Frame:
    """Light with detail that no other plane knows of, and the noise of so many samples a pixel; 0
    has none."""
    noise = np.random.default_rng(seed).gamma(0.8 * max(samples, 1), 1 / (0.8 * max(samples, 1)),
                                              PICTURE.shape)
    colour = PICTURE * (noise if samples else 1)
    flat = {Role.DIFFUSE_ALBEDO: (0.5, 3), Role.NORMAL: (0.6, 3), Role.DEPTH: (3.0, 1),
            Role.MOTION: (0.0, 2)}
    planes = {role: np.full((HEIGHT, WIDTH, n), value, np.float32)
              for role, (value, n) in flat.items()}
    return Frame({Role.COLOUR: colour.astype(np.float32), **planes}, **kept)


def run(frames: list[Frame], device: Device, **options) -> list[np.ndarray]:
    pipeline = Pipeline([DenoiseUpscale(**{"scale": 1, **options})], device, exposure=0.0)
    return [pipeline(item)[Role.COLOUR] for item in frames]


@pytest.fixture
def network_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The result as it leaves the network."""
    monkeypatch.setattr(output.Restore, "encode",
                        lambda self, commands, frame, denoised, *_, **options: denoised)


def quality(picture: np.ndarray) -> float:
    """PSNR of x / (1 + x), in dB."""
    return -10 * np.log10(np.square(picture / (1 + picture) - PICTURE / (1 + PICTURE)).mean())


@pytest.mark.parametrize("samples", [1, 4, 16, 64, 256, 1024, 4096])
def test_no_sample_count_is_made_worse(samples: int, device: Device) -> None:
    given = frame(samples)
    assert quality(run([given], device)[0]) > quality(given[Role.COLOUR]) - 0.1


def test_without_it_clean_input_is_made_worse(network_alone, device: Device) -> None:
    assert quality(run([frame(4096)], device)[0]) < quality(frame(4096)[Role.COLOUR]) - 3


def test_a_clean_picture_comes_back(device: Device) -> None:
    np.testing.assert_allclose(run([frame(0)], device)[0], PICTURE, rtol=1e-4)


def judged(removed: np.ndarray, only: np.ndarray | None = None) -> np.ndarray:
    """Share of detail in a difference on mid grey, tile by tile, of which `only` some are
    judged."""
    grey = np.full((*removed.shape, 3), 0.5, np.float32)
    tiles = [-(-side // 16) for side in removed.shape]
    sums, detail = np.empty((*tiles, SUMS), np.float32), np.empty((*tiles, 1), np.float32)
    counted = (np.ones((*tiles, 1), np.float32) if only is None
               else only[..., None].astype(np.float32))
    noisy = grey + removed.astype(np.float32)[..., None]
    JUDGE.rows(0, tiles[0], noisy, grey, np.ones(5, np.float32), counted, sums)
    DETAIL.rows(0, tiles[0], sums, np.ones(1, np.float32),
                np.zeros((*tiles, 1), np.float32), detail)
    return detail[..., 0]


def test_noise_is_white_detail_is_not_and_the_faint_is_harmless() -> None:
    noise = np.random.default_rng(0).normal(0, 0.05, (80, 96))
    waves = 0.05 * np.sin(np.arange(96) / 2) * np.ones((80, 1))
    assert judged(noise).max() < 0.1
    assert judged(waves).min() == 1
    assert judged(noise / 100).min() == 1
    both = judged(np.where(np.arange(96) < 64, noise, 0.4 * waves))
    assert both[:, :3].max() < 0.2 and both[:, -1].min() > 0.9


def test_tiles_that_are_not_judged_count_for_nothing() -> None:
    """Whatever is there, values that are not numbers too."""
    noise = np.random.default_rng(0).normal(0, 0.05, (80, 96))
    only = np.zeros((5, 6), bool)
    only[1:3, 1:4] = True
    other = np.where(np.kron(only, np.ones((16, 16))) > 0, noise, np.nan)
    waves = np.where(np.isnan(other), 0.05 * np.sin(np.arange(96) / 2), noise)
    found = judged(other, only)
    np.testing.assert_array_equal(judged(waves, only), found)
    assert np.isfinite(found).all() and found[only].max() < 0.1 < judged(waves)[only].max()
    assert np.isfinite(judged(noise, only & False)).all()


def speckled(seed: int = 5, noise: float = 0.0) -> Frame:
    """A texture of single pixels at random in even light, which has so much noise."""
    random = np.random.default_rng(seed)
    given = frame(0)
    albedo = np.random.default_rng(4).choice(np.float32([0.1, 0.45, 0.8]), (HEIGHT, WIDTH, 3))
    light = (0.5 + X / 300)[..., None] * np.float32([1.0, 0.8, 0.6])
    light = light * random.normal(1, noise, (HEIGHT, WIDTH, 1))
    planes = {**given.planes, Role.DIFFUSE_ALBEDO: albedo,
              Role.COLOUR: (albedo * light).astype(np.float16).astype(np.float32)}
    return Frame(planes)


@pytest.mark.parametrize("model", ["l", "xl"])
def test_texture_of_single_pixels_without_noise_stays(model: str, device: Device) -> None:
    """Networks that give the picture take it for noise, in the albedo, too."""
    given = speckled()
    found = run([given], device, model=model)[0]
    np.testing.assert_allclose(found, given[Role.COLOUR], rtol=1e-5)


def test_light_with_a_little_noise_does_not_count_as_even(device: Device) -> None:
    given = speckled(noise=0.01)
    found = run([given], device, model="l")[0]
    assert np.abs(found - given[Role.COLOUR]).max() > 0.05


def test_tiles_show_albedo_in_even_light_where_there_is_no_noise() -> None:
    clean, noisy = speckled(), speckled(noise=0.01)
    assert output.tiles_of_even_light(noisy.planes) is None
    half = {role: np.where(X[..., None] < 64, clean[role], noisy[role]) for role in clean.planes}
    found = output.tiles_of_even_light(half)
    assert found is not None and found.shape == (6, 8)
    assert found[:, :3].all() and not found[:, 4:].any()
    half[Role.DIFFUSE_ALBEDO][:16, :16] = 0  # nothing that the colour is made of
    half[Role.COLOUR][20, 20] = np.nan
    found = output.tiles_of_even_light(half)
    assert found is not None and not found[0, 0] and not found[1, 1] and found[2:, :3].all()
    assert output.tiles_of_even_light({Role.COLOUR: clean[Role.COLOUR]}) is None


def test_only_what_has_strength_tells_whether_a_picture_is_clean(device: Device) -> None:
    """Noise beside it does not, and no network runs there."""
    given = frame(0)
    given[Role.COLOUR][:48] = frame(4)[Role.COLOUR][:48]
    whole = run([given], device, model="s.fp32")[0]
    given.planes[Role.STRENGTH] = np.zeros((HEIGHT, WIDTH, 1), np.float32)
    given.planes[Role.STRENGTH][48:] = 1
    found = run([given], device, model="s.fp32")[0]
    np.testing.assert_array_equal(found[:48], given[Role.COLOUR][:48])
    np.testing.assert_allclose(found[48:], PICTURE[48:], rtol=1e-4)
    assert np.abs(whole[51:] - PICTURE[51:]).max() > 0.02


def test_the_next_frame_sees_what_the_network_made(device: Device,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [frame(64, 1, number=1), frame(64, 2, number=2)]
    restored = run(frames, device)
    encode, turns = output.Restore.encode, iter([False, True])
    monkeypatch.setattr(output.Restore, "encode",
                        lambda *given, **kept: encode(*given, **kept) if next(turns)
                        else given[3])
    plain_first = run(frames, device)
    assert np.abs(restored[0] - plain_first[0]).max() > 1e-2
    np.testing.assert_array_equal(restored[1], plain_first[1])


@pytest.mark.parametrize("facts", [{"jitter": (0.2, 0.0)}, {"samples": 16}],
                         ids=["jittered", "few samples"])
def test_frames_it_leaves_alone(facts: dict, device: Device,
                                request: pytest.FixtureRequest) -> None:
    given = replace(frame(0), **facts)
    found = run([given], device)[0]
    request.getfixturevalue("network_alone")
    np.testing.assert_array_equal(found, run([given], device)[0])


def test_an_enlarged_result_is_the_networks(device: Device, request: pytest.FixtureRequest) -> None:
    found = run([frame(0)], device, scale=2)[0]
    request.getfixturevalue("network_alone")
    np.testing.assert_array_equal(found, run([frame(0)], device, scale=2)[0])


def test_bad_pixels_of_a_clean_picture(device: Device) -> None:
    given = frame(0)
    given[Role.COLOUR][20:23, 30] = np.array([np.nan, np.inf, -np.inf])[:, None]
    found = run([given], device)[0]
    assert np.isfinite(found).all() and found.min() >= 0


def test_compiled_and_portable_kernels_agree(device: Device) -> None:
    portable = Device("cpu", threads=2, compiled_kernels=False)
    one, other = (run([frame(64)], place)[0] for place in (device, portable))
    np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3)

"""Noise that repeats is noticed, and no history is made of it; other noise, and pictures without,
are left alone."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from postfx import DenoiseUpscale, Device, Frame, Pipeline, Role
from postfx.cli.main import main
from postfx.repeats import RepeatDetector

HEIGHT, WIDTH = 96, 160


def clean(at: float = 0.0, lamp: float = 1.0) -> np.ndarray:
    """A wall with soft light and a texture, that moves to the left by `at` pixels."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
    x = x + at
    light = 0.6 + 0.4 * np.sin(x / 40) * np.cos(y / 30)
    texture = 1 + 0.3 * np.sin(0.9 * x + 0.4 * y) * (y > HEIGHT / 2)
    return (lamp * light * texture)[..., None] * (0.9, 0.7, 0.5)


def frame(number: int, samples: int | None = 4, seed: int | None = None, speed: float = 0.0,
          lamp: float = 1.0, still_rows: int = 0, **kept) -> Frame:
    """Of so many samples, or without noise; the upper rows may stand still."""
    picture = clean(speed * number, lamp)
    picture[:still_rows] = clean(0, lamp)[:still_rows]
    random = np.random.default_rng(number if seed is None else seed)
    noise = random.gamma(samples, 1 / samples, (HEIGHT, WIDTH, 1)) if samples else 1.0
    motion = np.full((HEIGHT, WIDTH, 2), (speed, 0), np.float32)
    motion[:still_rows] = 0
    return Frame({Role.COLOUR: (picture * noise).astype(np.float32), Role.MOTION: motion},
                 number=number, **kept)


def found(*frames: Frame) -> list[bool]:
    detect = RepeatDetector()
    return [detect(one.planes) for one in frames]


SAME = {
    "still": {},
    "slow": {"speed": 0.3},
    "many samples": {"samples": 64},
    "some of it still": {"speed": 5.0, "still_rows": 24},
}


@pytest.mark.parametrize("kind", SAME)
def test_the_same_noise_is_found(kind):
    assert found(*(frame(number, seed=7, **SAME[kind]) for number in (1, 2, 3))) == [False, True,
                                                                                     True]


def test_the_same_noise_in_other_light_is_found():
    assert found(*(frame(number, seed=7, lamp=1 + 0.3 * number) for number in (1, 2))) == [False,
                                                                                           True]


OTHER = {
    "new noise": {},
    "new noise of one sample": {"samples": 1},
    "new noise of many samples": {"samples": 1024},
    "no noise": {"samples": None},
    "no noise that pans": {"samples": None, "speed": 0.4},
    "new noise that pans": {"speed": 0.4},
    "the same noise that other noise meets": {"seed": 7, "speed": 4.0},
}


@pytest.mark.parametrize("kind", OTHER)
def test_nothing_else_is_found(kind):
    assert not any(found(*(frame(number, **OTHER[kind]) for number in (1, 2, 3))))


def test_a_textured_albedo_is_no_noise():
    """Of one pixel, at random, as gravel: white like noise, but the albedo explains it."""
    albedo = np.random.default_rng(3).uniform(0.1, 0.9, (HEIGHT, WIDTH, 3)).astype(np.float32)
    planes = {**frame(1, None).planes, Role.DIFFUSE_ALBEDO: albedo}
    planes[Role.COLOUR] = planes[Role.COLOUR] * albedo
    assert not any(found(*(replace(frame(1), planes=planes) for _ in range(3))))


def test_frames_of_another_size_and_small_ones_are_not_compared():
    small = Frame({role: plane[:8, :8] for role, plane in frame(1).planes.items()})
    half = Frame({role: plane[:48, :80] for role, plane in frame(1).planes.items()})
    assert found(frame(1), half, small, small) == [False] * 4


def test_it_goes_on_from_its_history():
    detect, other = RepeatDetector(), RepeatDetector()
    detect(frame(1, seed=7).planes)
    other.recall(detect.history())
    assert other(frame(2, seed=7).planes)
    other.recall({})
    assert not other(frame(3, seed=7).planes)


def psnr(picture: np.ndarray, truth: np.ndarray) -> float:
    one, other = ((light / (1 + light)) ** (1 / 2.2) for light in (np.maximum(picture, 0), truth))
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_a_history_never_makes_one_seed_worse(speed, caplog):
    """And new noise still gains by it."""
    quality, last = {}, 12
    for seed in (7, None):
        passes = Pipeline([DenoiseUpscale(model="s")], Device("cpu"), exposure=0.0)
        with caplog.at_level(logging.WARNING, "postfx"):
            for number in range(1, last + 1):
                result = passes(frame(number, seed=seed, speed=speed))
            told = [record.message for record in caplog.records]
            caplog.clear()
        alone = passes(frame(last, seed=seed, speed=speed, reset=True))
        truth = clean(speed * last)
        quality[seed] = psnr(result[Role.COLOUR], truth) - psnr(alone[Role.COLOUR], truth)
        assert result[Role.COLOUR].mean() == pytest.approx(truth.mean(), rel=0.03)
        lines = [line for line in told if "the same random seed in every frame" in line]
        assert len(lines) == (seed is not None), told
    assert lines == []
    assert quality[7] > -0.3
    assert quality[None] > 1


def test_what_was_left_out_is_explained():
    passes = Pipeline([DenoiseUpscale(model="s")], Device("cpu"))
    for number in range(1, 4):
        passes(frame(number, seed=7))
    assert ("history for 2 frames in denoise_upscale: noise is that of the frame "
            "before" in str(passes.explain()))


def test_the_command_warns_once_with_the_fix(write_exr, tmp_path, capsys):
    for number in range(1, 5):
        planes = frame(number, seed=7).planes
        names = dict(zip("RGB", np.moveaxis(planes[Role.COLOUR], -1, 0), strict=True))
        write_exr(f"in/shot.{number:04d}.exr", names | {"motion.X": np.zeros((HEIGHT, WIDTH)),
                                                        "motion.Y": np.zeros((HEIGHT, WIDTH))})
    assert main(["run", str(tmp_path / "in"), "-o", str(tmp_path / "out/"), "--model", "s",
                 "--device", "cpu"]) == 0
    said = capsys.readouterr()
    lines = [line
             for line in said.err.splitlines() if "the same random seed in every frame" in line]
    assert len(lines) == 1, said.err
    assert (lines[0].startswith("warning  frame 1: ") and "change the seed with the frame "
            "number" in lines[0])

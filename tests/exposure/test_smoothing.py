"""Two passes: the curve is smooth, lags behind nothing and is broken at cuts."""

from __future__ import annotations

import numpy as np
import pytest

import postfx
from postfx.exposure import ExposureMeter, Metered, SmoothExposure, colours_of, metered, smooth_ev
from postfx.frame import Role
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.exposure.scenes import scene
from tests.test_pipeline import Probe

WIDTH = 12.0  # half a second at 24 frames a second


def readings(ev: np.ndarray, cuts: tuple[int, ...] = ()) -> list[Metered]:
    return [Metered(index + 1, value, index in cuts) for index, value in enumerate(ev)]


def curve(ev: np.ndarray, cuts: tuple[int, ...] = ()) -> np.ndarray:
    found = smooth_ev(readings(ev, cuts), WIDTH)
    assert list(found) == list(range(1, len(ev) + 1))
    return np.array(list(found.values()))


def test_a_steady_change_is_followed_exactly_up_to_both_ends() -> None:
    ramp = np.linspace(-1, 2, 60)
    np.testing.assert_allclose(curve(ramp), ramp, atol=1e-9)


def test_a_step_is_met_half_way_on_its_frame_and_alike_on_both_sides() -> None:
    step = np.repeat([0.0, 1.0], 100)
    found = curve(step)
    np.testing.assert_allclose(found + found[::-1], 1.0, atol=1e-9)  # no phase: backwards it is the same curve
    assert abs(found[:40]).max() < 1e-6 and 0.4 < found[99] < 0.5 < found[100] < 0.6
    meter = ExposureMeter()
    late = [np.log2(meter(frame)) for frame in scene(step)]
    assert np.argmax(np.array(late) > 0.5) > 110  # what looks back only is late


def test_noise_of_the_meter_is_taken_out() -> None:
    noise = np.random.default_rng(1).normal(0, 0.1, 240)
    found = curve(noise)
    assert found.std() < 0.03 and abs(np.diff(found)).max() < 0.01


def test_shots_do_not_know_of_each_other() -> None:
    ev = np.concatenate([np.linspace(0, 1, 20), np.full(20, -3.0), np.linspace(2, 0, 20)])
    np.testing.assert_allclose(curve(ev, (0, 20, 40)), ev, atol=1e-9)
    assert abs(curve(ev)[19] - 1.0) > 1  # and without the cuts they do


def test_black_frames_are_bridged_and_a_black_shot_has_no_exposure() -> None:
    ev = list(np.linspace(0, 1, 30))
    ev[10:14] = [None] * 4
    np.testing.assert_allclose(curve(ev), np.linspace(0, 1, 30), atol=1e-9)
    assert curve([None, None, 1.5], (0, 2)).tolist() == [0.0, 0.0, 1.5]
    assert curve([2.0, *[None] * 80])[-1] == 2.0


def test_it_is_metered_once_and_used_as_a_meter() -> None:
    needed = np.linspace(0, 1, 8)
    once = iter(list(scene(needed)))
    smooth = SmoothExposure(once)
    frames = list(scene(needed))
    forwards = [smooth(frame) for frame in frames]
    np.testing.assert_allclose(np.log2(forwards), np.linspace(0, 1, 8), atol=0.03)
    assert [smooth(frame) for frame in reversed(frames)] == forwards[::-1]
    smooth.reset()
    assert smooth(frames[3]) == forwards[3]


def test_the_pipeline_takes_it() -> None:
    frames = list(scene([0.0, 1.0], cuts=(1,)))
    pipeline = Pipeline([Probe()], Device("cpu"), SmoothExposure(frames))
    found = []
    for frame in frames:
        pipeline(frame)
        found.append(np.log2(pipeline.exposure))
    np.testing.assert_allclose(found, [0, 1], atol=0.03)


def test_frames_before_the_sequence_have_the_first_ones_exposure() -> None:
    first, second = scene([1.0, 3.0], cuts=(1,))
    smooth = SmoothExposure([first, second])
    early, late = next(scene([0.0])), next(scene([0.0]))
    early.number, late.number = -5, 99
    assert (smooth(early), smooth(late)) == (smooth(first), smooth(second))


def test_metering_reads_colour_only_and_disturbs_no_other_reader(write_exr) -> None:
    for number in (1, 2, 3):
        planes = {name: np.full((8, 8), 0.5) for name in ("R", "G", "B", "depth.Z")}
        folder = write_exr(f"in/shot.{number:04d}.exr", planes).parent
    sequence = postfx.read_sequence(folder)
    sequence.read(1)
    seen = [(frame.number, tuple(frame.planes), frame.reset) for frame in colours_of(sequence)]
    assert seen == [(number, (Role.COLOUR,), False) for number in (1, 2, 3)]
    assert not sequence.read(2).reset and sequence.warnings == []


@pytest.mark.parametrize("name", ("living_room", "staircase", "garage"))
def test_the_curve_of_a_render_stays_with_its_readings(name: str, shared_dir) -> None:
    sequence = postfx.read_sequence(shared_dir / "sequences" / name / "noisy.####.exr")
    found = list(metered(colours_of(sequence)))
    smooth = np.array(list(smooth_ev(found, WIDTH).values()))
    raw = np.array([reading.ev for reading in found])
    assert abs(smooth - raw).max() < 0.1 and abs(np.diff(smooth, 2)).max() < abs(np.diff(raw, 2)).max() / 3

"""Frames with what the frames after them make of them: which are run, in what order, and what comes
out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.passes.composite import BothWays
from postfx.passes.denoise import DenoiseUpscale
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.temporal import reverse_order
from postfx.temporal.reverse_order import Backwards

SIZE = 32, 48


@pytest.fixture
def noisy(write_exr: Callable[..., Path], tmp_path: Path) -> Callable[..., Sequence]:
    """Writes frames of one grey wall at rest, each with noise of its own, and gives them as a
    sequence."""

    def write(count: int, cut: int = 0, level: float = 0.5) -> Sequence:
        rng = np.random.default_rng(count)
        for number in range(1, count + 1):
            light = level if not cut or number < cut else 8 * level
            planes = {name: light * rng.exponential(size=SIZE) for name in "RGB"}
            planes |= {f"albedo.{name}": np.full(SIZE, 0.5) for name in "RGB"}
            planes |= {"depth.Z": np.full(SIZE, 3.0), "motion.X": np.zeros(SIZE),
                       "motion.Y": np.zeros(SIZE)}
            write_exr(f"in/shot.{number:04d}.exr", planes,
                      **({"postfx__reset": 1} if number == cut else {}))
        return Sequence(tmp_path / "in/shot.####.exr")

    return write


def results(sequence: Sequence, device: Device, both: bool = True,
            exposure: str | float = 0.0) -> dict:
    """Colour by frame number."""
    backwards = Backwards(sequence, device, exposure, model="s") if both else lambda frame: frame
    passes = Pipeline([DenoiseUpscale(model="s"), BothWays()], device, exposure)
    return {frame.number: passes(backwards(frame))[Role.COLOUR] for frame in sequence}


def spread(colour: np.ndarray) -> float:
    return float(colour.std())


def test_first_frames_profit_from_those_after_them(noisy, device):
    sequence = noisy(8)
    causal, both = results(sequence, device, both=False), results(sequence, device)
    assert spread(both[1]) < 0.8 * spread(causal[1])
    assert spread(both[4]) < spread(causal[4])
    assert abs(both[1].mean() / causal[8].mean() - 1) < 0.02


def test_the_last_frame_has_nothing_after_it(noisy, device):
    """Its run in reverse order begins with it: a first frame, which counts for a ninth beside
    eight."""
    sequence = noisy(8)
    later = Backwards(sequence, device, 0.0, model="s")
    planes = [later(frame).guides[Role.LATER] for frame in sequence]
    assert np.allclose(planes[7][..., 3], 1 / 9, atol=1e-6)
    assert np.allclose(planes[0][..., 3], 8 / 9, atol=1e-6)


@pytest.mark.parametrize("level", [1e-7, 1e7])
def test_light_of_any_unit_is_kept(noisy, device, level):
    """Beyond what half precision holds: results are kept exposed."""
    causal, both = (results(noisy(6, level=level), device, way, exposure="auto")
                    for way in (False, True))
    assert abs(both[1].mean() / causal[6].mean() - 1) < 0.05


def test_light_after_a_cut_does_not_come_before_it(noisy, device):
    both = results(noisy(8, cut=5), device)
    assert both[4].mean() < 1.1 * both[1].mean() < 0.25 * both[5].mean()


def test_a_frame_does_not_depend_on_which_are_asked_for(noisy, device, monkeypatch):
    monkeypatch.setattr(reverse_order, "PART_FRAMES", 3)
    monkeypatch.setattr(reverse_order, "RUN_UP", 2)
    sequence = noisy(8)
    backwards = Backwards(sequence, device, 0.0, model="s")
    whole = {frame.number: backwards(frame).guides[Role.LATER] for frame in sequence}
    for number in (2, 5, 8):
        fresh = Backwards(sequence, device, 0.0, model="s")
        sequence.rewind()
        np.testing.assert_array_equal(fresh(sequence.read(number)).guides[Role.LATER],
                                      whole[number])


def test_frames_after_those_that_are_asked_for_count_too(noisy, device):
    whole, part = noisy(8), read_sequence(noisy(8).pattern.path(1).parent / "shot.####.exr", "3-4")
    wanted, found = (Backwards(sequence, device, 0.0, model="s")(sequence.read(4))
                     for sequence in (whole, part))
    np.testing.assert_array_equal(found.guides[Role.LATER][..., :3] != 0,
                                  wanted.guides[Role.LATER][..., :3] != 0)
    # 5 frames, and 2 that were asked for
    assert np.allclose(found.guides[Role.LATER][..., 3], 5 / 7, atol=1e-6)
    assert part.numbers == (3, 4)


def test_parts_are_run_from_behind_with_a_run_up(noisy, device, monkeypatch):
    monkeypatch.setattr(reverse_order, "PART_FRAMES", 3)
    monkeypatch.setattr(reverse_order, "RUN_UP", 2)
    sequence, order = noisy(7), []
    backwards = Backwards(sequence, device, 0.0, model="s")
    read = Backwards._read
    monkeypatch.setattr(Backwards, "_read",
                        lambda self, index: order.append(index + 1) or read(self, index))
    for frame in sequence:
        assert (backwards.part(frame.number) is not None) == (frame.number in (1, 4, 7))
        backwards(frame)
        assert backwards.milliseconds > 0
    assert order == [5, 4, 3, 2, 1, 7, 6, 5, 4, 7]


def test_a_frame_that_is_not_wanted_is_only_followed(noisy, device, monkeypatch):
    sequence = noisy(3)
    backwards = Backwards(sequence, device, 0.0, model="s")
    monkeypatch.setattr(backwards, "_run", lambda *_: pytest.fail("nothing is to be run"))
    assert not backwards(sequence.read(1), wanted=False).guides[Role.LATER].any()
    assert backwards.milliseconds is None


def test_the_time_of_the_other_views_is_added(noisy, device, monkeypatch):
    class View:
        def __init__(self, milliseconds: float | None) -> None:
            self.milliseconds = milliseconds

        def __call__(self, frame: Frame, *_: object) -> Frame:
            return frame

    sequence, times = noisy(2), {"left": 5.0, "middle": None, "right": 7.0}
    backwards, frame = Backwards(sequence, device, 0.0, model="s"), sequence.read(1)
    monkeypatch.setattr(backwards, "_of_view", lambda name: View(times[name]))
    seen = dataclasses.replace(frame, views=dict.fromkeys(times, frame))
    backwards(seen, wanted=False)
    assert backwards.milliseconds == 12
    backwards(seen)
    assert backwards.milliseconds > 12


def test_a_frame_that_cannot_be_read_leaves_the_others_as_they_are(noisy, device, tmp_path):
    sequence = noisy(5)
    (tmp_path / "in/shot.0003.exr").write_bytes(b"no picture")
    backwards = Backwards(sequence, device, 0.0, model="s")
    weights = [float(backwards(sequence.read(number)).guides[Role.LATER][0, 0, 3])
               for number in (1, 2, 4, 5)]
    np.testing.assert_allclose(weights, [2 / 3, 1 / 3, 2 / 3, 1 / 3], atol=1e-6)


def test_asking_may_be_stopped_between_two_frames(noisy, device):
    calls = []

    def check() -> None:
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt

    sequence = noisy(6)
    with pytest.raises(KeyboardInterrupt):
        Backwards(sequence, device, 0.0, model="s")(sequence.read(1), check=check)


def test_whoever_iterates_the_sequence_is_not_disturbed(noisy, device):
    sequence = noisy(4)
    backwards = Backwards(sequence, device, 0.0, model="s")
    assert [backwards(frame).reset for frame in sequence] == [False] * 4
    assert sequence.warnings == []


def test_without_motion_both_runs_are_of_single_frames(device, write_exr, tmp_path):
    """So the frames beside a frame change nothing in it."""
    rng = np.random.default_rng(1)
    found = []
    for name in "ab":
        for number in (1, 2, 3):
            noise = np.random.default_rng(7) if number == 2 else rng
            planes = {channel: noise.exponential(size=SIZE) for channel in "RGB"}
            write_exr(f"still/{name}.{number:04d}.exr", planes)
        sequence = Sequence(tmp_path / f"still/{name}.####.exr")
        found.append(results(sequence, device)[2])
    np.testing.assert_array_equal(found[0], found[1])


def test_results_of_another_size_are_not_mixed_in(noisy, device):
    sequence = noisy(2)
    backwards = Backwards(sequence, device, 0.0, model="s")
    small = Frame({Role.COLOUR: np.ones((16, 24, 3), np.float32)}, 1)
    assert not backwards(small).guides[Role.LATER].any()

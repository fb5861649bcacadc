"""The run-up to the first frame of a shot: which frames are run, as what, and what it is worth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from postfx.errors import FrameError
from postfx.frame import Frame, Role
from postfx.io.sequence import Sequence, read_sequence
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.tonemap import ToneMap
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from postfx.temporal.reverse_order import RunUp

SIZE = 32, 48


@pytest.fixture
def noisy(write_exr: Callable[..., Path], tmp_path: Path) -> Callable[..., Sequence]:
    """Writes frames of a grey wall, each with noise of its own, that moves by a pixel a frame, and
    gives them as a sequence."""

    def write(count: int = 8, cut: int = 0, motion: float | None = -1.0, without: int = 0,
              **options) -> Sequence:
        rng = np.random.default_rng(count)
        for number in range(1, count + 1):
            light = 0.1 if cut and number >= cut else 0.5
            planes = {name: light * rng.exponential(size=SIZE) for name in "RGB"}
            planes |= ({f"albedo.{name}": np.full(SIZE, 0.5) for name in "RGB"}
                       | {"depth.Z": np.full(SIZE, 3.0)})
            if motion is not None:
                planes |= {"motion.X": np.full(SIZE, motion), "motion.Y": np.zeros(SIZE)}
            if number != without:
                write_exr(f"in/shot.{number:04d}.exr", planes,
                          **({"postfx__reset": 1} if number == cut else {}))
        return read_sequence(tmp_path / "in/shot.####.exr", **options)

    return write


def seen(sequence: Sequence, frame: Frame | None = None, **options) -> tuple[list[Frame], Frame]:
    """The frames that are run before one, by default the first, and as what it is run."""
    found = []
    frame = frame or next(iter(sequence))
    return found, RunUp(sequence, **options)(frame, found.append)


def numbers(sequence: Sequence, frame: Frame | None = None, **options) -> list[int]:
    return [frame.number for frame in seen(sequence, frame, **options)[0]]


def results(sequence: Sequence, device: Device, run_up: bool = True, *others,
            **options) -> dict[int, np.ndarray]:
    """Colour by frame number."""
    passes = Pipeline([DenoiseUpscale(model="s", **options), *others], device, 0.0,
                      run_up=RunUp(sequence) if run_up else None)
    return {frame.number: passes(frame)[Role.COLOUR] for frame in sequence}


def test_frames_run_in_reverse_order_with_motion_to_the_next(noisy):
    found, first = seen(noisy(12))
    assert [frame.number for frame in found] == [9, 8, 7, 6, 5, 4, 3, 2]
    assert [frame.reset for frame in (*found, first)] == [True, *[False] * 8]
    inner = first[Role.MOTION][2:-2, 4:-4]
    assert np.allclose(inner, (1.0, 0.0))
    assert first.number == 1


def test_a_first_frame_is_as_clean_as_later_ones(noisy, device):
    sequence = noisy(motion=0.0)
    alone, found = results(sequence, device, run_up=False), results(sequence, device)
    assert found[1].std() < 0.7 * alone[1].std()
    assert found[1].std() < 1.2 * alone[5].std()
    assert abs(found[1].mean() / alone[8].mean() - 1) < 0.02


@pytest.mark.parametrize(("options", "expected"), [
    ({"frames": 2}, [3, 2]), ({"frames": 20}, [8, 7, 6, 5, 4, 3, 2]), ({"frames": 0}, [])])
def test_as_many_as_asked_for_and_there(noisy, options, expected):
    assert numbers(noisy(), **options) == expected


def test_the_last_frame_has_nothing_after_it(noisy):
    sequence = noisy()
    assert numbers(sequence, list(sequence)[-1]) == []


def test_it_ends_at_a_hole_and_at_a_known_cut(noisy):
    assert numbers(noisy(without=4)) == [3, 2]
    assert numbers(noisy(cuts=[3])) == [2]


def test_frames_that_are_not_followed_by_their_next_have_none(noisy):
    assert numbers(noisy(frames="1-8x2")) == []
    for frames in ("1", "1-2"):  # which are as in the whole shot
        assert numbers(noisy(frames=frames)) == [8, 7, 6, 5, 4, 3, 2]


def test_a_cut_in_a_header_begins_anew(noisy, device):
    sequence = noisy(cut=4, motion=0.0)
    found, _ = seen(sequence)
    assert [(frame.number, frame.reset) for frame in found] == [(3, True), (2, False)]
    alone, clean = results(sequence, device, run_up=False), results(sequence, device)
    assert abs(clean[1].mean() / alone[3].mean() - 1) < 0.05
    assert clean[4].std() < 0.9 * alone[4].std()


def test_a_cut_in_the_pictures_begins_anew(write_exr, tmp_path):
    """Two pictures of other detail, without a word in the headers."""
    rng = np.random.default_rng(3)
    shots = [rng.uniform(0.1, 1.0, (8, 12)).repeat(12, 0).repeat(12, 1) for _ in range(2)]
    for number in range(1, 6):
        colour = shots[number > 3]
        planes = {name: colour * rng.uniform(0.9, 1.1, colour.shape) for name in "RGB"}
        planes |= {name: np.zeros(colour.shape) for name in ("motion.X", "motion.Y")}
        write_exr(f"in/shot.{number:04d}.exr", planes)
    sequence = Sequence(tmp_path / "in/shot.####.exr")
    found, first = seen(sequence)
    assert [frame.reset for frame in (*found, first)] == [True, False, True, False, False]
    found, first = seen(sequence, cuts="none")
    assert not any(frame.reset for frame in (*found[1:], first))


@pytest.mark.parametrize("broken", [2, 3])
def test_a_frame_that_cannot_be_read_ends_what_counts(noisy, device, tmp_path, broken):
    sequence = noisy()
    (tmp_path / f"in/shot.{broken:04d}.exr").write_bytes(b"no picture")
    assert numbers(sequence) == list(range(broken - 1, 1, -1))


@pytest.mark.parametrize("broken", [2, 3])
def test_nor_does_what_is_beyond_a_frame_that_lacks_pixels(noisy, tmp_path, broken):
    sequence, path = noisy(), tmp_path / f"in/shot.{broken:04d}.exr"
    path.write_bytes(path.read_bytes()[:-2000])
    found, first = seen(sequence)
    assert [frame.number for frame in found] == [number
                                                 for number in range(8, 1, -1) if number != broken]
    assert first.reset == (broken == 2)
    assert found[-1].reset == (broken == 3)


def test_where_every_frame_begins_a_shot_none_is_run(noisy, write_exr):
    sequence = noisy()
    for number in range(1, 9):
        planes = {name: np.ones(SIZE) for name in (*"RGB", "depth.Z", "motion.X", "motion.Y")}
        write_exr(f"in/shot.{number:04d}.exr", planes, postfx__reset=1)
    assert [numbers(sequence, frame) for frame in sequence] == [[]] * 8


def test_history_beyond_a_frame_that_cannot_be_read_is_dropped(noisy, device, tmp_path):
    sequence, path = noisy(), tmp_path / "in/shot.0002.exr"
    path.write_bytes(path.read_bytes()[:-2000])
    first = next(iter(sequence))
    passes = Pipeline([DenoiseUpscale(model="s")], device, 0.0, run_up=RunUp(sequence))
    alone = Pipeline([DenoiseUpscale(model="s")], device, 0.0)
    np.testing.assert_array_equal(passes(first)[Role.COLOUR], alone(first)[Role.COLOUR])
    assert len(passes.ahead) == 6 and passes.run_up_ms > sum(passes.ahead)


def test_frames_of_another_size_do_not_count(noisy, write_exr):
    sequence = noisy()
    write_exr("in/shot.0003.exr",
              {name: np.ones((20, 30)) for name in (*"RGB", "depth.Z", "motion.X", "motion.Y")})
    assert numbers(sequence) == [8, 7, 6, 5, 4, 2]


def test_a_frame_that_fails_is_no_error(noisy):
    def run(frame: Frame) -> None:
        if frame.number == 3:
            raise FrameError("frame 3: no")
        found.append((frame.number, frame.reset))

    found, sequence = [], noisy()
    RunUp(sequence)(next(iter(sequence)), run)
    assert found == [(8, True), (7, False), (6, False), (5, False), (4, False), (2, True)]


def test_frames_are_prepared_like_those_in_order(noisy):
    def grey(frame: Frame) -> Frame:
        frame.planes[Role.COLOUR] = np.ones_like(frame[Role.COLOUR])
        return frame

    assert all((frame[Role.COLOUR] == 1).all() for frame in seen(noisy(), prepare=grey)[0])


def test_only_planes_that_are_used_are_read(noisy):
    sequence = noisy()
    first = sequence.read(1, [Role.COLOUR, Role.MOTION])
    assert all(set(frame.planes) == {Role.COLOUR, Role.MOTION}
               for frame in seen(sequence, first)[0])


@pytest.mark.parametrize("options", [{"strength": 0.0}, {}])
def test_nothing_is_run_where_no_pass_gains(noisy, device, options):
    """Without strength no network runs, without motion it has no use for other frames."""
    sequence = noisy(motion=-1.0 if options else None)
    passes = Pipeline([DenoiseUpscale(model="s", **options)], device, run_up=RunUp(sequence))
    passes(next(iter(sequence)))
    assert passes.ahead == ()


def test_a_pipeline_runs_up_once_a_shot(noisy, device):
    sequence = noisy(cut=6)
    passes = Pipeline([DenoiseUpscale(model="s")], device, run_up=RunUp(sequence, frames=2))
    assert [len((passes(frame), passes.ahead)[1]) for frame in sequence] == [2, 0, 0, 0, 0, 2, 0, 0]
    passes.reset()
    frame = next(iter(sequence))
    passes(frame)
    assert len(passes.ahead) == 2


def test_what_comes_out_is_the_frame_itself(noisy, device):
    """Its reset, its exposure and what was left out are those of the frame, not of those that were
    run before it."""
    sequence = noisy(cut=1)
    plain, passes = (Pipeline([DenoiseUpscale(model="s")], device, run_up=run)
                     for run in (None, RunUp(sequence)))
    for frame in sequence:
        expected, found = plain(frame), passes(frame)
        assert (found.number, found.reset, found.spec) == (expected.number, expected.reset,
                                                           expected.spec)
        assert passes.exposure == plain.exposure
    assert [item.what for item in plain.savings()] == ["history for 1 frame in denoise_upscale"]
    assert passes.savings() == []


def test_passes_behind_the_denoiser_do_not_run_ahead(noisy, device):
    sequence = noisy()
    mapped = results(sequence, device, True, ToneMap())
    plain = results(sequence, device)
    alone = Pipeline([ToneMap()], device, 0.0)
    for number in plain:
        expected = alone(Frame({Role.COLOUR: plain[number]}, number=number))[Role.COLOUR]
        np.testing.assert_array_equal(mapped[number], expected)


def test_a_recalled_history_needs_none(noisy, device):
    sequence = noisy()
    one, two = (Pipeline([DenoiseUpscale(model="s")], device, 0.0, run_up=RunUp(sequence))
                for _ in range(2))
    frames = list(sequence)
    expected = [one(frame)[Role.COLOUR] for frame in frames[:3]][2]
    one.reset()
    one(frames[0]), one(frames[1])
    two.recall(frames[1], one.history())
    found = two(frames[2])[Role.COLOUR]
    assert two.ahead == ()
    np.testing.assert_array_equal(found, expected)

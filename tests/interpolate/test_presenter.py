"""Pictures are shown in even steps; late ones by rule. By a clock that is moved, and by the
machine's."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import OpenImageIO as oiio
import pytest

from postfx import Presenter
from postfx.errors import PostfxError
from postfx.presenter import Pacing, Shown

TURN = 1 / 120


class MovedClock:
    """Time passes where a test says so, or someone waits; waiting may end late, as a system's
    does."""

    def __init__(self, jitter: Callable[[], float] = lambda: 0.0) -> None:
        self.time, self._jitter = 100.0, jitter

    def now(self) -> float:
        return self.time

    def wait_until(self, moment: float) -> None:
        if moment > self.time:
            self.time = moment + self._jitter()


class Renderer:
    """Renders frames, each of which takes some time, makes the one between, and presents both."""

    def __init__(self, clock: MovedClock) -> None:
        self.seen: list[tuple[str, float]] = []
        self.clock = clock
        self.presenter = Presenter(self._show, TURN, clock)

    def _show(self, picture: str) -> None:
        self.seen.append((picture, self.clock.time))

    def frame(self, number: int, takes: float, between_takes: float = 0.001) -> None:
        self.clock.time += takes + between_takes
        if number:
            self.presenter.present(f"{number - 1}.5", between=True)
        self.presenter.present(f"{number}")


def test_pictures_in_time_are_shown_at_their_turns() -> None:
    """Whatever the frames take, as long as it is less than two turns."""
    renderer = Renderer(MovedClock())
    for number in range(60):
        renderer.frame(number, (0.002, 0.0001, 0.005)[number % 3])
    pacing = renderer.presenter.pacing()
    assert [float(name) for name, _ in renderer.seen] == [0, *(k / 2 for k in range(1, 119))]
    assert (pacing.intervals == pytest.approx([TURN] * 118)
            and list(pacing.histogram.values()) == [118])
    assert (pacing.dropped, pacing.late, pacing.missed) == (0, 0, 0)


def test_a_clock_that_wakes_late_fills_two_buckets_at_most() -> None:
    """Half a millisecond of 8.3, now and then: errors do not add up."""
    late = iter([0.0, 0.0005, 0.0001, 0.0003, 0.0] * 100)
    renderer = Renderer(MovedClock(lambda: next(late)))
    for number in range(60):
        renderer.frame(number, 0.003)
    pacing = renderer.presenter.pacing()
    assert len(pacing.histogram) <= 2 and pacing.dropped == 0
    assert renderer.seen[-1][1] - renderer.seen[0][1] == pytest.approx(118 * TURN, abs=0.001)


def test_a_late_frame_between_is_left_out_and_the_rendered_one_keeps_its_turn() -> None:
    renderer = Renderer(MovedClock())
    renderer.frame(0, 0.003)
    renderer.frame(1, 1.5 * TURN)
    assert [name for name, _ in renderer.seen] == ["0", "1"]
    assert renderer.presenter.pacing().intervals == pytest.approx([2 * TURN])
    assert renderer.presenter.pacing().dropped == 1
    renderer.frame(2, 0.003)
    assert [name for name, _ in renderer.seen[2:]] == ["1.5", "2"]


def test_a_late_rendered_frame_waits_for_a_whole_turn_and_the_others_follow() -> None:
    renderer = Renderer(MovedClock())
    renderer.frame(0, 0.003)
    renderer.frame(1, 3.4 * TURN)
    renderer.frame(2, 0.003)
    assert [name for name, _ in renderer.seen] == ["0", "1", "1.5", "2"]
    pacing = renderer.presenter.pacing()
    assert pacing.intervals == pytest.approx([4 * TURN, TURN, TURN]) and pacing.missed == 3
    assert list(pacing.histogram) == pytest.approx([TURN, 4 * TURN])


def test_a_little_late_is_shown_at_once() -> None:
    renderer = Renderer(MovedClock())
    renderer.frame(0, 0.0)
    renderer.clock.time += 1.2 * TURN
    assert renderer.presenter.present("0.5", between=True).at == renderer.clock.time
    assert renderer.presenter.present("1").due == pytest.approx(renderer.seen[0][1] + 2 * TURN)


def test_steps_stay_whole_where_the_system_wakes_late_by_most_of_a_turn() -> None:
    """As on a busy machine: no picture comes right before the next one."""
    late = iter([0.0, 0.0, 0.95 * TURN, 0.0, 0.0, 0.0, 1.4 * TURN] * 100)
    renderer = Renderer(MovedClock(lambda: next(late)))
    for number in range(60):
        renderer.frame(number, 0.003)
    pacing = renderer.presenter.pacing()
    turns = [one / TURN for one in pacing.intervals]
    assert turns == pytest.approx([round(one) for one in turns]) and min(turns) > 0.9
    assert pacing.dropped and pacing.late == 0
    rendered = [name for name, _ in renderer.seen if "." not in name]
    assert rendered == [f"{number}" for number in range(60)]


def test_a_clock_that_always_wakes_late_shows_rendered_frames_all_the_same() -> None:
    renderer = Renderer(MovedClock(lambda: 0.6 * TURN))
    for number in range(5):
        renderer.frame(number, 0.003)
    assert [name for name, _ in renderer.seen if "." not in name] == list("01234")


def test_what_the_system_says_of_a_picture_counts() -> None:
    clock = MovedClock()
    presenter = Presenter(lambda _: clock.time + 0.001, TURN, clock)
    assert presenter.present("a").at == pytest.approx(100.001)


def test_by_the_machine_s_clock_pictures_come_in_even_steps() -> None:
    """Handed over from frames that take unequally long. The machine may be busy: most intervals
    count."""
    turn, seen = 0.1, []
    with Presenter(lambda picture: seen.append(picture), turn) as presenter:
        for number in range(12):
            time.sleep(0.06 * (number % 2))
            presenter.submit(number - 0.5, between=True)
            presenter.submit(number)
    pacing = presenter.pacing()
    assert seen == sorted(seen) and len(seen) + pacing.dropped == 24
    assert statistics.median(abs(one - turn) for one in pacing.intervals) < 0.1 * turn
    off = [one for one in pacing.shown if one.at is not None and one.at < one.due]
    assert not off  # never early


def test_what_showing_raises_reaches_the_renderer() -> None:
    def fail(picture: object) -> None:
        raise OSError("the window is gone")

    presenter = Presenter(fail, 0.001)
    with pytest.raises(OSError, match="the window is gone"):
        for _ in range(1000):
            presenter.submit("picture")
            time.sleep(0.001)
    with pytest.raises(OSError, match="the window is gone"):
        presenter.close()


def test_a_wrong_interval_and_a_closed_presenter_are_named() -> None:
    for interval in (0, -1, float("nan"), float("inf")):
        with pytest.raises(PostfxError, match="seconds from picture to picture"):
            Presenter(print, interval)
    presenter = Presenter(lambda _: None, TURN)
    presenter.close()
    with pytest.raises(PostfxError, match="closed"):
        presenter.submit("picture")


def test_the_graph_is_drawn(tmp_path: Path) -> None:
    shown = [Shown(k, k * TURN, k * TURN + 0.0005 * (k % 3), bool(k % 2))
             for k in range(40) if k != 21]
    pacing = Pacing(TURN, (*shown, Shown(41, 41 * TURN, None, True)))
    pacing.draw(tmp_path / "pacing.png")
    assert oiio.ImageBuf(str(tmp_path / "pacing.png")).get_pixels().std() > 0.05
    assert (str(pacing).startswith("39 pictures every 8.33 ms") and "1 left out, 1 turns "
            "without" in str(pacing))
    Pacing(TURN, ()).draw(tmp_path / "none.png")
    assert Pacing(TURN, ()).missed == 0

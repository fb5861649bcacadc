"""The exposure debugger: every error is found and its size named, and every mistake by its name."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

import postfx
from postfx.errors import ExposureError
from postfx.exposure import ExposureMeter, colours_of, measure
from postfx.passes.display import Display, View
from postfx.passes.tonemap import ToneMap
from postfx.runtime import Device
from postfx.tools.exposure.debugger import Report, debug
from postfx.tools.exposure.response import Board, Response
from tests.exposure.scenes import picture, scene

ERRORS = np.arange(-2, 2.01, 0.25)
VIEWS = {"tonemap": ToneMap, "display": Display}


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(params=VIEWS)
def view(request: pytest.FixtureRequest) -> list[Any]:
    return [VIEWS[request.param]()]


def test_the_right_exposure_gives_a_steady_mid_grey(view, device: Device) -> None:
    # a picture that changes by seven stops, exposed right all along
    needed = np.linspace(-3, 4, 12)
    report = debug(scene(needed, needed), view, "metadata", "metadata", device=device)
    levels = np.array([reading.level for reading in report.readings])
    assert abs(levels / report.grey - 1).max() < 0.02 and np.ptp(levels) < 0.002
    assert report.verdict == "right" and report.shots[0].cause is None


def test_mid_grey_is_where_the_view_puts_it(device: Device) -> None:
    grey = np.full((180, 320, 3), 0.18, np.float32)
    for view, tolerance in ((ToneMap(), 0.02), (Display(), 0.005)):
        plain = postfx.Pipeline([view], device,
                                0.0)(postfx.Frame({postfx.Role.COLOUR: grey}))[postfx.Role.COLOUR]
        assert debug(scene([0.0]), [view], 0.0,
                     device=device).grey == pytest.approx(float(plain.mean()), rel=tolerance)


@pytest.mark.parametrize("needed", (0.0, 2.6, -1.3))
def test_every_error_is_named_within_a_twentieth_of_a_stop(view, needed: float,
                                                           device: Device) -> None:
    board = Board(view, device=device)
    response = Response.of_board(board)
    for error in ERRORS:
        found = response.ev_of(board.level(needed + error, needed, cut=True))
        assert found == pytest.approx(error, abs=0.05)


def test_the_verdict_names_every_error_of_a_metered_scene(device: Device) -> None:
    for error in ERRORS[::2]:
        report = debug(scene([1.0] * 3), [ToneMap()], 1.0 + error, device=device)
        assert report.verdict == ("right" if error == 0 else "too bright" if error > 0
                                  else "too dark"), error
        assert report.shots[0].mismatch_ev == pytest.approx(error, abs=0.05)
        assert report.shots[0].right_ev == pytest.approx(1.0, abs=0.05)


def test_a_plain_grey_card_reads_the_same_error(view, device: Device) -> None:
    """A picture of another kind than the board that the response was sampled on."""
    card = postfx.Frame({postfx.Role.COLOUR: np.full((180, 320, 3), 0.18, np.float32)})
    response = Response.of_board(Board(view, device=device))
    for error in ERRORS:
        shown = postfx.Pipeline(view, device, float(error))(card)[postfx.Role.COLOUR]
        assert response.ev_of(float(shown.mean())) == pytest.approx(error, abs=0.05)


def test_errors_between_the_samples_of_the_response_are_named_too(device: Device) -> None:
    board = Board([ToneMap()], device=device)
    response = Response.of_board(board)
    for error in (-1.87, -0.61, 0.12, 0.37, 1.62):
        assert response.ev_of(board.level(error, 0.0, cut=True)) == pytest.approx(error, abs=0.05)


def test_beyond_black_and_white_the_limit_is_told(device: Device) -> None:
    report = debug(scene([0.0]), [Display()], 6.0, device=device)
    assert report.limits_ev[1] == report.shots[0].mismatch_ev < 3
    assert report.verdict == "too bright" and report.readings[0].level == pytest.approx(1.0)
    assert "the chain adds" not in (report.shots[0].cause or "")


@pytest.mark.parametrize("size", [(1, 1), (40, 90), (200, 30), (17, 33)])
def test_frames_of_any_shape_are_measured(size: tuple[int, int], device: Device) -> None:
    frame = postfx.Frame({postfx.Role.COLOUR: picture(0.0, *size)})
    report = debug([frame], [ToneMap()], -0.5, 0.0, device=device)
    assert report.shots[0].mismatch_ev == pytest.approx(-0.5, abs=0.05)


def test_drift_and_cuts_are_told_apart(device: Device) -> None:
    def shots(cuts: tuple[int, ...], given: np.ndarray) -> list[tuple[str, float]]:
        report = debug(scene(np.zeros(12), given, cuts), [ToneMap()], "metadata", 0.0,
                       device=device)
        return [(shot.verdict, round(shot.mismatch_ev, 1)) for shot in report.shots]

    jump = np.repeat([0.0, 1.0], 6)
    assert shots((6,), jump) == [("right", 0.0), ("too bright", 1.0)]
    (jumped,) = shots((), jump)
    assert jumped[0] == "drifting"
    assert [verdict for verdict, _ in shots((6,), np.linspace(0, 1, 12))] == ["drifting",
                                                                              "drifting"]


def test_a_cut_to_another_scene_is_no_error_and_no_drift(device: Device) -> None:
    needed = np.repeat([0.0, -3.0], 6)
    for exposure in ("auto", "smooth"):
        report = debug(scene(needed, cuts=(6,)), [ToneMap()], exposure, device=device)
        assert report.verdict == "right" and max(shot.drift_ev for shot in report.shots) < 0.02


def test_the_size_of_a_drift_is_named(device: Device) -> None:
    report = debug(scene(np.zeros(16), np.linspace(-0.3, 0.4, 16)), [ToneMap()], "metadata", 0.0,
                   device=device)
    assert report.verdict == "drifting" and report.shots[0].drift_ev == pytest.approx(0.7, abs=0.05)


def cause(report: Report) -> str:
    assert report.verdict != "right"
    return report.shots[0].cause or ""


def test_an_exposure_that_is_in_the_colour_already(device: Device) -> None:
    given = np.full(4, 2.0)
    needed = np.full(4, 2.0) - given  # multiplied in before the file was written
    assert "exposed a second time" in cause(debug(scene(needed, given), [ToneMap()], "metadata",
                                                  device=device))


def test_an_exposure_that_is_not_passed_on(device: Device) -> None:
    report = debug(scene([2.0] * 3, [0.0] * 3), [ToneMap()], "metadata", device=device)
    assert report.verdict == "too dark" and "not passed on" in cause(report)
    with pytest.raises(ExposureError, match="no exposure in its header"):
        debug(scene([2.0]), [ToneMap()], "metadata", device=device)


def test_an_exposure_that_is_inverted(device: Device) -> None:
    needed = np.linspace(1.5, 2.0, 4)
    report = debug(scene(needed, -needed), [ToneMap()], "metadata", device=device)
    assert (report.shots[0].mismatch_ev == pytest.approx(-3.5, abs=0.1)
            and "inverted" in cause(report))


def test_an_exposure_that_is_given_in_stops(device: Device) -> None:
    needed = np.full(3, 3.0)
    report = debug(scene(needed, np.log2(needed)), [ToneMap()], "metadata", device=device)
    assert report.shots[0].mismatch_ev == pytest.approx(np.log2(3) - 3, abs=0.1)
    assert "2 to the power" in cause(report)


class Brighter(ToneMap):
    """Exposes by something else than what it is told."""

    defaults = MappingProxyType({**ToneMap.defaults, "by": lambda number: 2.0})

    def encode(self, commands, frame) -> None:
        told = frame.exposure_factor
        frame.exposure_factor = frame.exposure_factor * self.options["by"](frame.number)
        super().encode(commands, frame)
        frame.exposure_factor = told


def test_a_tone_mapper_that_applies_another_exposure(device: Device) -> None:
    report = debug(scene([1.0] * 3), [ToneMap()], "smooth", chain=[Brighter()], device=device)
    assert (report.verdict == "too bright"
            and report.shots[0].mismatch_ev == pytest.approx(1.0, abs=0.05))
    assert "adds +1.00 EV to" in cause(report)


def test_a_tone_mapper_that_exposes_twice(device: Device) -> None:
    class Twice(Brighter):
        def encode(self, commands, frame) -> None:
            self.options = {**self.options, "by": lambda _: frame.exposure_factor}
            super().encode(commands, frame)

    report = debug(scene([1.5] * 3), [ToneMap()], "smooth", chain=[Twice()], device=device)
    assert (report.shots[0].mismatch_ev == pytest.approx(1.5, abs=0.05) and "the chain "
            "adds" in cause(report))


def test_a_tone_mapper_that_meters_for_itself(device: Device) -> None:
    wandering = Brighter(by=lambda number: 2.0 ** (number % 7 / 7))
    report = debug(scene([1.0] * 12), [ToneMap()], "smooth", chain=[wandering], device=device)
    assert report.verdict == "drifting" and "meters for itself" in cause(report)


class Own(View):
    """A tone mapper of one's own, which exposes by its own idea of what it is told; Reinhard by
    default."""

    defaults = MappingProxyType({**View.defaults, "by": lambda told: told})

    def encode(self, commands, frame) -> None:
        told = frame.exposure_factor
        frame.exposure_factor = self.options["by"](frame.exposure_factor)
        super().encode(commands, frame)
        frame.exposure_factor = told


@pytest.mark.soak
def test_a_tone_mapper_of_ones_own_is_judged_by_its_own_curve(device: Device) -> None:
    """Alone, beside the default look, and beside the curve that it should have; right, and with
    each mistake."""
    same, right = (lambda told: told), View(view="reinhard")
    for by, error, view, chain in (
        (same, 0.0, None, None), (lambda told: told**2, 1.5, None, None),
        (lambda told: 2 * told, 0.0, None, None),
        (same, 0.0, ToneMap(), True), (lambda told: told / 2, -1.0, right, True),
        (lambda _: 1.0, -1.5, right, True), (lambda told: 1 / told, -3.0, right, True),
    ):
        own = [Own(view="reinhard", by=by)]
        report = debug(scene([1.5] * 2), [view] if view else own, "smooth",
                       chain=own if chain else None, device=device)
        assert report.shots[0].mismatch_ev == pytest.approx(error, abs=0.05), (error, view)
        assert report.verdict == ("right" if error == 0 else "too bright" if error > 0
                                  else "too dark")
        assert ("the chain adds" in (report.shots[0].cause or "")) == (error != 0)


def test_a_tone_mapper_that_shows_all_light_alike_is_named(device: Device) -> None:
    with pytest.raises(ExposureError,
                       match="shows light of any brightness at the same level.*meters for itself"):
        debug(scene([1.5]), [Own(by=lambda _: 2.0**-16)], "smooth", device=device)


def fed_back(needed: float, count: int) -> list[postfx.Frame]:
    """Auto exposure metered on colour that the last frame's exposure is in already."""
    meter, last, frames = ExposureMeter(), 0.0, []
    for number in range(count):
        (frame,) = scene([needed - last])
        frame.number, frame.reset = number, number == 0
        frame.exposure = last = float(np.log2(meter(frame)))
        frames.append(frame)
    return frames


def test_auto_exposure_that_feeds_back(device: Device) -> None:
    report = debug(fed_back(2.0, 24), [ToneMap()], "metadata", 2.0, device=device)
    assert report.verdict == "drifting" and "feeds back" in cause(report)


def test_an_exposure_that_wanders_over_a_still_picture(device: Device) -> None:
    given = 2 + 0.5 * np.sin(np.arange(24) / 4)
    report = debug(scene(np.full(24, 2.0), given), [ToneMap()], "metadata", device=device)
    assert report.verdict == "drifting" and "picture does not" in cause(report)


def test_an_exposure_that_does_not_follow_the_picture(device: Device) -> None:
    needed = np.linspace(1, 3, 48)
    report = debug(scene(needed), [ToneMap()], 1.0, device=device)
    assert report.verdict == "drifting" and "does not follow" in cause(report)


def test_auto_exposure_that_comes_late(device: Device) -> None:
    needed = np.concatenate([np.full(24, 1.0), np.linspace(1, 4, 24)])
    report = debug(scene(needed), [ToneMap()], "auto", device=device)
    assert report.verdict == "drifting" and "looks ahead" in cause(report)
    assert debug(scene(needed), [ToneMap()], "smooth", device=device).verdict == "right"


def test_no_frame_is_an_error(device: Device) -> None:
    with pytest.raises(ExposureError, match="no frame"):
        debug([], [ToneMap()], device=device)


@pytest.mark.parametrize("error", (-2.0, -0.25, 0.25, 1.5))
@pytest.mark.parametrize("name", ("living_room", "staircase", "garage"))
def test_errors_on_noisy_renders_are_named(name: str, error: float, shared_dir,
                                           device: Device) -> None:
    frames = list(colours_of(postfx.read_sequence(shared_dir / "sequences" / name
                                                  / "noisy.####.exr")))
    right = np.mean([measure(frame[postfx.Role.COLOUR]) for frame in frames])
    report = debug(frames, [ToneMap()], right + error, device=device)
    assert report.verdict == ("too bright" if error > 0 else "too dark")
    assert report.shots[0].mismatch_ev == pytest.approx(error, abs=0.05)


@pytest.mark.parametrize("name", ("living_room", "staircase", "garage"))
def test_renders_are_exposed_right_by_auto_and_smooth(name: str, shared_dir,
                                                      device: Device) -> None:
    sequence = postfx.read_sequence(shared_dir / "sequences" / name / "noisy.####.exr")
    for exposure in ("auto", "smooth"):
        assert debug(colours_of(sequence), [ToneMap()], exposure, device=device).verdict == "right"

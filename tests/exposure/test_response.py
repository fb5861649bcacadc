"""Boards and the chart that come back from elsewhere are read within a twentieth of a stop, in
files of any kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx import Frame, Pipeline, Role
from postfx.colour.displays import srgb_encode
from postfx.errors import ExposureError
from postfx.passes.exposure_tool import ExposureTool
from postfx.passes.tonemap import ToneMap
from postfx.runtime import Device
from postfx.tools.exposure import response
from postfx.tools.exposure.debugger import debug_graded, judge_view
from postfx.tools.exposure.response import (
    OWN_CURVE,
    GradedBoards,
    Response,
    calibrate,
    read_response,
    write_chart,
)
from tests.exposure.scenes import scene

ERRORS = (0.0, 1.0, -1.0, 0.37, -1.6)
NEEDED = 2.0
SIZE = (108, 192)


def film(light: np.ndarray) -> np.ndarray:
    """A tone curve that is none of those that are known."""
    t = np.clip((np.log2(np.maximum(light, 1e-6) / 0.18) + 8) / 14, 0, 1)
    return 1.1 * t**2 * (3 - 2 * t) / (1 + 0.1 * t)


def reinhard(light: np.ndarray) -> np.ndarray:
    return srgb_encode(light / (1 + light))


def test_known_curves_are_those_of_their_authors() -> None:
    light = np.array([0, 0.01, 0.18, 1, 5.6])
    published = np.polyval([2.51, 0.03, 0], light) / np.polyval([2.43, 0.59, 0.14], light)
    np.testing.assert_allclose(response._narkowicz(light), published)
    # twice 5.6 is white
    np.testing.assert_allclose(response._hable(light[[0, -1]]), [0, 1], atol=1e-12)


def test_of_curves_that_are_alike_but_for_their_gain_the_nearest_is_named() -> None:
    own, *others = (Response.of_curve(lambda light, gain=gain: reinhard(light * gain))
                    for gain in (1.0, 4.0, 0.5))
    for known in (dict(zip(("two stops", "one stop"), others, strict=True)),
                  dict(zip(("one stop", "two stops"), others[::-1], strict=True))):
        assert "like that of one stop, 1.00 EV brighter" in (calibrate(own, known).remark or "")


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture
def hand_back(tmp_path: Path, device: Device):
    """Takes boards of frames 1, 2, ... through a curve that is so many stops too bright; the
    pattern of the files."""

    def write(curve, stops, name="graded/a.####.png", part=False, bits=oiio.UINT8, shrink=1) -> str:
        for number, error in enumerate(stops, 1):
            blank = Frame({Role.COLOUR: np.zeros((*SIZE, 3), np.float32)}, number=number)
            board = Pipeline([ExposureTool(part=part)], device, NEEDED)(blank)[Role.COLOUR]
            codes = curve(board[::shrink, ::shrink] * 2.0 ** (NEEDED + error)).astype(np.float32)
            path = tmp_path / name.replace("####", f"{number:04d}")
            path.parent.mkdir(exist_ok=True)
            assert oiio.ImageBuf(np.ascontiguousarray(codes)).write(str(path), bits)
        return str(tmp_path / name)

    return write


@pytest.fixture
def chart(tmp_path: Path):
    """The chart as a tone mapper hands it back."""

    def write(curve) -> Path:
        light = oiio.ImageBuf(str(write_chart(tmp_path / "chart.exr")))
        assert light.spec().getattribute("postfx:exposureUsedEV") == 0
        path = tmp_path / "chart.png"
        codes = curve(light.get_pixels(oiio.FLOAT)[..., :3]).astype(np.float32)
        assert oiio.ImageBuf(codes).write(str(path), oiio.UINT8)
        return path

    return write


def test_every_error_of_a_chain_elsewhere_is_named(hand_back, chart) -> None:
    for curve in (film, reinhard):
        judged = read_response(chart(curve))
        for name, options in (("a.####.png", {}), ("a.####.jpg", {}),
                              ("a.####.tif", {"bits": oiio.UINT16}),
                              ("a.####.exr", {"bits": oiio.HALF}), ("b.####.png", {"part": True}),
                              ("c.####.png", {"shrink": 2}),
                              ("d.####.png", {"part": True, "shrink": 2})):
            boards = GradedBoards(hand_back(curve, ERRORS, f"graded/{name}", **options))
            report = debug_graded(scene([NEEDED] * len(ERRORS)), boards.level, judged, NEEDED,
                                  NEEDED)
            found = [reading.mismatch_ev for reading in report.readings]
            assert found == pytest.approx(ERRORS, abs=0.05), (curve.__name__, name)
            assert report.verdict == "drifting"


def test_what_the_chain_does_adds_to_what_it_is_told(hand_back, chart) -> None:
    boards = GradedBoards(hand_back(film, [1.0] * 3))
    report = debug_graded(scene([NEEDED - 0.5] * 3), boards.level, read_response(chart(film)),
                          NEEDED)
    assert (report.verdict == "too bright"
            and report.shots[0].mismatch_ev == pytest.approx(1.5, abs=0.06))
    assert ("adds +1.0" in (report.shots[0].cause or "") and "the chain "
            "adds" in (report.shots[0].cause or ""))


def test_a_gain_in_the_chart_is_a_remark_and_no_verdict(chart, hand_back) -> None:
    judged = read_response(chart(lambda light: reinhard(2 * light)))
    assert "like that of Reinhard, sRGB, 1.00 EV brighter" in (judged.remark or "")
    for error, verdict in ((0.0, "right"), (1.0, "too bright")):
        boards = GradedBoards(hand_back(lambda light: reinhard(2 * light), [error]))
        report = debug_graded(scene([NEEDED]), boards.level, judged, NEEDED)
        assert (report.verdict == verdict
                and report.shots[0].mismatch_ev == pytest.approx(error, abs=0.05))
        assert report.remark == judged.remark
    assert read_response(chart(reinhard)).remark == "its curve is that of Reinhard, sRGB"
    assert read_response(chart(film))[1:] == (OWN_CURVE, None)


def test_without_a_chart_the_view_is_taken_for_the_chains(hand_back, device) -> None:
    look = Pipeline([ToneMap()], device, 0.0)
    boards = GradedBoards(hand_back(lambda light: look(Frame({Role.COLOUR: light}))[Role.COLOUR],
                                    [0.0, 0.0]))
    report = debug_graded(scene([NEEDED] * 2), boards.level, judge_view([ToneMap()], device),
                          NEEDED, NEEDED)
    assert report.verdict == "right" and report.shots[0].mismatch_ev == pytest.approx(0, abs=0.05)


def test_what_cannot_be_read_is_named(hand_back, chart, tmp_path: Path) -> None:
    boards = GradedBoards(hand_back(film, [0.0]))
    with pytest.raises(ExposureError, match=r"a\.0002\.png: frame 2 is missing: grade it"):
        boards.level(2)
    picture = np.random.default_rng(1).random((40, 60, 3), np.float32)
    oiio.ImageBuf(picture).write(str(tmp_path / "graded/a.0001.png"), oiio.UINT8)
    with pytest.raises(ExposureError, match=r"a\.0001\.png: shows no checkerboard"):
        boards.level(1)
    (tmp_path / "graded/a.0001.png").write_bytes(b"no picture")
    with pytest.raises(ExposureError, match=r"a\.0001\.png: cannot be read"):
        boards.level(1)
    for curve, told in ((lambda light: 1 - film(light), "gets darker"),
                        (lambda light: 0 * light + 0.5, "meters for")):
        with pytest.raises(ExposureError, match=told):
            read_response(chart(curve))
    with pytest.raises(ExposureError, match="no such file"):
        GradedBoards(str(tmp_path / "none.####.png"))

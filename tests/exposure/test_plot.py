"""The picture of the exposure over a sequence."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.canvas import PLOT_LEFT_PX, PLOT_RIGHT_PX, Canvas
from postfx.errors import WriteError
from postfx.tools.exposure.debugger import Reading, Report, Shot
from postfx.tools.exposure.plot import NEEDED_RGB, STRIP_ROWS_PX, USED_RGB, draw_exposure


def report(used: list[float], needed: list[float], cuts: tuple[int, ...] = ()) -> Report:
    readings = [
        Reading(i + 1, i in cuts, u, n, n, 0.2 + 0.02 * i, u - n, u - n)
        for i, (u, n) in enumerate(zip(used, needed, strict=True))
    ]
    edges = [0, *cuts, len(used)]
    shots = [Shot(a + 1, b, "too dark", -1.0, 0.0, 0.4, 0.0, None)
             for a, b in zip(edges, edges[1:], strict=False)]
    return Report(readings, shots, 0.45, (-8.0, 8.0))


def rows_of(pixels: np.ndarray, colour: tuple[int, int, int], x: float) -> np.ndarray:
    column = pixels[74:400, round(x)]
    return np.flatnonzero(abs(column - np.array(colour)).sum(axis=-1) < 12)


def test_curves_stand_at_their_stops_and_the_strip_shows_what_was_seen(tmp_path: Path) -> None:
    draw_exposure(report([0.0] * 8, [1.0] * 8), "title", tmp_path / "a/curve.png")
    pixels = oiio.ImageBuf(str(tmp_path / "a/curve.png")).get_pixels(oiio.FLOAT) * 255
    x = PLOT_LEFT_PX + (PLOT_RIGHT_PX - PLOT_LEFT_PX) * 2.5 / 8
    used, needed = rows_of(pixels, USED_RGB, x).mean(), rows_of(pixels, NEEDED_RGB, x).mean()
    # one stop of the two that the axis spans
    assert used - needed == pytest.approx((400 - 74) / 2, abs=3)
    assert pixels[STRIP_ROWS_PX[0] + 5, round(x)] == pytest.approx(255 * 0.24, abs=1)
    assert pixels[STRIP_ROWS_PX[1] - 5, round(x)] == pytest.approx(255 * 0.45, abs=1)
    word = np.flatnonzero(np.ptp(pixels[STRIP_ROWS_PX[1] + 36:STRIP_ROWS_PX[1] + 54], axis=0)
                          .max(-1) > 40)
    assert (word.size > 10 and (word[0] + word[-1]) / 2
            == pytest.approx((PLOT_LEFT_PX + PLOT_RIGHT_PX) / 2, abs=2))
    assert (tmp_path / "a/curve.png").stat().st_size < 300_000


def test_curves_are_not_joined_over_a_cut(tmp_path: Path) -> None:
    for cuts in ((), (4,)):
        draw_exposure(report([0.0] * 4 + [2.0] * 4, [0.0] * 8, cuts), "title",
                      tmp_path / "curve.png")
        pixels = oiio.ImageBuf(str(tmp_path / "curve.png")).get_pixels(oiio.FLOAT) * 255
        x = PLOT_LEFT_PX + (PLOT_RIGHT_PX - PLOT_LEFT_PX) * 3.9 / 8
        assert (rows_of(pixels, USED_RGB, x).size > 0) == (not cuts)


@pytest.mark.parametrize("count", (1, 2, 3000))
def test_any_number_of_frames_fits(count: int, tmp_path: Path) -> None:
    draw_exposure(report([0.0] * count, list(np.linspace(-9, 9, count))), "title",
                  tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 3000


def test_lines_are_as_wide_as_they_should_be_and_stay_inside() -> None:
    canvas = Canvas(100, 40, (0, 0, 0))
    canvas.line(np.array([-50, 200]), np.array([20, 20]), (255, 255, 255), 3)
    assert canvas.pixels[..., 0].sum(axis=0) == pytest.approx(np.full(100, 3 * 255))


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="file/curve.png: cannot be written"):
        draw_exposure(report([0.0], [0.0]), "title", tmp_path / "file/curve.png")

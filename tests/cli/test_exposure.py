"""`postfx exposure`, `--exposure smooth` and POSTFX_EXPOSURE_TOOL, as people call them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from tests.exposure.scenes import picture

EV = 1.0


@pytest.fixture
def grey(write_exr: Callable[..., Path]) -> Callable[..., None]:
    """Writes in/shot.####.exr: pictures that need these stops, with their exposure in the header."""

    def write(*needed: float, **header: object) -> None:
        for number, ev in enumerate(needed, 1):
            colour = picture(ev)
            planes = dict(zip("RGB", np.moveaxis(colour, -1, 0), strict=True))
            write_exr(f"in/shot.{number:04d}.exr", planes, **{"postfx__exposure": 2.0**ev, **header})

    return write


def pixels(path: Path) -> np.ndarray:
    return oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)


def test_a_right_exposure_is_called_right(postfx, grey) -> None:
    grey(EV, EV, EV)
    for mode in ("auto", "smooth", "metadata", str(EV)):
        done = postfx("exposure", "in/", "--exposure", mode)
        assert (done.code, "verdict  right" in done.out) == (0, True), done.out + done.err


@pytest.mark.parametrize(("error", "verdict"), [(-0.5, "too dark"), (0.25, "too bright")])
def test_a_wrong_exposure_is_named_with_its_size(postfx, grey, error: float, verdict: str) -> None:
    grey(EV, EV)
    done = postfx("exposure", "in/", "--exposure", str(EV + error), "--json")
    (shot,) = done.json["shots"]
    assert (done.code, done.json["verdict"], shot["verdict"]) == (1, verdict, verdict)
    assert shot["mismatch_ev"] == pytest.approx(error, abs=0.05) and shot["right_ev"] == pytest.approx(EV, abs=0.05)
    assert [frame["number"] for frame in done.json["frames"]] == [1, 2]


def test_the_table_tells_what_is_likely_wrong(postfx, grey) -> None:
    grey(EV, EV, postfx__exposure=1.0)
    done = postfx("exposure", "in/", "--exposure", "metadata")
    assert done.code == 1 and " too dark\nlikely   the exposure is 1 (0 EV) throughout" in done.out


def test_beyond_white_a_bound_is_told(postfx, grey) -> None:
    grey(EV)
    assert "beyond +" in postfx("exposure", "in/", "--exposure", "9", "--no-tonemap").out


def test_errors_end_with_two(postfx, grey, write_exr) -> None:
    grey(EV)
    assert postfx("exposure", "in/", "--exposure", "right").code == 2
    assert postfx("exposure", "nothing.####.exr").code == 2


def test_pictures_are_written(postfx, grey, tmp_path: Path) -> None:
    grey(EV, EV)
    done = postfx("exposure", "in/", "--curve", "curves/a.png", "--views", "look")
    assert done.code == 0, done.err
    kinds = ("false_colour_log_c", "false_colour_display", "zebra")
    wanted = {f"{kind}.{number:04d}.png" for kind in kinds for number in (1, 2)} | {"curve.png"}
    assert {path.name for path in (tmp_path / "look").iterdir()} == wanted
    assert pixels(tmp_path / "curves/a.png").shape == (560, 1200, 3)
    middle = pixels(tmp_path / "look/false_colour_log_c.0001.png")[:108]  # above the key
    green = (abs(middle * 255 - (60, 180, 75)) < 1).all(axis=-1).mean(axis=0)
    assert green[96] > 0.9 and green[0] == 0  # 0.18, exposed, is in the middle of the picture


def test_smooth_exposure_of_a_part_is_that_of_the_whole(postfx, grey, tmp_path: Path) -> None:
    grey(0.0, 0.5, 1.5, 0.5)
    arguments = ("run", "in/", "-o", "out/p.####.png", "--no-denoise", "--no-tonemap", "--exposure", "smooth")
    assert postfx(*arguments).code == 0
    whole = pixels(tmp_path / "out/p.0003.png")
    (tmp_path / "out/p.0003.png").unlink()
    assert postfx(*arguments, "--skip-existing").code == 0
    assert np.array_equal(pixels(tmp_path / "out/p.0003.png"), whole)
    assert postfx("run", "in/", "-o", "late/p.####.png", *arguments[4:-1], "auto").code == 0
    assert abs(pixels(tmp_path / "late/p.0003.png") - whole).mean() > 0.02


def test_the_environment_draws_the_checkerboard_in_a_run(postfx, grey, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("POSTFX_EXPOSURE_TOOL", "1")
    grey(EV, EV)
    done = postfx("run", "in/", "-o", "out/b.####.exr", "--exposure", "metadata")
    assert done.code == 0 and "a checkerboard covers the picture" in done.err
    board = pixels(tmp_path / "out/b.0002.exr")[..., :3]
    assert board.shape[:2] == (108, 192)  # at output size
    np.testing.assert_allclose(np.unique(board), 0.18 * 2.0 ** np.array([-0.25, 0.25]) / 2**EV, rtol=1e-3)

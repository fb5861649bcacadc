"""Pictures for looks: read as they will be run, and what cannot be meant is refused before a
training begins."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

pytest.importorskip("torch")
pytest.importorskip("PyOpenColorIO")

from postfx.colour import ACESCG, REC709, matrix_between  # noqa: E402
from training.tonemap.looks import ACES_CONFIG, Lut, Ocio, exact_view  # noqa: E402
from training.tonemap.pictures import collect, expose, find_pictures, read  # noqa: E402

IDENTITY = "LUT_3D_SIZE 2\n" + "".join(f"{r} {g} {b}\n" for b in (0, 1) for g in (0, 1)
                                       for r in (0, 1))


def write(path: Path, pixels: np.ndarray, **attributes: object) -> str:
    image = oiio.ImageBuf(np.ascontiguousarray(pixels))
    for name, value in attributes.items():
        image.specmod()[name] = value
    assert image.write(str(path))
    return str(path)


@pytest.fixture
def light() -> np.ndarray:
    return np.random.default_rng(1).random((8, 12, 3)).astype(np.float32)


def test_primaries_are_those_of_the_header(tmp_path: Path, light: np.ndarray) -> None:
    stored = (light @ matrix_between(REC709, ACESCG).T).astype(np.float32)
    path = write(tmp_path / "a.exr", stored, colorInteropID="lin_ap1_scene")
    np.testing.assert_allclose(read(path), light, atol=1e-5)
    np.testing.assert_array_equal(read(path, "rec709"), stored)
    np.testing.assert_array_equal(find_pictures([path], [], 64)["a"], read(path))


def test_alpha_beside_colour_is_not_in_it(tmp_path: Path, light: np.ndarray) -> None:
    codes = np.round(255 * light).astype(np.uint8)
    half = np.concatenate([codes, np.full((8, 12, 1), 128, np.uint8)], 2)
    straight = write(tmp_path / "half.png", half, **{"oiio:UnassociatedAlpha": 1})
    np.testing.assert_array_equal(read(straight, "rec709"),
                                  read(write(tmp_path / "whole.png", codes), "rec709"))


def test_black_stays_black() -> None:
    assert not expose(np.zeros((4, 4, 3), np.float32)).any()


def test_names_and_patterns_that_fit_nothing_are_refused(tmp_path: Path, light: np.ndarray) -> None:
    for name in ("Bonita", "Desk"):
        write(tmp_path / f"{name}.exr", light)
    pattern = str(tmp_path / "*.exr")
    with pytest.raises(SystemExit,
                       match="--hold-out bonita: no such picture: there are Bonita, Desk"):
        collect([pattern], hold_out=["bonita"])
    with pytest.raises(SystemExit, match="--hold-out: names all pictures"):
        collect([pattern], hold_out=["Bonita", "Desk"])
    with pytest.raises(SystemExit, match=r"none\*.exr: no such file"):
        collect([str(tmp_path / "none*.exr")])
    assert set(collect([pattern], hold_out=["Desk"]).train) == {"Bonita"}
    assert set(collect([]).held) == {"chart", "ramp"}


def test_views_for_other_displays_are_refused(tmp_path: Path, light: np.ndarray) -> None:
    table = tmp_path / "look.cube"
    table.write_text(IDENTITY)
    assert exact_view(Lut(f"{table},input=ACEScct"), light).shape == light.shape
    with pytest.raises(SystemExit, match=r"is for Display P3: looks are learnt for sRGB"):
        exact_view(Lut(f"{table},input=ACEScct,output=p3"), light)
    with pytest.raises(SystemExit,
                       match=r"Rec.2100-PQ - Display: is for Rec.2100 PQ: looks are learnt for "
                       r"sRGB"):
        exact_view(Ocio(ACES_CONFIG, "Rec.2100-PQ - Display", "ACES 2.0 - HDR 1000 nits (P3 D65)"),
                   light)


@pytest.mark.parametrize("text", ["<style>body{margin:0}</style>", "LUT_3D_SIZE 2\n{0 0 0}\n"])
def test_what_is_no_table_is_told_in_one_line(tmp_path: Path, light: np.ndarray, text: str) -> None:
    (tmp_path / "page.cube").write_text(text)
    with pytest.raises(SystemExit, match=r"page\.cube") as error:
        exact_view(Lut(f"{tmp_path}/page.cube,input=ACEScct"), light)
    assert "\n" not in str(error.value)

"""Slices as PNG, read back by OpenImageIO."""

import base64

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.tools.report.pictures import picture, sheet


@pytest.fixture
def pixels_of(tmp_path):
    def read(slices, draw=picture):
        made = draw([np.array(one, np.float32) for one in slices])
        (tmp_path / "picture.png").write_bytes(base64.b64decode(made["src"].partition(",")[2]))
        image = oiio.ImageInput.open(str(tmp_path / "picture.png"))
        pixels = image.read_image(oiio.UINT8)
        image.close()
        return pixels, made["range"]

    return read


def test_one_slice_is_grey_with_gamma(pixels_of):
    pixels, text = pixels_of([[[0, 1, 1], [0.5, 1, 1]]])
    assert pixels.shape == (2, 3, 3) and text == "black 0, white 1, gamma 2.2"
    assert (pixels[0, 1].tolist() == [255] * 3
            and pixels[1, 0].tolist() == [round(255 * 0.5 ** (1 / 2.2))] * 3)


def test_negative_values_are_linear(pixels_of):
    pixels, text = pixels_of([np.linspace(-1, 1, 101)[None]])
    assert "gamma" not in text and abs(int(pixels[0, 50, 0]) - 128) <= 1
    assert pixels[0, 0, 0] == 0 and pixels[0, -1, 0] == 255


def test_three_slices_are_colour_and_what_is_not_finite_is_magenta(pixels_of):
    red, green, blue = [[1, np.nan]], [[0, 0]], [[0, 0]]
    pixels, _ = pixels_of([red, green, blue])
    assert pixels[0].tolist() == [[255, 0, 0], [255, 0, 255]]


@pytest.mark.parametrize("value", [0.0, 7.0, -3.0, np.nan])
def test_flat_slices(pixels_of, value):
    pixels, _ = pixels_of([np.full((2, 2), value)])
    assert (pixels == pixels[0, 0]).all()


def test_a_sheet_has_a_tile_for_each_slice(pixels_of):
    slices = np.zeros((5, 2, 3))
    slices[1] = 1
    slices[4, 0, 2] = np.nan
    pixels, text = pixels_of(slices, sheet)
    assert pixels.shape == (4, 12, 3) and text == "black 0, white 1, gamma 2.2"
    assert (pixels[:2, 3:6] == 255).all() and (pixels[:2, 6:] == 0).all()
    assert pixels[2, 2].tolist() == [255, 0, 255] and (pixels[2:, 3:] == 0).all()


def test_the_liveliest_slice_is_one_with_contrast_or_not_finite():
    flat, lively = np.ones((2, 3)), np.arange(6.0).reshape(2, 3)
    assert sheet([flat, lively, flat])["liveliest"] == 1 and sheet([flat] * 2)["tiles"] == [2, 1]
    assert sheet([lively, flat, np.full((2, 3), np.nan)])["liveliest"] == 2

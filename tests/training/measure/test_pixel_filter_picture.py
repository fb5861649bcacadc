"""The picture of a pixel filter that was undone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx.frame import Frame, Role
from training.measure import pixel_filter_picture
from training.measure.pixel_filter import Case

SIZE = 160, 224


def test_the_picture_shows_four_parts_side_by_side(tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    random = np.random.default_rng(0)
    light = random.gamma(2.0, 0.5, (*SIZE, 3)).astype(np.float32)
    reference = np.ones_like(light)
    case = Case("box 16", [Frame({Role.COLOUR: light})], [], [reference])
    monkeypatch.setattr(pixel_filter_picture, "mitsuba_cases", lambda: iter([case]))
    monkeypatch.setattr(pixel_filter_picture, "Oidn", lambda *_: lambda frame: frame[Role.COLOUR])
    pixel_filter_picture.main([str(tmp_path / "made.png")])
    rows, columns = pixel_filter_picture.PART
    width = pixel_filter_picture.ZOOM * (columns.stop - columns.start)
    made = oiio.ImageBuf(str(tmp_path / "made.png")).get_pixels(oiio.FLOAT)
    height = pixel_filter_picture.ZOOM * (rows.stop - rows.start)
    assert made.shape == (height, 4 * width + 3 * pixel_filter_picture.GAP_PX, 3)
    noisy, others, ours, wanted = (made[:, k * (width + pixel_filter_picture.GAP_PX):][:, :width]
                                   for k in range(4))
    np.testing.assert_array_equal(noisy, others)
    assert noisy.std() > 3 * ours.std() and np.ptp(wanted) == 0

"""Radiance HDR files: orientation, exposure and primaries, and headers that are broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from postfx.colour import P3_D65
from postfx.errors import ReadError
from postfx.frame import Role
from postfx.io.sequence import read_sequence

UPRIGHT = np.arange(1, 7, dtype=np.float32).reshape(2, 3)
"""Mantissas of red of a picture of 3x2 pixels; green is 8, blue 16, the exponent that of 1/128."""
STORED = {
    "-Y 2 +X 3": UPRIGHT, "+Y 2 +X 3": UPRIGHT[::-1], "-Y 2 -X 3": UPRIGHT[:, ::-1],
    "+Y 2 -X 3": UPRIGHT[::-1, ::-1],
    "+X 3 -Y 2": UPRIGHT.T, "+X 3 +Y 2": UPRIGHT[::-1].T, "-X 3 -Y 2": UPRIGHT[:, ::-1].T,
    "-X 3 +Y 2": UPRIGHT[::-1, ::-1].T,
}


def write(path: Path, lines: str = "", size: str = "-Y 2 +X 3", kind: str = "rgbe") -> Path:
    pixels = bytes(np.stack([STORED[size].ravel(), *np.repeat([[8], [16], [129]], 6, 1)], -1)
                   .astype(np.uint8))
    path.write_bytes(f"#?RADIANCE\n{lines}FORMAT=32-bit_rle_{kind}\n\n{size}\n".encode() + pixels)
    return path


def test_every_orientation(tmp_path: Path) -> None:
    for size in STORED:
        path = write(tmp_path / "a.hdr", size=size)
        (frame,) = read_sequence(path)
        np.testing.assert_array_equal(frame[Role.COLOUR][..., 0], UPRIGHT / 128, err_msg=size)
        np.testing.assert_array_equal(frame[Role.COLOUR][..., 2], np.float32(0.125))
        assert "Orientation" not in frame.metadata
        with read_sequence(path).open(1) as files:
            (part,) = files.files[""].parts
            rows = files.files[""].read(part, {"R": 0.0}, (1, 2))
        np.testing.assert_array_equal(rows["R"], UPRIGHT[1:] / 128)


def test_exposures_are_taken_out_and_primaries_are_used(tmp_path: Path) -> None:
    numbers = " ".join(map(str, P3_D65))
    path = write(tmp_path / "a.hdr",
                 f"EXPOSURE=2\nEXPOSURE= 0.25\nCOLORCORR=1 2 4\nPRIMARIES={numbers}\nSOFTWARE=x\n")
    sequence = read_sequence(path, colourspace="native")
    (frame,) = sequence
    np.testing.assert_allclose(frame[Role.COLOUR][..., 0], UPRIGHT / 64)
    np.testing.assert_allclose(frame[Role.COLOUR][0, 0], [1 / 64, 8 / 128, 16 / 256])
    assert sequence.warnings == ["colours are p3: kept as they are"]


@pytest.mark.parametrize(("lines", "kind", "message"), [
    ("EXPOSURE=0\n", "rgbe", "multiplied by 0; correct EXPOSURE"),
    ("EXPOSURE=1e10\nEXPOSURE=1e10\n", "rgbe", "multiplied by 1e\\+20; correct EXPOSURE"),
    ("EXPOSURE=nan\n", "rgbe", "'EXPOSURE=nan' is not a number"),
    ("EXPOSURE=bright\n", "rgbe", "'EXPOSURE=bright' is not a number"),
    ("PRIMARIES=1 2 3\n", "rgbe", "'PRIMARIES=1 2 3' is not 8 numbers"),
    ("", "xyze", "holds CIE XYZ, which is not read: convert it to RGB first"),
])
def test_headers_that_cannot_be(tmp_path: Path, lines: str, kind: str, message: str) -> None:
    with pytest.raises(ReadError, match=rf"a\.hdr: .*{message}"):
        next(iter(read_sequence(write(tmp_path / "a.hdr", lines, kind=kind))))


def test_primaries_of_zeros_are_not_given(tmp_path: Path) -> None:
    """As Photoshop writes them."""
    path = write(tmp_path / "a.hdr", f"GAMMA=1\nPRIMARIES={'0 ' * 8}\n")
    sequence = read_sequence(path)
    (frame,) = sequence
    np.testing.assert_array_equal(frame[Role.COLOUR][..., 0], UPRIGHT / 128)
    assert not sequence.warnings

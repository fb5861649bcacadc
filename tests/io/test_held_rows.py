"""Rows that a frame holds as they were unpacked: its writer takes them, as long as the file is the
one that was read."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.errors import ReadError
from postfx.frame import Frame, Role
from postfx.io.sequence import read_sequence
from postfx.io.writer import write_channels, write_frame

SIZE = (150, 24)
"""Rows that several threads unpack."""


def write_source(path: Path, seed: int, letters: str = "RGBZM") -> dict[str, np.ndarray]:
    """A file of random channels, which have few values, so that they are compressed."""
    rng = np.random.default_rng(seed)
    channels = {letter: rng.integers(0, 9, SIZE).astype(np.float32) for letter in letters}
    write_channels(path, channels)
    return channels


def read_held(path: Path) -> Frame:
    """The frame of a file, with its rows."""
    return read_sequence(path).read(1, [Role.COLOUR], [], hold_rows=True)


def read_channel(path: Path, name: str) -> np.ndarray:
    """A channel of a file."""
    image = oiio.ImageBuf(str(path))
    pixels = image.get_pixels(oiio.FLOAT)
    assert pixels is not None
    return pixels[..., image.spec().channelnames.index(name)]


def break_pixels(path: Path) -> None:
    """Spoil the last chunk, so that the file looks as it was but cannot be unpacked any more."""
    status, content = path.stat(), path.read_bytes()
    path.write_bytes(content[:-200] + bytes(200))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_a_file_is_not_unpacked_again(tmp_path: Path) -> None:
    source = tmp_path / "in.0001.exr"
    stored = write_source(source, 1)
    held, plain = read_held(source), read_sequence(source).read(1, [Role.COLOUR])
    break_pixels(source)
    out = write_frame(tmp_path / "out.exr", held, keep=True, bits=32)
    for name, channel in stored.items():
        np.testing.assert_array_equal(read_channel(out, name), channel)
    with pytest.raises(ReadError, match="broken file"):
        write_frame(tmp_path / "other.exr", plain, keep=True)


def test_of_a_file_that_changed_what_is_there_now_is_kept(tmp_path: Path) -> None:
    source = tmp_path / "in.0001.exr"
    write_source(source, 1)
    frame = read_held(source)
    now = write_source(source, 2)
    out = write_frame(tmp_path / "out.exr", frame, keep=True)
    np.testing.assert_array_equal(read_channel(out, "M"), now["M"])


@pytest.mark.parametrize("letters", ["RGB", "RGBA"])
def test_a_file_of_a_picture_alone_holds_nothing(tmp_path: Path, letters: str) -> None:
    source = tmp_path / "in.0001.exr"
    write_source(source, 1, letters)
    colour_source = read_held(source).colour_source
    assert colour_source is not None
    assert colour_source.rows is None


def test_frames_hold_nothing_unless_they_are_told_to(tmp_path: Path) -> None:
    source = tmp_path / "in.0001.exr"
    write_source(source, 1)
    colour_source = read_sequence(source).read(1).colour_source
    assert colour_source is not None
    assert colour_source.rows is None

"""OpenEXR files whose table of chunks was never written, and files whose flags and type differ."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.frame import Role
from postfx.io.exr import EXR_MAGIC, TILED_IMAGE, pack_headers
from postfx.io.exr.container import ExrContainer
from postfx.io.sequence import read_sequence
from postfx.io.writer import is_complete, write_frame
from tests.files.exr_files import (
    HEIGHT,
    WIDTH,
    write_deep,
    write_mipmapped,
    write_mixed,
    write_studio,
)


def stored(path: Path) -> list[list[tuple[int, bytes]]]:
    """Chunks of every part."""
    with ExrContainer(path) as file:
        return [list(file.copy_chunks(part)) for part in range(len(file.headers))]


def clear_table(path: Path) -> None:
    with ExrContainer(path) as file:
        first = (min(chunk.at for part in range(len(file.headers)) for chunk in file.chunks(part))
                 - 4 * file.several)
        count = sum(file.counts)
    content = path.read_bytes()
    path.write_bytes(content[: first - 8 * count] + bytes(8 * count) + content[first:])


def write_tiled(folder: Path) -> Path:
    return write_mixed(folder / "tiled.exr", tiled=True)


@pytest.mark.parametrize("write", [
    lambda folder: write_mixed(folder / "lines.exr"), write_tiled,
    lambda folder: write_mipmapped(folder / "mip.exr"),
    lambda folder: write_deep(folder / "deep.exr"), write_studio,
], ids=["lines", "tiles", "levels", "deep", "parts"])
def test_a_table_of_zeros_is_found_again_by_walking_the_chunks(tmp_path: Path, write) -> None:
    path = write(tmp_path)
    before = stored(path)
    clear_table(path)
    assert stored(path) == before


def write_contradiction(folder: Path) -> Path:
    """A tiled file whose header says that it is of lines."""
    source, path = write_tiled(folder), folder / "contradiction.exr"
    with ExrContainer(source) as file:
        (header,) = file.headers
        version = file.version
        chunks = [stored for _, stored in file.copy_chunks(0)]
    header.set_text("type", "scanlineimage")
    head = struct.pack("<iI", EXR_MAGIC, version) + pack_headers([header])[8:]
    sizes = [len(chunk) for chunk in chunks]
    table = len(head) + 8 * len(chunks) + np.cumsum([0, *sizes[:-1]])
    path.write_bytes(head + table.astype("<u8").tobytes() + b"".join(chunks))
    return path


def test_flags_count_more_than_the_type(tmp_path: Path) -> None:
    path = write_contradiction(tmp_path)
    with ExrContainer(path) as file:
        assert file.headers[0].part_type == TILED_IMAGE
    (frame,), (wanted,) = read_sequence(path), read_sequence(tmp_path / "tiled.exr")
    np.testing.assert_array_equal(frame[Role.COLOUR], wanted[Role.COLOUR])
    out = write_frame(tmp_path / "out.exr", frame, keep=True)
    assert is_complete(out, WIDTH, HEIGHT)
    shown = oiio.ImageBuf(str(out)).get_pixels("float")
    np.testing.assert_array_equal(shown[..., :3], wanted[Role.COLOUR])

"""Reading and writing some rows at a time, as within a memory budget: the same as all at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.frame import ROLES, Frame, Role
from postfx.io import encoder, writer
from postfx.io import frame_reader as planes_of_files
from postfx.io.convert import Camera, convert
from postfx.io.exr import container
from postfx.io.profile import load_profile
from postfx.io.sequence import Sequence, read_sequence
from postfx.system import Scratch

SIZE = (150, 70)
CHANNELS = ("R", "G", "B", "Z", "N.X", "N.Y", "N.Z", "motion.x", "motion.y")


def planes(height: int, width: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    return {name: random.random((height, width)).astype(np.float32) for name in CHANNELS}


def both(path: Path) -> tuple[Frame, Frame, Scratch]:
    """A file read at once, and in pieces of few rows."""
    scratch = Scratch("1M")
    return Sequence(path).read(1), read_sequence(path, scratch=scratch).read(1), scratch


def assert_same(one: Frame, other: Frame) -> None:
    assert one.planes.keys() == other.planes.keys() and len(one.planes) > 1
    for role, plane in one.planes.items():
        np.testing.assert_array_equal(plane, other[role], err_msg=role)


@pytest.mark.parametrize("window", [{}, {"origin": (-5, -9)},
                                    {"origin": (20, 33), "display": (0, 0, 100, 200)},
                                    {"origin": (-5, -9), "display": (3, 4, 50, 60)}], ids=str)
def test_scanlines_within_any_window(window: dict, write_exr: Callable[..., Path]) -> None:
    path = write_exr("frame.0001.exr", planes(*SIZE), **window)
    one, other, scratch = both(path)
    assert len(list(scratch.pieces(SIZE[0], 8 * 4 * len(CHANNELS) * SIZE[1]))) > 1
    assert_same(one, other)


def test_pieces_of_a_tiled_file_are_those_of_the_whole(tmp_path: Path) -> None:
    path, values = tmp_path / "frame.0001.exr", planes(*SIZE)
    spec = oiio.ImageSpec(SIZE[1], SIZE[0], len(values), "float")
    spec.channelnames, spec.tile_width, spec.tile_height = tuple(values), 32, 32
    spec.x, spec.y, spec.full_width, spec.full_height = 3, -7, 80, 140
    output = oiio.ImageOutput.create(str(path))
    assert (output.open(str(path), spec) and output.write_image(np.stack(list(values.values()), -1))
            and output.close())
    one, other, _ = both(path)
    assert_same(one, other)


@pytest.mark.parametrize(("name", "tile", "compression"), [
    ("a.0001.exr", 0, "zips"), ("a.0001.exr", 0, "dwab:45"), ("a.0001.exr", 96, "zip"),
    ("a.0001.hdr", 0, ""),
], ids=str)
def test_tall_pictures_are_read_as_at_once(
    name: str, tile: int, compression: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = oiio.ImageSpec(24, 600, 3, "half" if name.endswith(".exr") else "float")
    spec.tile_width = spec.tile_height = tile
    spec["compression"] = compression
    output = oiio.ImageOutput.create(name)
    values = np.random.default_rng(0).random((600, 24, 3), np.float32)
    assert output.open(str(tmp_path / name), spec) and output.write_image(values) and output.close()
    in_pieces = Sequence(tmp_path / name).read(1)[Role.COLOUR]
    monkeypatch.setattr(planes_of_files, "FEWEST_ROWS", 1024)
    monkeypatch.setattr(planes_of_files, "MOST_CHUNK_ROWS", 1024)
    np.testing.assert_array_equal(in_pieces, Sequence(tmp_path / name).read(1)[Role.COLOUR])
    assert in_pieces.shape == (600, 24, 3) and in_pieces.std() > 0.2


@pytest.mark.parametrize("role", [Role.DEPTH, Role.MOTION], ids=str)
def test_what_depends_on_the_place_in_the_picture_is_converted_alike(role: Role) -> None:
    """Distances along rays, and motion in parts of the picture's size."""
    rule = replace(load_profile("mitsuba-3").rules(role)[0],
                   **({"unit": "uv"} if role is Role.MOTION else {}))
    assert role is Role.MOTION or rule.kind == "ray"
    plane = np.random.default_rng(0).random((*SIZE, ROLES[role].channels), np.float32)
    camera = Camera(fov_x=70.0)
    whole = convert(plane.copy(), rule, camera)
    pieces = [convert(plane[first:last].copy(), rule, camera, first, SIZE[0])
              for first, last in ((0, 60), (60, 150))]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    assert not np.array_equal(whole, plane)


@pytest.mark.parametrize("name", ["a.exr", "a.png", "a.tif", "a.jpg"])
def test_files_written_in_pieces_are_the_same_bytes(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(0)
    planes = {role: random.random((150, 70, ROLES[role].channels), np.float32)
              for role in (Role.COLOUR, Role.ALPHA)}
    frame = Frame(planes)
    whole = writer.write_frame(tmp_path / "whole" / name, frame)
    calls = []
    monkeypatch.setattr(encoder, "PIECE_BYTES", 1)
    monkeypatch.setattr(container, "rows_of_task", lambda threads: 16)
    pieces = writer.write_frame(tmp_path / "pieces" / name, frame, relax=lambda: calls.append(1))
    one, other = (oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT) for path in (whole, pieces))
    np.testing.assert_array_equal(one, other)
    assert len(calls) == 10

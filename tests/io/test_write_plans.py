"""A frame whose header has other values than one before is written like a frame alone, and by what
was found for that one.

The plans are no part of the public interface: to write a frame alone in this process, they are
taken away.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest

from postfx.caching import LRUCache
from postfx.frame import Frame
from postfx.io import light_plan
from postfx.io.exr import keep_plan, picture
from postfx.io.sequence import read_sequence
from postfx.io.writer import write_frame

SIZE = (20, 24)
LETTERS = {"R": 1, "G": 2, "B": 3, "A": 4, "Z": 5}
MATRIX = np.arange(16, dtype=np.float32).reshape(4, 4)
VALUES: dict[str, list[Any]] = {
    "whole": [1, 2, 2, -3, 3.5],
    "number": [0.5, -0.0, 0.0, float(np.float32(1 / 3)), 2.0],
    "text": ["one", "two", "", "überlang " * 9, "one"],
    "pair": [np.float32([n, -n]) for n in range(5)],
    "worldToCamera": [MATRIX * n for n in range(5)],
    "timeCode": [OpenEXR.TimeCode(1, 2, 3, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
                 for n in range(5)],
    "sometimes": [None, None, 7, 8, None],
}
DATE = re.compile(rb"capDate\0string\0.{4}[\d: ]{19}", re.DOTALL)
"""The one attribute that is of the moment of writing."""


def write_source(path: Path, number: int, parts: int) -> Path:
    """A frame of one part or several, whose headers have values of their own; the second frame's
    parts differ in their time code."""
    header = {name: values[number] for name, values in VALUES.items() if values[number] is not None}
    rng = np.random.default_rng(number)
    made = []
    for part in range(parts):
        own = dict(header)
        if part and number == 1:
            own["timeCode"] = VALUES["timeCode"][4]
        letters = LETTERS if part == 0 else ("T", "U")
        channels = {letter: rng.random(SIZE, np.float32) for letter in letters}
        if part == 0:
            channels["id"] = rng.integers(0, 9, SIZE, np.uint32)
        made.append(OpenEXR.Part({"type": OpenEXR.scanlineimage,
                                  "compression": OpenEXR.ZIP_COMPRESSION, **own}, channels,
                                 *([f"part{part}"] if parts > 1 else [])))
    OpenEXR.File(made).write(str(path))
    return path


def take_plans_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_plan, "_LIGHT_PLANS", LRUCache(8))
    monkeypatch.setattr(keep_plan, "_KEEP_PLANS", LRUCache(8))


@pytest.fixture
def headers(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """One entry for each header that OpenImageIO makes."""
    made: list[str] = []
    encode = picture.encode_pixel

    def count(suffix: str, spec: oiio.ImageSpec) -> bytes:
        made.append(suffix)
        return encode(suffix, spec)

    monkeypatch.setattr(picture, "encode_pixel", count)
    take_plans_away(monkeypatch)
    return made


@pytest.mark.parametrize("keep", [True, False], ids=["keep", "alone"])
@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("scale", [1, 2])
def test_frames_are_written_as_each_alone(tmp_path: Path, parts: int, keep: bool, scale: int,
                                          headers: list[str],
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    frames = []
    for number in range(5):
        source = write_source(tmp_path / f"in.{number:04d}.exr", number, parts)
        (frame,) = read_sequence(source)
        planes = {role: np.repeat(np.repeat(plane, scale, 0), scale, 1)
                  for role, plane in frame.planes.items()}
        frames.append(frame.copy_with(planes=planes))

    def write(name: str, frame: Frame) -> bytes:
        told = {"note": f"frame {frame.number}", "postfx:exposureUsed": float(frame.number)}
        path = write_frame(tmp_path / name, frame, provenance=told, keep=keep)
        return DATE.sub(b"", path.read_bytes())

    together = [write(f"together.{number}.exr", frame) for number, frame in enumerate(frames)]
    assert len(headers) < len(frames), "frames with the same attributes have one plan"
    for number, frame in enumerate(frames):
        take_plans_away(monkeypatch)
        assert write(f"alone.{number}.exr", frame) == together[number], number


def test_openimageio_makes_one_header_for_frames_that_differ_in_values(
    tmp_path: Path, headers: list[str]
) -> None:
    for number in range(2):
        (frame,) = read_sequence(write_source(tmp_path / f"in.{number:04d}.exr", number, 1))
        written = write_frame(tmp_path / f"out.{number}.exr", frame)
        found = OpenEXR.File(str(written)).header()
        for name, values in VALUES.items():
            if name != "timeCode" and values[number] is not None:
                np.testing.assert_array_equal(found[name], values[number], err_msg=name)
        assert str(found["timeCode"]) == str(VALUES["timeCode"][number])
        assert np.signbit(found["number"]) == np.signbit(VALUES["number"][number])
    assert len(headers) == 1


def test_a_value_that_only_openimageio_writes_makes_a_header_of_its_own(
    tmp_path: Path, headers: list[str]
) -> None:
    """As a rate of frames, which is stored as a quotient."""
    for number, rate in enumerate((24.0, 24.0, 30000 / 1001)):
        frame = Frame({"colour": np.ones((4, 4, 3), np.float32)},
                      metadata={"framesPerSecond": rate, "number": float(number)})
        written = write_frame(tmp_path / f"{number}.exr", frame)
        found = OpenEXR.File(str(written)).header()
        assert float(found["FramesPerSecond"]) == pytest.approx(rate)
        assert found["number"] == number
    assert len(headers) == 2

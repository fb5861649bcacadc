"""`--cuts` and `--depth` of `postfx run`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx import integrate, read_sequence

ROOM = Path(__file__).resolve().parents[2] / "samples" / "room" / "noisy.####.exr"


@pytest.fixture
def two_shots(tmp_path):
    """in/shot.0001.exr to 0004.exr: two frames of a room, then two upside down, without marks of
    cuts."""
    for frame in read_sequence(ROOM, frames="1-4"):
        planes = (frame.planes if frame.number < 3
                  else {r: np.rot90(p, 2) for r, p in frame.planes.items()})
        integrate.write_planes(tmp_path / f"in/shot.{frame.number:04d}.exr",
                               replace(frame, planes=planes, reset=False))


@pytest.mark.parametrize(("cuts", "found"),
                         [((), [3]), (("--cuts", "none"), []), (("--cuts", "1,3"), [])])
def test_cuts_are_found_and_overridden(postfx, two_shots, cuts, found):
    done = postfx("run", "in/", "-o", "out/####.png", "--no-denoise", "--json", *cuts)
    assert done.code == 0 and done.json["cuts"] == found
    assert ("found at 3 (--cuts says otherwise)" in done.err) == bool(found)


def test_frames_named_as_cuts_are_reset(two_shots, tmp_path):
    sequence = read_sequence(tmp_path / "in", cuts=[2, 4])
    assert [frame.reset for frame in sequence] == [False, True, False, True]


def test_no_cuts_overrides_headers_but_not_gaps(tmp_path):
    for frame in read_sequence(ROOM, frames="1,2,4"):
        integrate.write_planes(tmp_path / f"{frame.number:04d}.exr", replace(frame, reset=True))
    assert ([frame.reset for frame in read_sequence(tmp_path / "####.exr", "1,2,4", cuts=())]
            == [False, False, True])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--cuts", "always"), "cuts 'always': use auto, none, or the frames at which shots begin"),
        (("--depth", "z"), "depth 'z': begin with planar, ray, device"),
        (("--depth", "reversed"),
         "in/shot.0001.exr: AOV 'depth' (depth.Z) is a depth buffer and its near plane"),
    ],
)
def test_what_cannot_be_used_is_an_error(postfx, two_shots, arguments, message):
    done = postfx("run", "in/", "-o", "out/####.png", "--no-denoise", *arguments)
    assert done.code == 2 and message in done.err and done.err.startswith("error: ")


def test_depth_may_be_said_to_be_reversed(postfx, two_shots):
    done = postfx("run", "in/", "-o", "out/####.png", "--depth", "reversed,near=0.1", "--frames",
                  "1")
    assert done.code == 0, done.err


def test_an_estimate_that_was_asked_for_is_not_told_as_missing_vectors(postfx, write_exr, tmp_path):
    random = np.random.default_rng(1)
    names = [f"{layer}.{letter}" for layer in ("Combined", "Diffuse Color", "Normal")
             for letter in ("XYZ" if layer == "Normal" else "RGB")]
    for number in (1, 2):
        planes = {f"ViewLayer.{name}": random.random((40, 56), np.float32) for name in names}
        vectors = {f"ViewLayer.Vector.{letter}": np.ones((40, 56), np.float32) for letter in "XYZW"}
        write_exr(f"with/a.{number}.exr", planes | vectors, Software="Blender 5.0.1")
        write_exr(f"without/a.{number}.exr", planes, Software="Blender 5.0.1")
    missing = "AOV motion: not in the file"
    for folder, motion, is_told in (("with", "estimate", False), ("without", "auto", True)):
        done = postfx("run", f"{folder}/a.#.exr", "-o", f"{folder}/out.#.exr", "--motion", motion,
                      "--model", "s")
        assert done.code == 0 and "motion is estimated from" in done.err, done.err
        assert (missing in done.err) == is_told

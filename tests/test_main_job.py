"""The main job on the sample sequence: the command line against the library, frame by frame."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.frame import Role

SAMPLE = Path(__file__).parent.parent / "samples" / "room" / "noisy.####.exr"
FRAMES = 3


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> tuple[Path, dict]:
    """Folder of a run to tone-mapped EXR, and the object that the run printed."""
    folder = tmp_path_factory.mktemp("run")
    command = [sys.executable, "-m", "postfx", "run", str(SAMPLE), "-o",
               str(folder / "out.####.exr"),
               "--scale", "2", "--model", "m", "--frames", f"1-{FRAMES}", "--tonemap", "--json"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return folder, json.loads(printed)


def test_run_says_what_it_did(output):
    folder, said = output
    assert said["frames"] == FRAMES == len(said["outputs"])
    assert set(said["passes"]) == {"denoise_upscale", "tonemap"}
    assert (said["ms_per_frame"]["min"] <= said["ms_per_frame"]["median"]
            <= said["ms_per_frame"]["max"])
    assert said["warnings"] == []


def test_library_frame_by_frame_gives_the_same_pixels(output, tmp_path):
    shot = postfx.read_sequence(SAMPLE, frames=f"1-{FRAMES}")
    passes = postfx.Pipeline([postfx.DenoiseUpscale(scale=2), postfx.ToneMap()],
                             run_up=postfx.RunUp(shot))
    for frame in shot:
        mine = postfx.write_frame(tmp_path / f"out.{frame.number:04d}.exr", passes(frame))
        ours, theirs = (next(iter(postfx.read_sequence(folder / mine.name)))
                        for folder in (tmp_path, output[0]))
        assert ours.spec.width == 640 and ours.spec.height == 360
        assert np.array_equal(ours[Role.COLOUR], theirs[Role.COLOUR])


def test_result_is_calmer_than_the_input(output):
    noisy = next(iter(postfx.read_sequence(SAMPLE, frames="3")))
    clean = next(iter(postfx.read_sequence(output[0] / "out.0003.exr")))
    wall = (slice(8, 24), slice(60, 120))  # plain, in input pixels
    grain = [np.abs(np.diff(image, axis=1)).mean() / image.mean() for image in (
        noisy[Role.COLOUR][wall],
        clean[Role.COLOUR][tuple(slice(2 * s.start, 2 * s.stop) for s in wall)])]
    assert grain[1] < 0.05 * grain[0]

"""Figures of a benchmark: by hand, and against the script that scores the sequences other software
rendered."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("flip_evaluator", reason="needs the extra 'bench'")
pytest.importorskip("skimage", reason="needs the extra 'bench'")
from postfx.frame import Frame, Role  # noqa: E402
from postfx.io.writer import write_frame  # noqa: E402
from postfx.tools.bench import metrics  # noqa: E402
from postfx.tools.bench.measure import Material, Sources  # noqa: E402


def frame(colour, number=1, **facts):
    motion = facts.pop("motion", np.zeros((*colour.shape[:2], 2), np.float32))
    return Frame({Role.COLOUR: colour.astype(np.float32), Role.MOTION: motion}, number, **facts)


def test_what_is_shown_of_mid_grey():
    grey = metrics.to_codes(np.full((2, 2, 3), 1.0, np.float32), 1.0)
    assert np.allclose(grey, 0.735357, atol=1e-5)  # sRGB of 1 / 2
    assert metrics.to_codes(np.full((1, 1, 3), np.nan, np.float32), 1.0).max() == 0


def test_psnr_of_a_tenth():
    one = np.full((8, 8, 3), 0.5)
    assert metrics.psnr(one, one + 0.1) == pytest.approx(20.0, abs=1e-4)
    assert metrics.psnr(one, one) == pytest.approx(120.0)


def test_noise_of_two_references_does_not_count():
    noise = np.random.default_rng(4).normal(0, 0.05, (2, 200, 200, 3))
    truth = np.full((200, 200, 3), 0.5)
    picture = truth + 0.02
    assert metrics.psnr(picture, truth + noise[0]) < 26
    error = metrics.psnr_of_two(picture, truth + noise[0], truth + noise[1])
    assert error == pytest.approx(metrics.psnr(picture, truth), abs=0.3)


def test_a_second_reference_is_part_of_a_sequence():
    rng = np.random.default_rng(5)
    colour = np.full((64, 64, 3), 0.5, np.float32)
    noisy = frame(colour)
    references = [frame(colour + rng.normal(0, 0.05, colour.shape)) for _ in range(2)]
    alone, both = metrics.SequenceScore(), metrics.SequenceScore()
    alone.add(colour + np.float32(0.01), references[0], noisy)
    both.add(colour + np.float32(0.01), references[0], noisy, references[1])
    assert both.frames[0]["psnr"] > alone.frames[0]["psnr"] + 6
    assert both.frames[0]["flip"] < alone.frames[0]["flip"]


def test_relmse_leaves_the_worst_pixels_out():
    reference = np.ones((40, 50, 3), np.float32)
    result = reference + 0.1
    result[0, :2] = 1e6
    assert metrics.relmse(result, reference, 1.0) == pytest.approx(0.01 / 1.01, rel=1e-4)


def test_what_moves_along_does_not_flicker():
    picture = np.random.default_rng(2).random((16, 24, 3)).astype(np.float32)
    motion = np.zeros((16, 24, 2), np.float32)
    motion[..., 0] = -1
    before = metrics.Pictures(picture, picture)
    now = metrics.Pictures(*[np.roll(picture, 1, axis=1)] * 2)
    assert metrics.flicker(before, now, motion) == 0
    wrong = metrics.Pictures(picture + 0.01, picture)
    assert metrics.flicker(wrong, now, motion) == pytest.approx(10, rel=1e-3)


def test_summary_of_a_sequence():
    scores = metrics.SequenceScore()
    colour = np.random.default_rng(3).random((32, 32, 3)).astype(np.float32)
    for number, error in enumerate([0.2, 0.1, 0.0, 0.05], 1):
        noisy = frame(colour, number, reset=number == 3)
        result = colour + np.float32(error)
        result[0, 0] = np.inf if number == 2 else result[0, 0]
        scores.add(result, frame(colour, number, exposure=0.0), noisy)
    summary = scores.summary()
    assert [row["flicker"] is None for row in scores.frames] == [True, False, True, False]
    assert summary["flicker_late"] == scores.frames[3]["flicker"]
    assert (summary["worst_frame"] == 1
            and summary["worst_psnr"] == min(row["psnr"] for row in scores.frames))
    assert (summary["psnr_late"]
            == pytest.approx((scores.frames[2]["psnr"] + scores.frames[3]["psnr"]) / 2))
    assert summary["not_finite"] == 3


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("living_room", marks=pytest.mark.soak), "garage"])
def test_agrees_with_the_script(shared_dir, tmp_path, name):
    """Two frames of generic and of Cycles planes, the result a little wrong in a way that changes
    over time."""
    folder = shared_dir / "sequences" / name
    for number in (1, 2):
        for kind in ("noisy", "reference"):
            (tmp_path / f"{kind}.{number:04d}.exr").symlink_to(folder / f"{kind}.{number:04d}.exr")
    material = Material(Sources(str(tmp_path / "noisy.####.exr"),
                                str(tmp_path / "reference.####.exr")))
    scores = metrics.SequenceScore()
    for number in material.noisy.numbers:
        reference = material.reference(number)
        colour = reference[Role.COLOUR] * np.float32(1 + 0.1 * np.sin(number)) + np.float32(0.01)
        write_frame(tmp_path / f"out.{number:04d}.exr", frame(colour, number))
        result = material.result(str(tmp_path / "out.{number}.exr"), number)[Role.COLOUR]
        scores.add(result, reference, material.motion(number))
    command = [sys.executable, folder.parent / "score.py", tmp_path, tmp_path / "out.%04d.exr",
               "--json"]
    expected = json.loads(subprocess.run(command, capture_output=True, text=True, check=True)
                          .stdout)
    summary = scores.summary()
    for figure in metrics.FIGURES:
        for suffix in ("", "_late"):
            assert summary[figure + suffix] == pytest.approx(expected[figure + suffix],
                                                             rel=2e-5), figure + suffix

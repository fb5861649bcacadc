"""Recorded figures beside the goals that the pages name."""

from __future__ import annotations

import re

import pytest

from training.measure.record import RUNS, load

MOST_TIME = 0.25
"""Of a frame with 90 % masked, over that of a whole one."""
BEYOND = {"masked_speed_m_guides", "masked_speed_l_1x", "masked_speed_xl_1x",
          "masked_speed_xl_centred"}
"""Runs that take more: docs/lab/denoising.md says so."""


def found(name: str, pattern: str) -> list[list[float]]:
    """The numbers in a record's lines that have a pattern; at least one."""
    rows = re.findall(pattern, load(name).output)
    assert rows, f"{name} has no line {pattern}"
    return [[float(number) for number in ([row] if isinstance(row, str) else row)] for row in rows]


def test_a_frame_with_most_of_it_masked_takes_a_quarter() -> None:
    names = sorted(path.stem for path in RUNS.glob("masked_speed_*.txt"))
    shares = {name: found(name, r"90 % masked: .*? ms, ([\d.]+);")[0][0] for name in names}
    assert len(shares) >= 12
    assert {name for name, share in shares.items() if share > MOST_TIME} == BEYOND


def test_an_orbit_is_shaded_far_better_than_by_the_frame_before() -> None:
    ((shaded, before),) = found("neural_shading_orbit",
                                r"mean ([\d.]+) dB.*frames before as they are ([\d.]+) dB")
    assert shaded >= 27.0
    assert shaded >= before + 3


def test_the_amplifier_is_worth_more_samples_than_the_published_one() -> None:
    views = found("scene_network", r"of 1 [\d.]+: worth ([\d.]+) samples")
    assert len(views) == 3
    assert min(views) >= [67.6]


def test_the_toy_training_takes_two_cores_a_minute_and_learns() -> None:
    seconds = found("toy_training", r"([\d.]+) s of the processor")
    assert sum(one for one, in seconds) <= 2 * 60
    (before,), (after,) = found("toy_training", r"held out ([\d.]+) dB")
    assert after >= before + 0.3


@pytest.mark.parametrize("name", ["mlp_in_kernel", "gpu_mlp"])
def test_a_network_inside_a_kernel_is_faster_than_three_dispatches(name: str) -> None:
    ((one, three),) = found(name, r"one dispatch ([\d.]+) ms, three ([\d.]+) ms")
    assert one < three


def test_a_gpu_shades_by_points_as_fast_as_was_published() -> None:
    ((frames,),) = found("gpu_scene_passes_1000x640",
                         r"scene_shading, points.* ([\d.]+) frames a second")
    assert frames >= 64

"""The study of hit distances at toy size: it runs, and its distances are those of the scene."""

import os
from pathlib import Path

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba", reason="mitsuba is not installed (extra 'train')")

FOUND = [*Path("/usr/lib").glob("*/libLLVM*19*"), *Path("/usr/lib/llvm-19/lib").glob("libLLVM*.so*")]
if FOUND:
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(FOUND[0]))
if "DRJIT_LIBLLVM_PATH" not in os.environ:
    pytest.skip("no libLLVM newer than 15 for Mitsuba's llvm_ad_rgb", allow_module_level=True)
mi.set_variant("llvm_ad_rgb")

from postfx.frame import Role  # noqa: E402
from training import reflection_study as study  # noqa: E402
from training.scenes.sample_room import SIZE  # noqa: E402

SMALL = ["--size", "48x27", "--frames", "3", "--judged", "2", "--spp", "1", "--reference-spp", "1", "--model", "s"]


def test_hit_distances_end_at_the_walls():
    args = study.arguments([*SMALL, "--roughness", "0.01"])
    shot = study.Shot(args)
    frame = shot.frame(1)
    floor, distance = shot.on_floor(frame), frame[Role.SPECULAR_HIT_DISTANCE][..., 0]
    inside = floor & (distance < 100)  # the rest is seen through the windows
    assert 0.4 < floor.mean() < 0.8 and inside.sum() > 0.8 * floor.sum()
    assert (distance[inside] > 0).mean() > 0.98 and distance[inside].max() < np.linalg.norm(SIZE)


@pytest.mark.parametrize(("place", "share"), [((), 0.6), (("--wall",), 0.2), (("--drafted", "5"), 0.03)])
def test_it_prints_the_polished_part_and_the_rest(place, share, capsys):
    study.main([*SMALL, "--judged", "1", "2", *place])
    head, *lines = capsys.readouterr().out.splitlines()
    assert float(head.split("%")[0]) > 100 * share / 2 and head.endswith("of the picture is judged")
    assert [line[4:16].strip() for line in lines] == ["hit distance", "without", "no history"]
    assert all(" dB, flicker " in line and "; rest " in line and "nan" not in line for line in lines)

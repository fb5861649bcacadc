"""Held-out views, and the same light paths rendered both ways, at toy size."""

import argparse
import json
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
from postfx.io.sequence import read_sequence  # noqa: E402
from training import equal_rays, equivalent_samples  # noqa: E402
from training.held_out import FIRST_SEED, held_out_view  # noqa: E402
from training.tracing import Tracer  # noqa: E402

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rays")
    arguments = ["render", str(folder), "--scenes", "1", "--variant", "llvm_ad_rgb", "--width", "32", "--height", "24"]
    arguments += ["--frames", "2", "--reference-error", "0.05", "--most-spp", "256"]
    equal_rays.render(equal_rays.arguments(arguments))
    equal_rays.render(equal_rays.arguments(arguments))  # nothing is left to do
    return folder


def test_training_s_seeds_are_refused():
    with pytest.raises(ValueError, match="seed 12 may be a training clip's: take one from 9000 on"):
        held_out_view(Tracer(), 12, 32, 0.05, 256)


def test_both_ways_take_as_many_paths(rendered):
    (scene,) = rendered.iterdir()
    for style in equal_rays.STYLES:
        half, full = (list(read_sequence(scene / f"{style}.{way}.####.exr")) for way in ("half", "full"))
        for frames in zip(half, full, strict=True):
            paths = [frame.samples * frame.spec.width * frame.spec.height for frame in frames]
            assert paths[0] == paths[1] == 4 * 32 * 24
        assert half[0].reset and half[1].jitter == full[1].jitter
        assert any(half[1].jitter) == (style == "realtime")
    assert half[0].exposure == next(iter(read_sequence(scene / "reference.####.exr"))).exposure


def test_references_and_guides_have_the_output_s_size(rendered):
    (scene,) = rendered.iterdir()
    reference = next(iter(read_sequence(scene / "reference.####.exr")))
    frame = read_sequence(scene / "box.half.####.exr")
    assert reference[Role.COLOUR].shape == (48, 64, 3) and (frame.read(1).spec.width, len(frame)) == (32, 2)
    guides = next(iter(read_sequence(scene / "realtime.guides.####.exr", planes=[Role.NORMAL, Role.DEPTH])))
    assert guides[Role.NORMAL].shape == (48, 64, 3) and any(guides.jitter)
    noisy = frame.read(1)[Role.COLOUR].mean()
    assert noisy == pytest.approx(reference[Role.COLOUR].mean(), rel=0.5)


def test_comparing_them(rendered, tmp_path, capsys):
    for module in ("flip_evaluator", "skimage", "matplotlib"):
        pytest.importorskip(module, reason="needs the extra 'bench'")
    equal_rays.compare(argparse.Namespace(out=rendered, results=tmp_path, methods="bicubic", models=None,
                                          runs=1, device="cpu"))
    facts = json.loads((tmp_path / "equal_rays.json").read_text())
    ways = [(row["way"], row["method"], row["sequences"]) for row in facts["means"]]
    assert ways == [(way, method, 2) for way in ("half", "full") for method in ("bicubic",)]
    assert len(facts["rows"]) == 4 and "full      bicubic" in capsys.readouterr().out


def test_a_view_for_equivalent_samples(tmp_path):
    arguments = ["render", str(tmp_path / "view.npz"), "--variant", "llvm_ad_rgb", "--width", "32", "--height", "24"]
    arguments += ["--samples", "24", "--inputs", "3", "--half-spp", "64", "--reference-error", "0.05"]
    equivalent_samples.render(equivalent_samples.arguments(arguments))
    with np.load(tmp_path / "view.npz") as view:
        counts, means = view["counts"], view["means"]
        assert np.allclose(means[counts == 3][0], view["colour"].mean(0), rtol=1e-4, atol=1e-6)
        assert not np.array_equal(view["colour"][0], view["colour"][1]) and np.abs(view["motion"]).max() < 1e-3
        facts = json.loads(str(view["facts"]))
        assert facts["scene"] == "room" and facts["seed"] >= FIRST_SEED
        errors = equivalent_samples.Errors(view["reference_a"], view["reference_b"], 1.0)
        found = [errors(mean)["relmse"] for mean in means]
    assert found[-1] < found[0] / 4

"""Held-out views, and a view for equivalent sample counts, at toy size."""

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

from training import equivalent_samples  # noqa: E402
from training.held_out import FIRST_SEED, METALS, TRAITS, Kind, held_out_view  # noqa: E402
from training.scenes.build import Description  # noqa: E402
from training.scenes.materials import Material  # noqa: E402
from training.scenes.motion import Cut  # noqa: E402
from training.tracing import Tracer  # noqa: E402


def test_training_s_seeds_are_refused() -> None:
    with pytest.raises(ValueError, match="seed 12 may be a training clip's: take one from 9000 on"):
        held_out_view(Tracer(), 12, 32, 0.05, 256)


def test_kinds_ask_for_a_family_and_a_trait() -> None:
    plain, metal = Description("room"), Description("room", [Material(METALS[0])], movers=[lambda t: np.eye(4)])
    assert Kind().fits(plain) and Kind("room").fits(plain) and not Kind("outdoor").fits(plain)
    assert {name for name in TRAITS if Kind("room", name).fits(metal)} == {"moving", "metal"}
    assert not any(Kind(None, name).fits(plain) for name in TRAITS)


@pytest.mark.slow
def test_a_cut_leads_to_another_view_of_the_scene() -> None:
    view = held_out_view(Tracer(), FIRST_SEED, 32, 0.05, 512, Kind("product", "moving", 2))
    assert view.name == "product" and view.built.description.movers and isinstance(view.path, Cut)
    poses = [view.path.at(t).to_world[:3] for t in range(4)]
    steps = [np.abs(after - before).max() for before, after in zip(poses, poses[1:], strict=False)]
    assert steps[1] > 4 * max(steps[0], steps[2], 0.01)


@pytest.mark.slow
def test_a_view_for_equivalent_samples(tmp_path: Path) -> None:
    arguments = ["render", str(tmp_path / "view.npz"), "--variant", "llvm_ad_rgb", "--width", "32", "--height", "24"]
    arguments += ["--samples", "24", "--inputs", "3", "--half-spp", "64", "--reference-error", "0.05"]
    equivalent_samples.render(equivalent_samples.arguments(arguments))
    view = equivalent_samples.load_view(tmp_path / "view.npz")
    counts, means = view["counts"], view["means"]
    assert np.allclose(means[counts == 3][0], view["colour"].mean(0), rtol=1e-4, atol=1e-6)
    assert not np.array_equal(view["colour"][0], view["colour"][1]) and np.abs(view["motion"]).max() < 1e-3
    errors = equivalent_samples.Errors(view["reference_a"], view["reference_b"], 1.0)
    found = [errors(mean)["relmse"] for mean in means]
    assert found[-1] < found[0] / 4

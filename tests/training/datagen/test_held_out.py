"""Held-out views, and a view for equivalent sample counts, at toy size."""

from pathlib import Path

import numpy as np
import pytest

from tests.training.llvm import require_mitsuba

mi = require_mitsuba()

from training.datagen.held_out import FIRST_SEED, TRAITS, Kind, held_out_view, shows  # noqa: E402
from training.datagen.scenes import meshes  # noqa: E402
from training.datagen.scenes.build import BuiltScene, Description  # noqa: E402
from training.datagen.scenes.materials import Material  # noqa: E402
from training.datagen.scenes.motion import CameraPath, Cut, object_path  # noqa: E402
from training.datagen.tracing import Tracer  # noqa: E402
from training.measure import equivalent_samples  # noqa: E402


def test_training_s_seeds_are_refused() -> None:
    with pytest.raises(ValueError, match="seed 12 may be a training clip's: take one from 9000 on"):
        held_out_view(Tracer(), 12, 32, 0.05, 256)


def test_scenes_may_show_what_they_have() -> None:
    plain = Description("room")
    metal = Description("room", [Material("conductor")], movers=[lambda t: np.eye(4)])
    assert {name for name, trait in TRAITS.items() if trait.has(metal)} == {"moving", "metal"}
    assert not any(trait.has(plain) for trait in TRAITS.values())


def still(d: Description) -> tuple[BuiltScene, CameraPath]:
    """A scene and a camera that stands before a square of two metres about the origin."""
    square = meshes.quad([-1, -1, 0], [2, 0, 0], [0, 2, 0])
    d.add(square, 0, mover=0 if d.movers else None)
    eye = np.array([0, 0, 3.0])
    return BuiltScene(d), CameraPath(eye, np.zeros(3), 60.0, "pan", 0.0, np.ones(3), 1)


@pytest.mark.parametrize(("kind", "seen"),
                         [("conductor", "metal"), ("dielectric", "glass"), ("diffuse", "")])
def test_a_material_is_seen(kind: str, seen: str) -> None:
    built, path = still(Description("room", [Material(kind)]))
    found = {name
             for name in ("metal", "glass", "moving") if shows(Tracer(), built, path, name, 8, 1)}
    assert found == ({seen} if seen else set())


def test_a_thing_that_moves_is_seen_and_one_that_rests_is_not() -> None:
    tracer = Tracer()
    for speed, seen in ((0.0, False), (0.05, True)):
        mover = object_path(np.zeros(3), np.array([speed, 0, 0]), np.array([0, 1.0, 0]), 0.0)
        built, path = still(Description("room", [Material("diffuse")], movers=[mover]))
        assert shows(tracer, built, path, "moving", 8, 1) == seen


def test_a_light_that_flickers_is_seen() -> None:
    for low, seen in ((0.2, True), (0.99, False)):
        d = Description("room", [Material("diffuse")],
                        glows=[lambda t, low=low: 1.0 if t % 2 else low])
        d.emit(meshes.quad([1, 1, 3], [-2, 0, 0], [0, 1, 0]), np.ones(3), glow=0)
        built, path = still(d)
        assert shows(Tracer(), built, path, "flicker", 4, 1) == seen


@pytest.mark.slow
def test_a_cut_leads_to_another_view_of_the_scene() -> None:
    view = held_out_view(Tracer(), FIRST_SEED, 32, 0.05, 512, Kind("outdoor", None, 2, 4))
    assert view.name == "outdoor" and isinstance(view.path, Cut)
    poses = [view.path.at(t).to_world[:3] for t in range(4)]
    steps = [np.abs(after - before).max() for before, after in zip(poses, poses[1:], strict=False)]
    assert steps[1] > 4 * max(steps[0], steps[2], 0.01)


@pytest.mark.slow
def test_a_view_for_equivalent_samples(tmp_path: Path) -> None:
    arguments = ["render", str(tmp_path / "view.npz"), "--variant", "llvm_ad_rgb", "--width", "32",
                 "--height", "24"]
    arguments += ["--samples", "24", "--inputs", "3", "--half-spp", "64", "--reference-error",
                  "0.05"]
    equivalent_samples.render(equivalent_samples.arguments(arguments))
    view = equivalent_samples.load_view(tmp_path / "view.npz")
    counts, means = view["counts"], view["means"]
    assert np.allclose(means[counts == 3][0], view["colour"].mean(0), rtol=1e-4, atol=1e-6)
    assert (not np.array_equal(view["colour"][0], view["colour"][1])
            and np.abs(view["motion"]).max() < 1e-3)
    errors = equivalent_samples.Errors(view["reference_a"], view["reference_b"], 1.0)
    found = [errors(mean)["relmse"] for mean in means]
    assert found[-1] < found[0] / 4

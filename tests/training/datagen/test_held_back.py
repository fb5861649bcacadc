"""Scenes that are kept for validation are in no training."""

import importlib.util
import json
import subprocess
import sys

import pytest

from training.datagen import held_back

CHOSEN = "bathroom", "fox", "camp", "staircase"


def test_at_least_twelve_scenes_are_held_back():
    assert len(held_back.SCENES) >= 12
    assert not held_back.SCENES & {"camp", "staircase"}


def test_a_scene_that_is_held_back_is_refused_by_name():
    with pytest.raises(ValueError, match="'fox' is held back for validation"):
        held_back.refuse("fox")
    held_back.refuse("camp")


@pytest.fixture
def scalar_mitsuba():
    """Mitsuba with its plainest variant, and then with the one that it had."""
    mitsuba = pytest.importorskip("mitsuba")
    before = mitsuba.variant()
    mitsuba.set_variant("scalar_rgb")
    yield mitsuba
    if before:
        mitsuba.set_variant(before)


@pytest.mark.usefixtures("scalar_mitsuba")
def test_mitsuba_draws_no_scene_that_is_held_back(tmp_path):
    from training.datagen.scenes.convert import RealScenes

    for name in ("bathroom", "fox"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.json").write_text("{}")
    assert not RealScenes(tmp_path)
    (tmp_path / "camp").mkdir()
    (tmp_path / "camp" / "scene.json").write_text("{}")
    assert RealScenes(tmp_path)


def test_blender_loads_no_scene_that_is_held_back(tmp_path):
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed")
    for name in CHOSEN:
        (tmp_path / name).mkdir()
        (tmp_path / name / "about.json").write_text(json.dumps({"kind": "set"}))
        (tmp_path / name / "scene.gltf").touch()
        (tmp_path / name / "scene.xml").touch()
    code = ("import sys; from pathlib import Path; from training.datagen.cycles.blender.kinds "
            "import Library;found = Library(Path(sys.argv[1]));print(sorted(found.about), "
            "sorted(room.name for room in found.rooms))")
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True,
                          text=True, check=True)
    assert "['camp', 'staircase'] ['camp', 'staircase']" in done.stdout

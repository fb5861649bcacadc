"""Ray-traced views of ambient occlusion: what is known of a box on a floor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.training.llvm import require_mitsuba

mi = require_mitsuba()

from training.datagen.occlusion import EMPTY, RADII, Scene, render  # noqa: E402
from training.datagen.scenes.meshes import box  # noqa: E402


def test_a_box_on_a_floor(tmp_path: Path) -> None:
    """The floor far away is open; beside the box it is darker the larger the radius; normals and depth face the eye."""
    mesh = box(np.array([-0.5, 0, -0.5]), np.array([0.5, 1, 0.5]))
    np.savez(tmp_path / "geometry.npz", v0=mesh.vertices.astype(np.float32), f0=mesh.faces,
             n0=np.round(mesh.normals * 127).astype(np.int8))
    facts = {"shapes": [{}], "around": True, "indoor": False, "cameras": [], "low": [-0.5, 0, -0.5],
             "high": [0.5, 1, 0.5], "inner": [[-0.3, 0.1, -0.3], [0.3, 0.6, 0.3]]}
    (tmp_path / "scene.json").write_text(json.dumps(facts))
    scene = Scene(tmp_path)
    eye, target = np.array([0.0, 1.5, 2.5]), np.array([0.0, 0.5, 0.0])
    view = render(scene.scene, eye, target, 0.6, (48, 36), 64, 0, most_open=1.0)
    assert view is not None
    visible, there = view["visible"].astype(float), view["depth"] < EMPTY
    assert visible.min() >= 0 and visible.max() <= 1 and (visible[:, ~there] == 1).all()
    assert (np.diff(visible, axis=0) <= 1e-3).all() and len(visible) == len(RADII)
    assert visible[:, -2:, :4].min() > 0.98 and 0.4 < visible[2, there].min() < 0.7
    assert view["normal"][there][:, 2].min() > -0.2 and 1 < view["depth"][18, 24] < 3

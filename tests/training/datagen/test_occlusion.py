"""Ray-traced views of ambient occlusion: what is known of a box on a floor."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.training.llvm import require_mitsuba

mi = require_mitsuba()

from training.datagen.occlusion import (  # noqa: E402
    EMPTY,
    LEARNT_RADII,
    RADII,
    Scene,
    draw_shares,
    mix,
    render,
    stretched,
    view_of_mix,
)
from training.datagen.scenes.meshes import box  # noqa: E402


def box_scene(folder: Path) -> Path:
    """A folder with a converted scene of one box."""
    mesh = box(np.array([-0.5, 0, -0.5]), np.array([0.5, 1, 0.5]))
    np.savez(folder / "geometry.npz", v0=mesh.vertices.astype(np.float32), f0=mesh.faces,
             n0=np.round(mesh.normals * 127).astype(np.int8))
    facts = {"shapes": [{}], "around": True, "indoor": False, "cameras": [], "low": [-0.5, 0, -0.5],
             "high": [0.5, 1, 0.5], "inner": [[-0.3, 0.1, -0.3], [0.3, 0.6, 0.3]]}
    (folder / "scene.json").write_text(json.dumps(facts))
    return folder


def test_a_box_on_a_floor(tmp_path: Path) -> None:
    """The floor far away is open; beside the box it is darker the larger the radius; normals and
    depth face the eye."""
    scene = Scene(box_scene(tmp_path))
    eye, target = np.array([0.0, 1.5, 2.5]), np.array([0.0, 0.5, 0.0])
    view = render(scene.scene, eye, target, 0.6, (48, 36), 64, 0, most_open=1.0)
    assert view is not None
    visible, there = view["visible"].astype(float), view["depth"] < EMPTY
    assert visible.min() >= 0 and visible.max() <= 1 and (visible[:, ~there] == 1).all()
    assert (np.diff(visible, axis=0) <= 1e-3).all() and len(visible) == len(RADII)
    assert visible[:, -2:, :4].min() > 0.98 and 0.4 < visible[2, there].min() < 0.7
    assert view["normal"][there][:, 2].min() > -0.2 and 1 < view["depth"][18, 24] < 3


def test_stretched_normals_stay_perpendicular() -> None:
    corners = np.random.default_rng(0).normal(size=(3, 3))
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    vertices, normals, _ = stretched((corners, np.tile(normal / np.linalg.norm(normal), (3, 1)),
                                      np.arange(3)),
                                     np.array([0.5, 1.0, 3.0]))
    np.testing.assert_allclose((vertices[1:] - vertices[0]) @ normals[0], 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


def test_mixed_and_stretched_scenes_give_views_to_learn_from(tmp_path: Path) -> None:
    random, scene = np.random.default_rng(0), Scene(box_scene(tmp_path), np.array([1.0, 2.0, 0.5]))
    assert np.ptp(scene.parts[0][0],
                  axis=0).tolist() == [1, 2, 0.5] == (scene.high - scene.low).tolist()
    shares, mixed = draw_shares(random), mix([scene], random)
    assert (LEARNT_RADII[0] <= shares[0] and (np.diff(shares) > 0).all()
            and shares[-1] <= LEARNT_RADII[1])
    views = [render(mixed, *view_of_mix(random), 0.6, (24, 16), 16, 0, shares=shares)
             for _ in range(12)]
    seen = [view for view in views if view]
    assert seen and all(view["visible"].shape == (len(shares), 16, 24) for view in seen)
    assert min(view["visible"][-1].mean() for view in seen) < 0.85

"""Files in every convention of depth, matrices and jitter: reflections move as in those of our
own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from postfx import integrate, read_sequence
from postfx.frame import DEPTH_MISS, Frame, Role
from tests.passes import mirror_scene as scene
from tests.passes.test_denoise_reflections import params_of, reflected

NEAR, FAR = 0.5, 40.0
SKY = np.s_[:9, 60:]
"""Pixels of the wall that hit nothing instead."""
KINDS: dict[str, Callable[[np.ndarray, Frame], np.ndarray]] = {
    "planar,miss=0": lambda depth, frame: np.where(depth < DEPTH_MISS, depth, 0),
    "planar,scale=-1,miss=1": lambda depth, frame: np.where(depth < DEPTH_MISS, -depth, 1),
    "planar,scale=0.01": lambda depth, frame: np.where(depth < DEPTH_MISS, 100 * depth, np.inf),
    "ray": lambda depth, frame: integrate.ray_from_depth(depth, frame.fov_x, frame.jitter),
    f"ray,fov={scene.FOV},miss=-1": lambda depth, frame: np.where(
        depth < DEPTH_MISS, integrate.ray_from_depth(depth, frame.fov_x, frame.jitter), -1),
    f"device,near={NEAR},far={FAR}": lambda depth, frame: integrate.depth_to_device(
        depth, NEAR, FAR
    ), f"reversed,near={NEAR}": lambda depth, frame: integrate.depth_to_device(
        depth, NEAR, reversed_z=True
    ), f"normalised,near={NEAR},far={FAR}": lambda depth, frame: np.minimum(
        (depth - NEAR) / (FAR - NEAR), 1
    ), f"normalised-reversed,near=0,far={FAR}": lambda depth, frame: 1 - np.minimum(depth / FAR, 1),
}


def sample(number: int, **options) -> Frame:
    frame = scene.frame(number, **options)
    frame.planes[Role.DEPTH][SKY], frame.planes[Role.NORMAL][SKY] = DEPTH_MISS, 0
    return frame


def through_files(frames: list[Frame], folder: Path, **reading) -> list[Frame]:
    for frame in frames:
        integrate.write_planes(folder / f"shot.{frame.number:04d}.exr", frame)
    return list(read_sequence(folder / "shot.####.exr", **reading))


def test_own_convention(tmp_path: Path) -> None:
    frames = [sample(3), sample(4)]
    found = through_files(frames, tmp_path)
    assert [frame.jitter for frame in found] == [pytest.approx(frame.jitter) for frame in frames]
    # motion is in half floats
    np.testing.assert_allclose(reflected(*found), reflected(*frames), atol=0.03)
    assert np.abs(reflected(*found) - found[1][Role.MOTION]).max() > 1


@pytest.mark.parametrize("kind", KINDS)
def test_depth_of_each_kind_becomes_planar(kind: str, tmp_path: Path) -> None:
    planar = through_files([sample(3), sample(4)], tmp_path / "planar")
    stored = [replace(frame,
                      planes={**frame.planes, Role.DEPTH: KINDS[kind](frame[Role.DEPTH], frame)})
              for frame in planar]
    found = through_files(stored, tmp_path / "stored", depth=kind)
    for one, other in zip(found, planar, strict=True):
        assert (one[Role.DEPTH][SKY] == DEPTH_MISS).all()
        np.testing.assert_allclose(one[Role.DEPTH], other[Role.DEPTH], rtol=1e-4)
    np.testing.assert_allclose(reflected(*found), reflected(*planar), atol=5e-3)


def test_column_vectors(tmp_path: Path) -> None:
    frames = through_files([sample(3), sample(4)], tmp_path / "rows")
    turned = [replace(frame, world_to_camera=frame.world_to_camera.T) for frame in frames]
    profile = tmp_path / "columns.toml"
    generic = Path(integrate.__file__).parents[1] / "io" / "profiles" / "generic.toml"
    profile.write_text(f"{generic.read_text()}\n[camera]\ncolumn_vectors = true\n")
    assert isinstance(params_of(*through_files(turned, tmp_path / "unsaid")), str)
    found = through_files(turned, tmp_path / "said", profile=str(profile))
    np.testing.assert_allclose(reflected(*found), reflected(*frames), atol=1e-3)


@pytest.mark.parametrize("aspect", [2.0, 0.5])
def test_pixels_that_are_not_square(aspect: float) -> None:
    """What is reflected at no distance moves as the surface does; a header of another shape of
    pixels is off."""
    off = []
    for told in (aspect, 1.0):
        before, now = (replace(scene.frame(number, 96, round(54 * aspect), pixel_aspect=aspect),
                               metadata={"pixelAspectRatio": told}) for number in (3, 4))
        touching = np.minimum(now[Role.SPECULAR_HIT_DISTANCE], 1e-6)
        off.append(np.abs(reflected(before, now, specular_hit_distance=touching) - now[Role.MOTION])
                   .max())
    assert off[0] < 1e-3 and off[1] > 0.05, off

"""Motion of reflections by their hit distance: against geometry, and what it is worth."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from postfx.compiled.library import Rows
from postfx.frame import Frame, Role
from postfx.integrate import pixel_positions, project
from postfx.kernels.denoise.history import REFLECTIONS
from postfx.passes import ResidentFrame
from postfx.passes.denoise import DenoiseUpscale
from postfx.passes.denoise.reflections import NO_CAMERA, NO_FIT, Camera, Cameras
from postfx.pipeline import Pipeline
from postfx.runtime import Device
from tests.kernels import host_cuda
from tests.passes import mirror_scene as scene

WIDTH, HEIGHT = 96, 54
PLANES = (Role.MOTION, Role.DEPTH, Role.NORMAL, Role.ROUGHNESS, Role.DIFFUSE_ALBEDO,
          Role.SPECULAR_ALBEDO, Role.SPECULAR_HIT_DISTANCE)


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


def resident(frame: Frame) -> ResidentFrame:
    return ResidentFrame(frame.spec, {}, frame.number, frame.jitter,
                         world_to_camera=frame.world_to_camera,
                         fov_x=frame.fov_x, metadata=frame.metadata, host_planes=dict(frame.planes))


def params_of(before: Frame, now: Frame) -> np.ndarray | str:
    """What the kernel is told of two frames, or why it is told nothing."""
    cameras = Cameras()
    cameras.step(resident(before), False)
    params, why = cameras.step(resident(now), True)
    return why or params


def reflected(before: Frame, now: Frame, **changed: np.ndarray) -> np.ndarray:
    """The kernel's motion (h, w, 2)."""
    planes = [np.ascontiguousarray(changed.get(str(role), now[role]), np.float32)
              for role in PLANES]
    output = np.full(planes[0].shape, np.nan, np.float32)
    REFLECTIONS.rows(0, output.shape[0], *planes, params_of(before, now), output)
    return output


def wanted(now: Frame, ball: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Exact motion of what pixels of the shiny surface reflect, and which ones were seen before as
    well."""
    places = pixel_positions(WIDTH, HEIGHT, now.jitter)
    found = scene.view(scene.clip(now.number, WIDTH, HEIGHT), places, WIDTH, HEIGHT, ball)
    then = scene.clip(now.number - 1, WIDTH, HEIGHT)
    if not ball:
        image = found.seen * (1, -1, 1)
        return project(image, then, WIDTH, HEIGHT) - places, np.isfinite(found.distance)
    # Newton: the place before at which the same spot of the wall was reflected
    at = places + now[Role.MOTION]
    for _ in range(12):
        off = [scene.view(then, at + shift, WIDTH, HEIGHT, True).seen[..., :2]
               for shift in ((0, 0), (1e-4, 0), (0, 1e-4))]
        slope = np.stack([(off[1] - off[0]) / 1e-4, (off[2] - off[0]) / 1e-4], -1)
        with np.errstate(all="ignore"):
            good = np.isfinite(slope).all((-1, -2)) & (np.abs(np.linalg.det(np.nan_to_num(slope)))
                                                       > 1e-9)
            step = np.linalg.solve(np.where(good[..., None, None], slope, np.eye(2)),
                                   (found.seen[..., :2] - off[0])[..., None])[..., 0]
        at = np.where(good[..., None], at + np.clip(np.nan_to_num(step), -1, 1), np.nan)
    found_then = scene.view(then, at, WIDTH, HEIGHT, True)
    known = np.nan_to_num(np.abs(found_then.seen - found.seen).max(-1), nan=1) < 1e-6
    return at - places, known & (found.normals[..., 2] < -0.5)


def test_a_floor_shows_its_image_where_geometry_has_it() -> None:
    before, now = scene.frame(3), scene.frame(4)
    truth, seen = wanted(now)
    found = reflected(before, now, roughness=np.zeros((HEIGHT, WIDTH, 1)))
    surface = now[Role.MOTION]
    inner = seen & np.roll(seen, 1, 0) & np.roll(seen, -1, 0)
    assert inner.sum() > 1000
    assert np.abs(surface - truth)[inner].max() > 1
    # of the mean of 3x3 hit distances, at the edge of the picture
    off = np.abs(found - truth)[inner].max(-1)
    assert off.max() < 0.06 and np.median(off) < 0.003
    np.testing.assert_array_equal(found[~seen], surface[~seen])


BENDS = """
#include "denoise/reflections.h"
#include "rows.h"

typedef View<const float, 3> Picture;

static void bends_rows(Long first, Long last, Picture normal, Picture depth, Given<Camera> camera,
                       View<float, 2> bends) {
    const int height = int(bends.size[0]), width = int(bends.size[1]);
    const Surfaces<Picture> surfaces = {depth, normal, depth, *camera, height, width};
    for (Long y = first; y < last; y++) {
        for (int x = 0; x < width; x++) bends(y)[x] = surfaces.curvature(int(y), x);
    }
}
EXPORT(bends, bends_rows)
"""
"""A kernel of one function of the header, which no kernel of ours writes as it is."""


def curvature(normal: np.ndarray, depth: np.ndarray, camera: np.ndarray,
              folder: Path) -> np.ndarray:
    """How much a surface bends outwards at each pixel."""
    header, found = folder / "bends.h", np.empty(depth.shape[:2], np.float32)
    header.write_text(BENDS)
    planes = [np.ascontiguousarray(plane, np.float32) for plane in (normal, depth)]
    Rows("bends", header)(0, found.shape[0], *planes, camera, found)
    return found


@pytest.mark.skipif(find_spec("ziglang") is None, reason="needs ziglang")
@pytest.mark.parametrize(("size", "share"),
                         [((5, 7), 1), ((2, 2), 1), ((1, 7), 0.5), ((5, 1), 0.5), ((1, 1), 0)])
def test_a_ball_bends_by_one_over_its_radius(size: tuple[int, int], share: float,
                                             tmp_path: Path) -> None:
    """At the edges of the picture, too; an axis of one pixel adds nothing to the mean. From inside
    it is hollow."""
    radius = 2.0
    middle = np.array([0.1, -0.05, 4.0])
    turn = np.linalg.qr(np.arange(9.0).reshape(3, 3) % 5 + 1)[0]
    camera = np.float32([50, 50, 50, 50, 0.1, -0.2, *12 * [0], *turn.ravel()])
    y, x = np.mgrid[:size[0], :size[1]] + 0.5
    rays = np.stack([(x + 0.1 - size[1] / 2) / 50, (y - 0.2 - size[0] / 2) / 50, np.ones(size)], -1)
    along = rays @ middle / (rays**2).sum(-1)
    reach = np.sqrt(along**2 - (middle @ middle - radius**2) / (rays**2).sum(-1))
    for side, wanted in ((-1, share / radius), (1, 0)):
        depth = (along + side * reach)[..., None]
        normal = -side * (rays * depth - middle) / radius @ turn.T
        np.testing.assert_allclose(curvature(normal, depth, camera, tmp_path), wanted, rtol=1e-3,
                                   atol=1e-6)
    if max(size) > 2:
        depth[size[0] // 2, size[1] // 2] *= 1.2
        assert curvature(normal, depth, camera, tmp_path)[size[0] // 2, size[1] // 2] == -1


@pytest.mark.parametrize("convention", scene.TURNS)
def test_every_kind_of_camera_is_understood(convention: str) -> None:
    frames = [scene.frame(number, convention=convention) for number in (3, 4)]
    usual = [scene.frame(number) for number in (3, 4)]
    np.testing.assert_allclose(reflected(*frames), reflected(*usual), atol=1e-3)


def test_a_ball_shows_a_smaller_image_that_is_nearer() -> None:
    before, now = scene.frame(3, ball=True), scene.frame(4, ball=True)
    truth, seen = wanted(now, ball=True)
    off = {"bent": reflected(before, now), "surface": now[Role.MOTION],
           "flat": reflected(before, now,
                             normal=np.broadcast_to(np.float32([0, 0, -1]), (HEIGHT, WIDTH, 3)))}
    error = {name: np.median(np.linalg.norm(motion - truth, axis=-1)[seen])
             for name, motion in off.items()}
    assert seen.sum() > 200
    assert error["bent"] < 0.6 * error["surface"] and error["bent"] < 0.15 * error["flat"], error


def test_what_is_infinitely_far_moves_by_the_turn_alone() -> None:
    before, now = scene.frame(3), scene.frame(4)
    for far in (np.inf, 1e10):
        distance = np.where(now[Role.SPECULAR_HIT_DISTANCE] > 0, np.float32(far), 0)
        found, seen = reflected(before, now, specular_hit_distance=distance), distance[..., 0] > 0
        rays = scene.rays_at(scene.clip(4, WIDTH, HEIGHT),
                             pixel_positions(WIDTH, HEIGHT, now.jitter), WIDTH, HEIGHT)[1]
        truth = project(np.concatenate([rays, np.zeros((HEIGHT, WIDTH, 1))], -1),
                        scene.clip(3, WIDTH, HEIGHT), WIDTH,
                        HEIGHT) - pixel_positions(WIDTH, HEIGHT, now.jitter)
        inner = seen & np.roll(seen, 1, 0)
        assert np.abs(found - truth)[inner].max() < 0.01


@pytest.mark.parametrize("changes", [
    {Role.SPECULAR_HIT_DISTANCE: 0.0}, {Role.SPECULAR_HIT_DISTANCE: np.nan}, {Role.ROUGHNESS: 0.5},
    {Role.DIFFUSE_ALBEDO: 0.9}, {Role.SPECULAR_ALBEDO: 0.0}, {Role.DEPTH: 1e10},
    {Role.DEPTH: np.nan},
    {Role.NORMAL: 0.0}, {Role.NORMAL: np.nan}, {Role.ROUGHNESS: np.nan}], ids=str)
def test_everything_else_moves_as_it_did(changes: dict[Role, float]) -> None:
    """Mirrors whose planes are those of what they show have a hit distance of 0, for example."""
    before, now = scene.frame(3), scene.frame(4)
    changed = {str(role): np.full_like(now[role], value) for role, value in changes.items()}
    np.testing.assert_array_equal(reflected(before, now, **changed), now[Role.MOTION])


def test_what_moves_by_itself_moves_as_it_did() -> None:
    before, now = scene.frame(3), scene.frame(4)
    motion = now[Role.MOTION].copy()
    motion[:, : WIDTH // 2] += 1.5
    found = reflected(before, now, motion=motion)
    np.testing.assert_array_equal(found[:, : WIDTH // 2], motion[:, : WIDTH // 2])
    assert np.abs(found - motion)[:, WIDTH // 2:].max() > 1


@pytest.mark.parametrize("ball", [False, True])
def test_all_definitions_agree(ball: bool) -> None:
    before, now = scene.frame(3, ball=ball), scene.frame(4, ball=ball)
    wanted_motion = reflected(before, now)
    assert np.abs(wanted_motion - now[Role.MOTION]).max() > (0.1 if ball else 1)
    inputs = ({name: np.ascontiguousarray(now[role], np.float32)
               for name, role in zip(REFLECTIONS.reads, PLANES, strict=False)}
              | {"camera": params_of(before, now)})
    portable = Device("cpu", threads=2, compiled_kernels=False)
    from tests.kernels.denoise_cases import Case, run

    found = run(REFLECTIONS, portable, inputs, Case(HEIGHT, WIDTH, HEIGHT, WIDTH))["reflected"]
    np.testing.assert_allclose(found, wanted_motion, atol=2e-3)
    if host_cuda.COMPILER is not None:
        output = np.full_like(wanted_motion, np.nan)
        host_cuda.run(REFLECTIONS, inputs | {"reflected": output})
        np.testing.assert_allclose(output, wanted_motion, atol=2e-3)


def test_why_reflections_are_not_followed() -> None:
    before, now = scene.frame(3), scene.frame(4)
    assert params_of(before, replace(now, world_to_camera=None)) == NO_CAMERA
    assert params_of(replace(before, fov_x=None), now) == NO_CAMERA
    assert params_of(before, replace(now, world_to_camera=now.world_to_camera.T)) == NO_FIT
    assert params_of(before, replace(now, fov_x=25.0)) == NO_FIT
    assert params_of(now, now) is None
    assert Camera.of(resident(replace(now, world_to_camera=np.zeros((4, 4))))) is None


def psnr(found: np.ndarray, number: int) -> float:
    """Of the floor's pixels, dB, against the mean over each output pixel without noise."""
    size = 2 * WIDTH, 2 * HEIGHT
    offsets = (np.mgrid[0:3, 0:3].reshape(2, -1).T + 0.5) / 3 - 0.5
    views = [scene.view(scene.clip(number, *size), pixel_positions(*size, offset), *size)
             for offset in offsets]
    truth = np.mean([0.8 * scene.texture(np.nan_to_num(one.seen)) for one in views], 0)
    floor = np.all([np.isfinite(one.distance) for one in views], 0)
    return -10 * math.log10(np.mean((found - truth)[floor] ** 2))


@pytest.mark.parametrize("model", ["s", "m"])
def test_reflections_are_better_with_the_hit_distance(model: str, device: Device) -> None:
    frames = [scene.frame(number, noise=1.0) for number in range(9)]
    without = [replace(frame, planes={role: plane for role, plane in frame.planes.items()
                                      if role is not Role.SPECULAR_HIT_DISTANCE})
               for frame in frames]
    results = {}
    for name, some in (("with", frames), ("without", without)):
        pipeline = Pipeline([DenoiseUpscale(scale=2, model=model)], device, exposure=0.0,
                            cuts="none")
        results[name] = [psnr(pipeline(frame)[Role.COLOUR], frame.number) for frame in some]
    gain = np.subtract(results["with"], results["without"])
    assert gain[0] == 0 and gain[4:].mean() > 1, gain


def test_the_plan_and_the_report_tell(device: Device) -> None:
    frames = [replace(scene.frame(number), fov_x=None) for number in range(3)]
    pipeline = Pipeline([DenoiseUpscale(scale=2, model="s")], device, exposure=0.0)
    results = [pipeline(frame) for frame in frames]
    assert "specular_hit_distance; writes colour" in str(pipeline.plan).replace("roughness, ", "")
    assert "smooth reflections move by their hit distance" in str(pipeline.plan)
    assert ("motion of reflections for 2 frames in denoise_upscale", NO_CAMERA) in [
        (line.what, line.why) for line in pipeline.savings()]
    assert np.isfinite(results[-1][Role.COLOUR]).all()
    fewer = replace(frames[0], planes={role: plane for role, plane in frames[0].planes.items()
                                       if role != Role.NORMAL})
    plan = pipeline.explain(fewer.spec)
    assert (Role.SPECULAR_HIT_DISTANCE not in plan.planes and "move by their hit "
            "distance" not in str(plan))


def test_with_changing_sizes(device: Device) -> None:
    pipeline = Pipeline([DenoiseUpscale(size=(2 * WIDTH, 2 * HEIGHT), model="s")], device,
                        exposure=0.0)
    for number, (width, height) in enumerate(((96, 54), (80, 45), (96, 54))):
        assert np.isfinite(pipeline(scene.frame(number, width, height))[Role.COLOUR]).all()
    assert not any("reflections" in line.what for line in pipeline.savings())

"""The data factory at toy size: planes follow the conventions, and clips come out the same for the
same seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.training.llvm import require_mitsuba

mi = require_mitsuba()

from training.datagen.clip import (  # noqa: E402
    ClipOptions,
    Style,
    draw_spp,
    filter_table,
    guide_frame,
    make_clip,
    noisy_frame,
)
from training.datagen.clip_file import guide_depth, half_depth, load_clip, save_clip  # noqa: E402
from training.datagen.scenes import meshes  # noqa: E402
from training.datagen.scenes.build import BuiltScene, Description  # noqa: E402
from training.datagen.scenes.convert import RealScenes  # noqa: E402
from training.datagen.scenes.lights import Environments  # noqa: E402
from training.datagen.scenes.materials import Material  # noqa: E402
from training.datagen.scenes.motion import (  # noqa: E402
    Camera,
    bend_mesh,  # noqa: E402
    look_at,
    object_path,
    translation,
)
from training.datagen.scenes.procedural import FINE  # noqa: E402
from training.datagen.tracing import Tracer  # noqa: E402

SIZE = (48, 32)
EYE, TARGET = np.array([0.3, 1.2, 4.0]), np.array([0.0, 0.6, 0.0])
MOVE = np.array([0.1, 0.05, 0.0])


@pytest.fixture(scope="module")
def tracer() -> Tracer:
    return Tracer()


def camera(frame: float) -> Camera:
    return Camera(look_at(EYE + frame * np.array([0.1, 0.04, -0.06]), TARGET), 60.0)


def style(kind: str, spp: int, jitter: tuple[float, float] = (0.0, 0.0)) -> Style:
    return Style(kind, spp, np.tile(np.array(jitter, np.float32), (8, 1)))


@pytest.fixture(scope="module")
def built() -> BuiltScene:
    """A textured floor, a moving plastic box, a metal ball, a glass ball and a lamp under a dim
    sky."""
    d = Description("test")
    checks = (np.indices((8, 8)).sum(0) % 2)[..., None] * np.ones(3) * 0.6 + 0.2
    floor = d.material(Material("diffuse", checks.astype(np.float32)))
    plastic = d.material(Material("roughplastic", np.full((1, 1, 3), 0.5, np.float32), alpha=0.04))
    metal = d.material(Material("roughconductor", alpha=0.09))
    glass = d.material(Material("dielectric"))
    d.add(meshes.quad([-4, 0, 4], [8, 0, 0], [0, 0, -8]).scaled_uvs(0.1), floor)
    d.movers.append(object_path(np.array([-0.8, 0.5, 0.0]), MOVE, np.array([0.0, 1, 0]), 0.0))
    d.add(meshes.box([-0.4, -0.4, -0.4], [0.4, 0.4, 0.4]), plastic, 0)
    d.add(meshes.sphere(0.4).transform(meshes.translation(0.6, 0.4, 0)), metal)
    d.add(meshes.sphere(0.2).transform(meshes.translation(1.3, 0.2, 0.5)), glass)
    d.emit(meshes.quad([-0.5, 1.9, -0.5], [1, 0, 0], [0, 0, 1]), np.array([9.0, 9.0, 9.0]))
    d.environment = np.full((8, 16, 3), 0.3, np.float32)
    return BuiltScene(d)


def frame_of(tracer: Tracer, built: BuiltScene, kind: Style, frame: int) -> dict[str, np.ndarray]:
    built.move(frame, frame - 1)
    rng = np.random.default_rng(5)
    return noisy_frame(tracer, built, (camera(frame), camera(frame - 1)), SIZE, kind, frame, 1.0,
                       rng)


def pixel_centres() -> np.ndarray:
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    return np.stack([x, y], -1) + 0.5


def world_points(depth: np.ndarray, view: Camera, jitter: np.ndarray) -> np.ndarray:
    """World positions (H, W, 3) by the documented conventions: planar depth, x right, y down."""
    tangent, (height, width) = np.tan(np.radians(view.fov) / 2), depth.shape
    place = np.stack(np.mgrid[0:height, 0:width][::-1], -1) + 0.5 + jitter
    x = (1 - 2 * place[..., 0] / width) * tangent
    y = (1 - 2 * place[..., 1] / height) * tangent * height / width
    local = np.stack([x, y, np.ones_like(x)], -1) * depth[..., None]
    return local @ view.to_world[:3, :3].T + view.to_world[:3, 3]


def test_planar_depth_puts_the_floor_at_zero(tracer: Tracer, built: BuiltScene) -> None:
    jitter = np.array([0.25, -0.3], np.float32)
    planes = frame_of(tracer, built, style("realtime", 1, tuple(jitter)), 2)
    points = world_points(planes["depth"], camera(2), jitter)
    floor = (planes["roughness"] == 1) & (planes["normal"][..., 1] > 0.99) & (planes["depth"] < 1e9)
    assert floor.sum() > 300
    assert np.abs(points[floor][:, 1]).max() < 1e-4


def test_motion_is_previous_minus_current_and_follows_objects(tracer: Tracer,
                                                              built: BuiltScene) -> None:
    jitter = np.array([0.25, -0.3], np.float32)
    planes = frame_of(tracer, built, style("realtime", 1, tuple(jitter)), 2)
    points = world_points(planes["depth"], camera(2), jitter)
    box = (np.abs(planes["roughness"] - 0.2) < 1e-3)
    assert box.sum() > 30
    points[box] -= MOVE
    before = camera(1).project(points.reshape(-1, 3), *SIZE).reshape(*SIZE[::-1], 2)
    hit = planes["depth"] < 1e9
    error = planes["motion"] - (before - pixel_centres() - jitter)
    assert np.abs(error[hit]).max() < 1e-2
    assert np.abs(planes["motion"][box]).mean() > 0.5


def test_warping_the_previous_albedo_by_motion_gives_the_current_one(tracer: Tracer,
                                                                     built: BuiltScene) -> None:
    from scipy.ndimage import binary_erosion, map_coordinates

    offline = style("box", 16)
    previous, current = (frame_of(tracer, built, offline, frame) for frame in (2, 3))
    place = pixel_centres() + current["motion"] - 0.5
    before, now = (planes["diffuse_albedo"][..., 0] for planes in (previous, current))
    warped = map_coordinates(before, [place[..., 1], place[..., 0]], order=1, mode="nearest")
    floor = binary_erosion((current["normal"][..., 1] > 0.99) & (previous["normal"][..., 1] > 0.99),
                           iterations=2)
    assert floor.sum() > 200
    assert np.abs(warped - now)[floor].mean() < 0.3 * np.abs(before - now)[floor].mean()


def test_normals_face_the_viewer_and_misses_are_marked(tracer: Tracer, built: BuiltScene) -> None:
    planes = frame_of(tracer, built, style("realtime", 1), 0)
    hit = planes["depth"] < 1e9
    towards = (world_points(np.where(hit, planes["depth"], 1.0), camera(0), np.zeros(2))
               - camera(0).to_world[:3, 3])
    facing = (planes["normal"] * towards).sum(-1)
    assert facing[hit].max() < 1e-4
    assert np.allclose(np.linalg.norm(planes["normal"], axis=-1)[hit], 1, atol=1e-4)
    assert ((~hit).sum() > 20 and np.all(planes["normal"][~hit] == 0)
            and np.all(planes["depth"][~hit] == 1e10))
    assert np.all(planes["diffuse_albedo"][~hit] == 0) and np.all(planes["roughness"][~hit] == 1)


def test_reflectances_of_metal_plastic_glass(tracer: Tracer, built: BuiltScene) -> None:
    planes = frame_of(tracer, built, style("realtime", 1), 0)
    roughness, albedo, specular = (planes[n]
                                   for n in ("roughness", "diffuse_albedo", "specular_albedo"))
    metal, glass, plastic = (np.abs(roughness - r) < 1e-3 for r in (0.3, 0.0, 0.2))
    assert min(metal.sum(), glass.sum(), plastic.sum()) > 5
    assert albedo[metal].max() == 0 and specular[metal].min() > 0.4
    assert albedo[glass].max() == 0 and 0.03 < specular[glass].min() and specular[glass].max() <= 1
    assert np.allclose(albedo[plastic], 0.5, atol=1e-3) and 0.02 < specular[plastic].min()


def test_guides_lie_on_the_reference_grid(tracer: Tracer, built: BuiltScene) -> None:
    built.move(1, 0)
    cameras = (camera(1), camera(0))
    size = (2 * SIZE[0], 2 * SIZE[1])
    rng = np.random.default_rng(0)
    jitter = (0.25, -0.3)
    guides = guide_frame(tracer, built, cameras, size, style("realtime", 1, jitter), 1, rng)
    assert "motion" not in guides and guides["depth"].shape == (64, 96)
    depth = np.where(guides["depth"] < 1e9, guides["depth"], 1.0)
    floor = (guides["roughness"] == 1) & (guides["normal"][..., 1] > 0.99) & (guides["depth"] < 1e9)
    assert np.abs(world_points(depth, camera(1), np.array(jitter))[floor][:, 1]).max() < 1e-4
    spread = guide_frame(tracer, built, cameras, size, style("box", 4), 1, rng)
    noisy = noisy_frame(tracer, built, cameras, SIZE, style("box", 16), 1, 1.0, rng)
    for name in ("diffuse_albedo", "specular_albedo", "normal", "roughness"):
        small = spread[name].reshape(32, 2, 48, 2, -1).mean((1, 3)).reshape(noisy[name].shape)
        assert np.corrcoef(small.ravel(), noisy[name].ravel())[0, 1] > 0.97, name


def test_real_time_samples_share_their_planes(tracer: Tracer, built: BuiltScene) -> None:
    one, four = (frame_of(tracer, built, style("realtime", spp, (0.1, 0.2)), 2) for spp in (1, 4))
    for name in set(one) - {"colour"}:
        assert np.array_equal(one[name], four[name]), name


def mirrored_scene(virtual: bool) -> BuiltScene:
    """A moving box before a moving mirror, seen in the mirror only; or the same box where the
    mirror shows it."""
    d = Description("mirror")
    checks = (np.indices((4, 4)).sum(0) % 2)[..., None] * np.ones(3) * 0.6 + 0.2
    boxes = d.material(Material("diffuse", checks.astype(np.float32)))
    flip = np.diag([1.0, 1.0, -1.0, 1.0])
    here = object_path(np.array([0.1, 0.6, 7.5]), MOVE, np.array([0.3, 1, 0]), 0.2)
    glass = np.array([0, 0, 0.04])
    through = object_path(np.zeros(3), 2 * glass, np.array([0.0, 1, 0]), 0.0)
    d.movers += [lambda t: through(t) @ flip @ here(t) if virtual else here(t)]
    d.movers += [lambda t: translation(*(glass * (t - 3.5)))]
    d.add(meshes.box([-2, -1.5, -0.4], [2, 1.5, 0.4]), boxes, 0)
    if not virtual:
        d.add(meshes.quad([-9, -9, 0], [18, 0, 0], [0, 18, 0]), d.material(Material("conductor")),
              1)
    d.environment = np.full((8, 16, 3), 0.3, np.float32)
    return BuiltScene(d)


def test_planes_seen_in_a_mirror_are_those_of_its_image(tracer: Tracer) -> None:
    cameras, planes = (camera(2), camera(1)), []
    for virtual in (False, True):
        scene = mirrored_scene(virtual)
        scene.move(2, 1)
        rng = np.random.default_rng(0)
        planes.append(guided_planes(tracer, scene, cameras, rng))
    mirror, image = planes
    box = image["depth"] < 1e9
    assert box.sum() > 100 and np.mean((mirror["depth"] < 1e9) == box) > 0.99
    box &= mirror["depth"] < 1e9
    assert np.abs(mirror["depth"] - image["depth"])[box].max() < 1e-3
    assert np.abs(mirror["normal"] - image["normal"])[box].max() < 1e-3
    assert np.abs(mirror["motion"] - image["motion"])[box].max() < 1e-2
    assert np.abs(image["motion"][box]).mean() > 0.5
    ratio = mirror["diffuse_albedo"][box] / image["diffuse_albedo"][box]
    assert np.all((ratio > 0.3) & (ratio < 0.8)) and ratio.std(0).max() < 0.05
    assert np.abs(mirror["motion"] - image["motion"])[image["depth"] > 1e9].max() < 1e-2


def guided_planes(tracer: Tracer, scene: BuiltScene, cameras: tuple,
                  rng: np.random.Generator) -> dict:
    return noisy_frame(tracer, scene, cameras, SIZE, style("realtime", 1), 2, 1.0, rng, steps=3)


def test_stored_guide_depth_keeps_misses() -> None:
    depth = np.array([1e-6, 0.3, 25.0, 1e10], np.float32)
    assert np.allclose(guide_depth(half_depth(depth)), [1e-4, 0.3, 25.0, 1e10], rtol=6e-3)
    assert guide_depth(half_depth(depth))[3] == np.float32(1e10)


def test_noisy_and_reference_agree_on_average(tracer: Tracer, built: BuiltScene) -> None:
    noisy = frame_of(tracer, built, style("box", 64), 1)["colour"]
    reference = tracer.reference(built.scene, camera(1), (96, 64), filter_table("box"), 32, 9)
    small = reference.reshape(32, 2, 48, 2, 3).mean((1, 3))
    assert abs(noisy.mean() / small.mean() - 1) < 0.03
    assert np.corrcoef(noisy.ravel(), small.ravel())[0, 1] > 0.97


def test_blackman_harris_samples_have_the_filters_spread() -> None:
    offsets = style("blackman-harris", 256).offsets(0, 64, np.random.default_rng(0)) - 0.5
    assert np.abs(offsets).max() <= 0.75 and abs(offsets.mean()) < 0.01
    fine = np.linspace(0, 1, 100001)
    weight = 0.35875 - 0.48829 * np.cos(2 * np.pi * fine) + 0.14128 * np.cos(4 * np.pi * fine)
    weight -= 0.01168 * np.cos(6 * np.pi * fine)
    expected = np.sqrt((weight * (1.5 * (fine - 0.5)) ** 2).sum() / weight.sum())
    assert abs(offsets.std() - expected) < 0.005


def test_clips_may_go_on_from_another_view(tracer: Tracer) -> None:
    options = ClipOptions(16, 16, 4, 1, reference_spp=4, scales=(1.0,), scale_chances=(1.0,),
                          cut_share=1)
    clips = (make_clip(tracer, options, Environments(None), RealScenes(None), 3, index)
             for index in range(2))
    facts = next(facts for _, _, facts in clips if facts["reset"].sum() == 2)
    frame, poses = int(np.flatnonzero(facts["reset"])[1]), np.array(facts["meta"]["to_world"])
    steps = np.linalg.norm(np.diff(poses[:, :3].reshape(4, -1), axis=0), axis=1)
    assert facts["reset"][0] == 1 and steps[frame - 1] > 3 * np.delete(steps, frame - 1).max()


def test_motion_of_things_that_bend(tracer: Tracer) -> None:
    """A shear that grows with time, on top of a slide: every point's previous place is known."""
    d = Description("bend", bends=[lambda v, t: v + 0.05 * t * v[:, 1:2] * np.array([1.0, 0, 0.3])])
    d.movers.append(object_path(np.array([0, 0.6, 0]), MOVE, np.array([0.0, 1, 0]), 0.0))
    d.add(meshes.sphere(0.8), d.material(Material("diffuse")), 0, bend=0)
    scene = BuiltScene(d)
    planes = frame_of(tracer, scene, style("realtime", 1), 3)
    points, hit = world_points(planes["depth"], camera(3), np.zeros(2)), planes["depth"] < 1e9
    assert hit.sum() > 80
    local = points - d.movers[0](3)[:3, 3]
    before = local - 0.05 * local[..., 1:2] * np.array([1.0, 0, 0.3]) + d.movers[0](2)[:3, 3]
    place = camera(2).project(before.reshape(-1, 3), *SIZE).reshape(*SIZE[::-1], 2)
    error = (planes["motion"] - (place - pixel_centres()))[hit]
    rigid = camera(2).project((points - MOVE).reshape(-1, 3), *SIZE).reshape(*SIZE[::-1], 2)
    assert np.abs(error).max() < 2e-2 and np.abs(place - rigid)[hit].max() > 0.3


def test_normals_follow_what_bends() -> None:
    flat = meshes.quad([0, 0, 0], [1, 0, 0], [0, 1, 0])
    mesh = bend_mesh(flat, lambda v, t: v + v[:, 1:2] * np.array([0, 0, t]), 1.0)
    assert np.allclose(mesh.vertices[:, 2], mesh.vertices[:, 1])
    assert np.allclose(mesh.normals, np.array([0, -1, 1]) / np.sqrt(2), atol=1e-6)


def test_lights_follow_their_strength(tracer: Tracer) -> None:
    d = Description("glow", glows=[lambda frame: 0.25 * (1 + frame)])
    d.add(meshes.quad([-4, 0, 4], [8, 0, 0], [0, 0, -8]), d.material(Material("diffuse")))
    d.emit(meshes.quad([-0.5, 1.9, -0.5], [1, 0, 0], [0, 0, 1]), np.array([9.0, 9.0, 9.0]), glow=0)
    scene = BuiltScene(d)
    levels = [frame_of(tracer, scene, style("box", 16), frame)["colour"].mean() for frame in (0, 3)]
    assert abs(levels[1] / levels[0] - 4) < 0.4


def test_clip_is_complete_and_repeatable(tracer: Tracer, tmp_path: Path) -> None:
    options = ClipOptions(24, 16, frames=2, variants=2, reference_spp=4, scales=(1.5,),
                          scale_chances=(1.0,))
    maps, real = Environments(None), RealScenes(None)
    first = make_clip(tracer, options, maps, real, seed=3, index=1)
    again = make_clip(tracer, options, maps, real, seed=3, index=1)
    assert np.array_equal(first[1][0]["depth"], again[1][0]["depth"])
    assert np.allclose(first[0], again[0], rtol=1e-3, atol=1e-5)
    save_clip(tmp_path / "clip.00001.npz", *first)
    clip = load_clip(tmp_path / "clip.00001.npz")
    assert clip["reference"].shape == (2, 24, 36, 3) and clip["reference"].dtype == np.float16
    assert (clip["variants"] == 2 and clip["v1_motion"].shape == (2, 16, 24, 2)
            and clip["v1_depth"].dtype == np.float32)
    assert clip["guide_normal"].shape == (2, 24, 36, 3) and clip["guide_depth"].shape == (2, 24, 36)
    assert all(clip[f"guide_{name}"].dtype == np.float16
               for name in ("diffuse_albedo", "roughness", "depth"))
    assert clip["guide_jitter"].shape == (2, 2) and clip["guide_jitter"].dtype == np.float32
    assert clip["reset"].dtype == np.uint8 and clip["reset"][0] == 1
    assert (clip["v0_jitter"].shape == (2, 2) and clip["scale"] == 1.5
            and clip["scene"] == first[2]["scene"])
    assert all(np.isfinite(value).all() for value in clip.values() if isinstance(value, np.ndarray))
    assert [p.name for p in tmp_path.iterdir()] == ["clip.00001.npz"]


@pytest.mark.parametrize("kind", sorted(FINE))
def test_scenes_of_detail_finer_than_a_pixel(tracer: Tracer, kind: str) -> None:
    """Albedo of a few samples differs from that of many, as pixels show several surfaces."""
    options = ClipOptions(32, 32, frames=2, variants=2, reference_spp=8, families=(kind,),
                          scales=(1.0,), scale_chances=(1.0,))
    reference, variants, facts = make_clip(tracer, options, Environments(None), RealScenes(None), 5,
                                           0)
    few, many = (variant["diffuse_albedo"].astype(float) for variant in variants)
    assert np.isfinite(reference).all() and facts["scene"] == kind and variants[1]["spp"] == 64
    assert (np.abs(few - many).max(-1) > 0.05).mean() > 0.02


def test_samples_a_pixel_are_drawn_evenly_in_stops() -> None:
    rng = np.random.default_rng(3)
    stops = np.log2([draw_spp(rng, 256) for _ in range(4000)])
    assert stops.min() == 0 and stops.max() == 8
    assert np.mean(stops > 4) == pytest.approx(0.5, abs=0.03)
    few = np.array([draw_spp(rng) for _ in range(4000)])
    assert np.mean(few <= 8) == pytest.approx(0.75, abs=0.03) and few.max() == 256

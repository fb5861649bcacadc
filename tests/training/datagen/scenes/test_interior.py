"""Procedural interiors: things are well made, rooms are closed, lit by their windows, and the same
for a seed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.training.llvm import require_mitsuba

mi = require_mitsuba()

from training.datagen.scenes import (  # noqa: E402
    clutter,
    fittings,
    fixtures,
    foliage,
    furnishing,
    movables,
    solids,
)
from training.datagen.scenes.build import BuiltScene, Description  # noqa: E402
from training.datagen.scenes.draft import Draft  # noqa: E402
from training.datagen.scenes.interior import (  # noqa: E402
    CHANCES,
    interior,
    outside_only,
)
from training.datagen.scenes.lights import Environments, sky  # noqa: E402
from training.datagen.scenes.materials import Material  # noqa: E402
from training.datagen.scenes.meshes import Mesh  # noqa: E402
from training.datagen.scenes.motion import (  # noqa: E402
    Camera,
    hanging,  # noqa: E402
    look_at,
)
from training.datagen.scenes.procedural import FAMILIES, draft  # noqa: E402
from training.datagen.tracing import MISS_DEPTH, Film, Tracer  # noqa: E402

MAKERS = {
    maker.__name__: maker for maker in (
        movables.sofa, movables.bed, movables.stool, movables.rug, fittings.bookcase,
        fittings.sideboard, fittings.wardrobe, fittings.kitchen, fittings.desk, fittings.towel_rail,
        fixtures.fireplace, fixtures.radiator, fixtures.bath, fixtures.basin, fixtures.toilet,
        fixtures.rack, fixtures.boxes_pile, movables.coffee, movables.dining, movables.pendant,
        *foliage.PLANTS, foliage.trailing, *clutter.SMALL, clutter.screen)}


def drafted(seed: int) -> Draft:
    return interior(np.random.default_rng([5, seed]), Environments(None))


@pytest.fixture(scope="module")
def rooms() -> list[Draft]:
    return [drafted(seed) for seed in range(16)]


def inside_out(mesh: Mesh) -> float:
    """Part of a mesh's triangles whose winding disagrees with their normals."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    along = (cross * mesh.normals[mesh.faces].mean(1)).sum(1)
    return float((along[area > 1e-12] < -1e-3 * area[area > 1e-12]).mean())


@pytest.mark.parametrize("name", sorted(MAKERS))
def test_things_stand_on_the_floor_with_normals_outwards(name: str) -> None:
    for seed in range(3):
        thing = MAKERS[name](np.random.default_rng(seed))
        for mesh, _ in thing:
            assert all(np.isfinite(values).all()
                       for values in (mesh.vertices, mesh.normals, mesh.uvs))
            assert np.abs(np.linalg.norm(mesh.normals, axis=1) - 1).max() < 1e-3
            assert inside_out(mesh) < 0.01
        low = min(mesh.vertices[:, 1].min() for mesh, _ in thing)
        assert name in ("pendant", "towel_rail") or -0.02 < low < 0.05, low


def volume(mesh: Mesh) -> float:
    """Enclosed volume, positive when the winding looks outwards (divergence theorem)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def test_solids_look_outwards() -> None:
    low, high = np.array([1.0, 2, 3]), np.array([1.5, 2.4, 3.9])
    assert np.isclose(volume(solids.boxes([low, low + 5], [high, high + 5])),
                      2 * np.prod(high - low))
    round_box = volume(solids.rounded_box(low, high, 0.05, 6))
    assert 0.93 * np.prod(high - low) < round_box < np.prod(high - low)
    assert (volume(solids.rounded_box([0, 0, 0], [2, 2, 2], 0.999, 24))
            == pytest.approx(4 / 3 * np.pi, rel=0.03))


def test_mouldings_are_mitred() -> None:
    """A square section along a rectangle: its volume is that of the ring, and it lies within its
    bounds."""
    ring = solids.moulding(solids.rectangle(0, 0, 2, 1), [[0, 0], [0, 0.1], [0.2, 0.1], [0.2, 0]],
                           closed=True)
    # the open underside lies in the plane z = 0 and adds nothing
    assert volume(ring) == pytest.approx((2 * 1 - 1.6 * 0.6) * 0.1, rel=1e-6)
    assert np.allclose(ring.vertices.min(0), 0) and np.allclose(ring.vertices.max(0), [2, 1, 0.1])
    assert inside_out(ring) == 0


def test_the_same_seed_gives_the_same_room() -> None:
    first, again, other = drafted(3), drafted(3), drafted(4)
    assert len(first.description.parts) == len(again.description.parts)
    for a, b in zip(first.description.parts, again.description.parts, strict=True):
        assert np.array_equal(a.mesh.vertices, b.mesh.vertices) and a.material == b.material
    assert all(np.array_equal(a.albedo, b.albedo)
               for a, b in zip(first.description.materials, again.description.materials,
                               strict=True))
    assert len(first.description.parts) != len(other.description.parts)
    eyes = [room.view(np.random.default_rng(1)) for room in (first, again)]
    assert np.array_equal(eyes[0], eyes[1])


def test_rooms_are_of_a_size_that_can_be_traced(rooms: list[Draft]) -> None:
    triangles = [sum(len(part.mesh.faces) for part in room.description.parts) for room in rooms]
    assert max(triangles) < 500_000 and np.median(triangles) > 20_000
    for room in rooms:
        d = room.description
        groups = {(p.material, p.mover, p.bend, p.glow) for p in d.parts}
        assert len(d.materials) < 90 and len(groups) < 90  # `anchors` holds tables of 96


def test_rooms_are_lit_by_windows_and_some_things_move(rooms: list[Draft]) -> None:
    lit = [any(p.emission is not None for p in room.description.parts) for room in rooms]
    sky_lit = [room.description.environment is not None for room in rooms]
    assert all(a or b for a, b in zip(lit, sky_lit, strict=True)) and 3 < sum(sky_lit) < 13
    assert sum(bool(room.description.movers or room.description.bends) for room in rooms) >= 4


def test_rooms_are_closed_but_for_their_windows(rooms: list[Draft]) -> None:
    """Camera rays that leave a room go through windows: hardly any go down or miss in rooms with a
    sheet outside."""
    tracer = Tracer()
    rng = np.random.default_rng(0)
    for room in [room for room in rooms if room.description.environment is None][:3]:
        scene = BuiltScene(room.description)
        eye, _ = room.view(rng)
        u, v = (g.ravel().astype(np.float32)
                for g in np.meshgrid(*2 * [(np.arange(32) + 0.5) / 32]))
        for turn in np.arange(4) * np.pi / 2:
            camera = Camera(look_at(eye, eye + [np.cos(turn), 0.01, np.sin(turn)]), 90.0)
            planes = tracer.planes(scene, camera, camera, (32, 32), Film(mi.Float(u), mi.Float(v)))
            assert (planes["depth"] < MISS_DEPTH / 2).mean() > 0.99
            assert all(np.isfinite(values).all() for values in planes.values())


def test_things_do_not_stand_in_one_another() -> None:
    from training.datagen.scenes.joinery import Joinery
    from training.datagen.scenes.roles import Roles
    from training.datagen.scenes.shell import House, Side, frames
    d, rng = Description("test"), np.random.default_rng(2)
    house = House(d, rng, Roles(d, rng), Joinery.draw(rng), (5.0, 2.6, 5.0))
    house.sides = [Side(matrix, width, 2.6, []) for matrix, width in frames(5.0, 5.0)]
    furnishing.furnish(house,
                       furnishing.Kind((movables.sofa,) * 5, (movables.dining, movables.stool)))
    assert len(house.taken) >= 3
    for k, (x0, x1, z0, z1, _) in enumerate(house.taken):
        assert min(x0, z0) > -2.501 and max(x1, z1) < 2.501
        assert not any(x0 < b and x1 > a and z0 < e and z1 > c
                       for a, b, c, e, _ in house.taken[k + 1:])


def test_light_from_where_no_window_looks_is_left_out_only() -> None:
    """A wall that sees only the outward half of the sky is lit by the cut sky as by the whole."""
    d = Description("test")
    white = d.material(Material("diffuse", np.full((1, 1, 3), 0.8, np.float32)))
    d.add(solids.face(-9, -9, 9, 9), white)
    image, outward = sky(np.random.default_rng(3)), np.array([[0.0, 0.0, 1.0]])
    cut = outside_only(image, 130.0, outward)
    assert 0.4 < (cut.max(-1) == 0).mean() < 0.5
    levels = []
    for environment in (image, cut):
        d.environment, d.environment_turn = environment, 130.0
        camera = Camera(look_at(np.array([0.3, 0.2, 3.0]), np.zeros(3)), 40.0)
        u = mi.Float(np.random.default_rng(0).random(1 << 15, np.float32))
        levels.append(np.mean(Tracer().radiance(BuiltScene(d).scene, camera, 1.0, Film(u, u), 1)
                              .numpy()))
    assert levels[1] == pytest.approx(levels[0], rel=0.03)


def test_curtains_hang_from_a_fixed_rail() -> None:
    bend = hanging(np.random.default_rng(1), 2.2, 2.0, np.array([0.0, 0, 1]))
    points = np.array([[0.3, 2.2, 0.1], [0.3, 0.2, 0.1]])
    moved = bend(points, 3.0) - bend(points, 2.0)
    assert np.allclose(bend(points, 3.0)[0], points[0]) and np.abs(moved[1]).max() > 1e-4


def test_a_good_part_of_the_drawn_scenes_are_interiors() -> None:
    assert (sum(CHANCES.values()) == pytest.approx(1)
            and sum(share for _, share in FAMILIES) == pytest.approx(1))
    assert dict(FAMILIES)[interior] >= 0.35
    rng = np.random.default_rng(0)
    assert {draft(rng, Environments(None)).description.name for _ in range(10)} >= {"interior",
                                                                                    "room"}

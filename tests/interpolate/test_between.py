"""Frames between frames, of a scene whose picture is known at any time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx import Between, Interpolator
from postfx.errors import FrameError
from postfx.frame import Frame, PartSource, Role
from postfx.interpolate import paths
from postfx.interpolate.overlays import find_overlay
from tests.interpolate.conftest import DISC, HEIGHT, RADIUS, SIZE, WIDTH, picture

INNER = np.s_[8:-8, 8:-8]
"""What neither motion carries out of the picture."""


def from_disc(t: float) -> np.ndarray:
    """Distance (h, w) from the disc's middle."""
    y, x = np.indices(SIZE)
    return np.hypot(x - 40 - DISC[0] * t, y - 34 - DISC[1] * t)


def error(colour: np.ndarray, t: float, where: np.ndarray | tuple[slice, ...] = INNER) -> float:
    """Mean difference in stops to the true picture, without the disc's edge, which planes have in
    whole pixels."""
    counted = np.zeros(SIZE, bool)
    counted[where] = True
    counted &= np.abs(from_disc(t) - RADIUS) > 1.5
    wanted, _ = picture(t)
    return float(np.abs(np.log2(colour[counted] + 1e-3) - np.log2(wanted[counted] + 1e-3)).mean())


def faded(scene, t: float) -> np.ndarray:
    """What a linear blend makes of the two frames."""
    return scene(0)[Role.COLOUR] * (1 - t) + scene(1)[Role.COLOUR] * t


@pytest.mark.parametrize("t", [0.25, 0.5, 0.8])
def test_both_layers_are_where_they_are_at_the_time(scene, t):
    found = Between(scene(0), scene(1)).frame(t)
    assert error(found[Role.COLOUR], t) < 0.15 * error(faded(scene, t), t)
    _, there = picture(t)
    edge = np.abs(from_disc(t) - RADIUS) < 1.5
    assert ((found[Role.DEPTH][..., 0] == 2) == there)[~edge].all(), "depth follows"
    surface = there[INNER] & ~edge[INNER]
    np.testing.assert_allclose(found[Role.MOTION][INNER][surface], np.broadcast_to(
        np.float32(DISC) * -np.float32(t), (surface.sum(), 2)), atol=0.05,
                               err_msg="motion leads to the frame before")


def test_uncovered_background_is_that_of_the_frame_that_shows_it(scene):
    """Left of the disc the frame after shows the wall, right of it the frame before does."""
    found = Between(scene(0), scene(1), flow=False).frame(0.5)[Role.COLOUR]
    hidden = (picture(0)[1] ^ picture(1)[1]) & (from_disc(0.5) > RADIUS + 1.5)
    assert hidden.sum() > 50
    assert error(found, 0.5, hidden) < 0.15 * error(faded(scene, 0.5), 0.5, hidden)


def test_light_is_kept(scene):
    """Against the true picture's: the disc, 20 times as bright as the wall, is neither larger nor
    smaller."""
    found, (wanted, _) = Between(scene(0), scene(1)).frame(0.5)[Role.COLOUR], picture(0.5)
    assert found[INNER].mean() == pytest.approx(wanted[INNER].mean(), rel=5e-3)


def test_the_ends_are_the_frames_themselves(scene):
    between = Between(scene(0), scene(1))
    for t, frame in ((0, scene(0)), (1, scene(1))):
        np.testing.assert_array_equal(between.frame(t)[Role.COLOUR], frame[Role.COLOUR])


@pytest.mark.parametrize("value", [np.nan, 1e6, -1e6, np.inf])
def test_bad_vectors_are_harmless(scene, value):
    after = scene(1)
    after[Role.MOTION][20:30, 60:80] = value
    after[Role.MOTION][:, -1] = value
    found = Between(scene(0), after).frame(0.5)
    assert np.isfinite(found[Role.COLOUR]).all() and np.isfinite(found[Role.DEPTH]).all()
    assert error(found[Role.COLOUR], 0.5) < 0.4 * error(faded(scene, 0.5), 0.5)


def test_pixels_that_are_not_finite_do_not_get_through(scene):
    before, after = scene(0), scene(1)
    before[Role.COLOUR][10, 20] = np.nan
    after[Role.COLOUR][40, 50] = np.inf
    after[Role.DEPTH][30] = np.nan
    assert np.isfinite(Between(before, after).frame(0.5)[Role.COLOUR]).all()


@pytest.mark.parametrize(("roles", "most"), [((Role.COLOUR, Role.MOTION), 0.25),
                                             ((Role.COLOUR, Role.DEPTH), 0.6),
                                             ((Role.COLOUR,), 0.6)])
def test_without_depth_or_motion_pictures_tell_what_they_can(scene, roles, most):
    found = Between(scene(0, roles=roles), scene(1, roles=roles)).frame(0.5)[Role.COLOUR]
    assert error(found, 0.5) < most * error(faded(scene, 0.5), 0.5)


def turning(t: float, degrees: float = 24.0) -> Frame:
    """Spots on a wheel that turns about the middle of the picture, with motion from the frame
    before."""
    y, x = np.indices((96, 96)) - 47.5
    angle, before = np.radians(degrees * t), np.radians(-degrees)
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    colour = np.repeat(np.exp(2 * np.sin(u * 0.4) * np.sin(v * 0.4))[..., None], 3, -1)
    along, across = np.cos(before) - 1, np.sin(before)
    motion = np.stack([x * along - y * across, x * across + y * along], -1)
    planes = {Role.COLOUR: colour, Role.MOTION: motion, Role.DEPTH: np.ones((96, 96, 1))}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(t) + 1)


def test_what_turns_goes_round_and_not_along_the_chord():
    rim = np.hypot(*(np.indices((96, 96)) - 47.5)) < 44
    rim &= np.hypot(*(np.indices((96, 96)) - 47.5)) > 24
    wanted, errors = turning(0.5)[Role.COLOUR], {}
    for name, before in (("bent", turning(0)), ("straight", replace(turning(0), reset=True))):
        found = Between(before, turning(1), flow=False).frame(0.5)[Role.COLOUR]
        errors[name] = np.abs(np.log2(found) - np.log2(wanted))[rim].mean()
    assert errors["bent"] < 0.3 * errors["straight"]


def test_what_turns_fast_goes_round_if_a_frame_beside_tells_so():
    rim = np.hypot(*(np.indices((96, 96)) - 47.5)) < 44
    wanted, errors, fast = turning(0.5, 48)[Role.COLOUR], {}, [turning(t, 48) for t in (0, 1, 2)]
    first = replace(fast[0], reset=True)
    for name, before, later in (("straight", first, None), ("both", fast[0], fast[2]),
                                ("came", fast[0], None), ("goes", first, fast[2])):
        found = Between(before, fast[1], later, flow=False).frame(0.5)[Role.COLOUR]
        errors[name] = np.abs(np.log2(found) - np.log2(wanted))[rim].mean()
    assert max(errors["both"], errors["came"], errors["goes"]) < 0.2 * errors["straight"]


def mirrored(t: float, hit: bool = True) -> Frame:
    """A floor seen by a camera that moves sideways, and a mirror in it that shows what is as far
    behind it."""
    y, x = np.indices((96, 128), np.float64)
    depth = 2 + 6 * y / 96
    is_mirror = (np.abs(x - 64) < 30) & (np.abs(y - 48) < 24)
    depth[is_mirror], length = 3, np.where(is_mirror, 5.0, 0)
    shift = 30 / np.where(is_mirror, 8, depth)  # pixels a frame of what is seen
    colour = np.repeat(np.exp(np.sin(0.5 * (x + shift * t)) * np.sin(0.4 * y))[..., None], 3, -1)
    motion = np.stack([30 / depth, 0 * y], -1)
    planes = {Role.COLOUR: colour, Role.MOTION: motion, Role.DEPTH: depth[..., None],
              Role.SPECULAR_HIT_DISTANCE: length[..., None] * hit}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(t) + 1)


def test_a_mirror_shows_what_moves_behind_it():
    inside, wanted, errors = np.s_[32:64, 48:80], mirrored(0.5)[Role.COLOUR], {}
    for hit in (False, True):
        found = Between(mirrored(0, hit), mirrored(1, hit), flow=False).frame(0.5)[Role.COLOUR]
        errors[hit] = np.abs(np.log2(found) - np.log2(wanted))[inside].mean()
    assert errors[True] < 0.2 * errors[False]


def test_noise_is_averaged_and_detail_is_kept():
    """Two noisy frames of stripes: the one between is nearer to the stripes without noise than
    their mean is."""
    rng, x = np.random.default_rng(5), np.indices((96, 128))[1]
    clean = np.repeat(np.where(x < 64, 1.0, 1 + 0.8 * np.sin(1.2 * x))[..., None], 3, -1)
    still, depth = np.zeros((96, 128, 2), np.float32), np.ones((96, 128, 1), np.float32)
    frames = [Frame({Role.COLOUR: np.float32(clean * rng.gamma(25, 1 / 25, clean.shape)),
                     Role.MOTION: still, Role.DEPTH: depth}, number=number) for number in (1, 2)]
    found = Between(*frames).frame(0.5)[Role.COLOUR]
    mean = (frames[0][Role.COLOUR] + frames[1][Role.COLOUR]) / 2
    flat, striped = np.s_[8:-8, 8:56], np.s_[8:-8, 72:-8]
    assert (found - clean)[flat].std() < 0.61 * (mean - clean)[flat].std()
    assert (found - clean)[striped].std() <= (mean - clean)[striped].std()


@pytest.mark.parametrize("t", [0.3, 0.8])
def test_a_spark_without_vectors_is_shown_once(t):
    frames = []
    for number, x in ((1, 30), (2, 50)):
        colour = np.ones((64, 96, 3), np.float32)
        colour[30:33, x:x + 3] = 500
        frames.append(Frame({Role.COLOUR: colour, Role.MOTION: np.zeros((64, 96, 2), np.float32),
                             Role.DEPTH: np.ones((64, 96, 1), np.float32)}, number=number))
    found = Between(*frames, flow=False).frame(t)[Role.COLOUR]
    np.testing.assert_array_equal(found, frames[round(t)][Role.COLOUR], "as in the nearer frame")


def barred(t: float) -> Frame:
    """Two thin bars that look alike move by 32 pixels a frame, the wall behind them by 16."""
    y, x = np.indices((96, 160), np.float64)
    is_bar = (np.abs(x - 40 - 32 * t) < 2) | (np.abs(x - 76 - 32 * t) < 2)
    colour = np.where(is_bar, 0.05, 1 + 0.3 * np.sin(0.3 * (x - 16 * t)) * np.sin(0.3 * y))
    motion = np.stack([np.where(is_bar, -32, -16), 0 * y], -1)
    planes = {Role.COLOUR: colour[..., None].repeat(3, -1), Role.MOTION: motion,
              Role.DEPTH: np.where(is_bar, 2, 8)[..., None]}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(t) + 1)


@pytest.mark.parametrize("flow", [True, False])
def test_thin_things_are_where_they_are_and_nowhere_else(flow):
    """The wall behind them fits better around them, and one in the frame before to the other in the
    frame after."""
    found = Between(barred(0), barred(1), flow=flow).frame(0.5)[Role.COLOUR][8:-8, :, 0]
    dark = np.nonzero((found < 0.5).mean(0) > 0.5)[0]
    assert {56, 92} <= set(dark) <= {54, 55, 56, 57, 58, 90, 91, 92, 93, 94}


@pytest.mark.parametrize("size", [(1, 64), (64, 1), (1, 1), (2, 3)])
def test_pictures_of_one_row_or_column_have_frames_between(size):
    """Where vectors tell nothing, cells are compared with those beside them, of which there are
    none: `interpolate` ended with a traceback."""
    random = np.random.default_rng(1)
    frames = [Frame({Role.COLOUR: random.random((*size, 3), np.float32),
                     Role.MOTION: np.zeros((*size, 2), np.float32) + np.float32(
                         (3 * (size[1] > 1), 3 * (size[0] > 1)))}, number=t + 1)
              for t in range(2)]
    found = Between(*frames).frame(0.5)[Role.COLOUR]
    assert found.shape == (*size, 3) and np.isfinite(found).all()


def lit(t: float, spark: bool = False) -> Frame:
    """A wall that stands still, over which light swings."""
    y, x = np.indices((64, 96), np.float64)
    colour = (1.5 + 0.5 * np.sin(0.3 * x)) * (1.5 + np.sin(0.9 * t + 0.05 * y))
    colour[30:33, 40:43] *= 500 if spark else 1
    planes = {Role.COLOUR: colour[..., None].repeat(3, -1), Role.MOTION: np.zeros((64, 96, 2)),
              Role.DEPTH: np.full((64, 96, 1), 5)}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(t) + 2)


def test_what_was_gathered_of_a_frame_serves_the_next_pair(monkeypatch):
    """And is let go with the frame."""
    frames, gathered, gather = [lit(t) for t in range(3)], [], paths.gather_cells
    monkeypatch.setattr("postfx.interpolate.pair_motion.gather_cells",
                        lambda motion, *more: gathered.append(motion) or gather(motion, *more))
    first = Between(*frames[:2])
    first.frame(0.5)
    once = len(gathered)
    second = Between(*frames[1:], last=first)
    second.frame(0.5)
    assert once == 2 and len(gathered) == 3 and all(frame is not frames[0]
                                                    for frame, _ in second._motion._gathered)


def test_light_goes_on_through_four_frames_where_nothing_moves():
    """Within what the middle two show, and not by what flashed up beside them."""
    frames = [lit(t) for t in range(-1, 3)]
    wanted = lit(0.25)[Role.COLOUR]
    alone = Between(*frames[1:3]).frame(0.25)[Role.COLOUR]
    found = Between(*frames[1:], last=Between(*frames[:2])).frame(0.25)[Role.COLOUR]
    held = wanted.clip(np.minimum(*(frame[Role.COLOUR] for frame in frames[1:3])),
                       np.maximum(*(frame[Role.COLOUR] for frame in frames[1:3])))
    assert np.abs(found - held).mean() < 0.25 * np.abs(alone - held).mean()
    flashed = Between(*frames[1:], last=Between(lit(-1, True), frames[1])).frame(0.25)[Role.COLOUR]
    np.testing.assert_array_equal(flashed[30:33, 40:43], alone[30:33, 40:43])


def rolled(t: float) -> Frame:
    """A disc that planes do not know moves by 18 pixels a frame before a wall that stands still."""
    y, x = np.indices((96, 160), np.float64)
    u, v = x - 50 - 18 * t, y - 48
    colour = np.where(np.hypot(u, v) < 10, 4 + 2 * np.sin(0.7 * u) * np.cos(0.6 * v),
                      1 + 0.3 * np.sin(0.5 * x + 2 * np.sin(0.11 * x)) * np.sin(0.4 * y))
    planes = {Role.COLOUR: colour[..., None].repeat(3, -1), Role.MOTION: np.zeros((96, 160, 2)),
              Role.DEPTH: np.full((96, 160, 1), 5)}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(t) + 1)


def test_what_planes_do_not_know_is_shown_where_its_flow_is_at_the_time():
    wanted = rolled(0.5)[Role.COLOUR]
    errors = [np.abs(Between(rolled(0), rolled(1), flow=flow).frame(0.5)[Role.COLOUR] - wanted)
              .mean() for flow in (True, False)]
    assert errors[0] < 0.09 * errors[1]


def railed(t: float, step: float) -> Frame:
    """Bars 18 pixels apart that move by `step` a frame, before a wall that moves by 3."""
    y, x = np.indices((96, 160), np.float64)
    is_bar, at = np.abs((x - step * t) % 18 - 9) < 1.5, x - 3 * t
    light = (1 + 0.3 * np.sin(0.5 * at + 2 * np.sin(0.11 * at)) * np.sin(0.4 * y)
             + 0.3 * np.sin(0.37 * at + 0.7 * y))
    planes = {Role.COLOUR: np.where(is_bar, 0.15, light)[..., None].repeat(3, -1),
              Role.MOTION: np.stack([np.where(is_bar, -step, -3), 0 * y], -1),
              Role.DEPTH: np.where(is_bar, 2, 8)[..., None]}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(t) + 1)


@pytest.mark.parametrize("step", [16, 24])
def test_a_flow_from_bar_to_bar_is_not_followed(step):
    """It fits where only one frame shows the wall. Planes tell where the bar and the wall at its
    ends go."""
    wanted = railed(0.5, step)[Role.COLOUR]
    errors = [np.square(Between(railed(0, step), railed(1, step), flow=flow).frame(0.5)[Role.COLOUR]
                        - wanted)[8:-8, 24:-24].mean() for flow in (True, False)]
    assert errors[0] < 1.05 * errors[1]


def test_what_is_dark_in_one_frame_and_black_in_the_other_is_mixed():
    frames = []
    for number, dark in ((1, 1e-3), (2, 0.0)):
        colour = np.ones((64, 96, 3), np.float32)
        colour[20:40, 30:60] = dark
        frames.append(Frame({Role.COLOUR: colour, Role.MOTION: np.zeros((64, 96, 2), np.float32)},
                            number=number))
    found = Between(*frames, flow=False).frame(0.5)[Role.COLOUR]
    np.testing.assert_allclose(found[25:35, 35:55], 5e-4, rtol=1e-5)


def test_motion_of_the_frame_after_leads_to_the_new_one(scene):
    found = Between(scene(0), scene(1)).motion_of_after(0.75)
    np.testing.assert_allclose(found, scene(1, step=0.25)[Role.MOTION], atol=1e-5)


def test_the_camera_turns_and_moves_along(scene):
    """Row vectors: a camera that has turned by an angle about y, at a place."""

    def camera(degrees: float, place: float) -> np.ndarray:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        # of a mirrored hand
        to_world = np.array([[-c, 0, s, 0], [0, 1, 0, 0], [s, 0, c, 0], [place, 2, -place, 1]])
        return np.linalg.inv(to_world)

    before, after = (replace(scene(t), world_to_camera=camera(20 + 30 * t, 4 * t), metadata={
        "worldToCamera": tuple(camera(20 + 30 * t, 4 * t).ravel()), "worldToNDC": (0.0,) * 16})
                     for t in (0, 1))
    found = Between(before, after).frame(0.25)
    np.testing.assert_allclose(found.world_to_camera, camera(27.5, 1), atol=1e-12)
    np.testing.assert_allclose(found.metadata["worldToCamera"], camera(27.5, 1).ravel(), atol=1e-12)
    assert "worldToNDC" not in found.metadata


def test_a_cut_a_still_and_another_size_repeat_the_nearer_frame_with_a_reason(scene):
    other = Frame({Role.COLOUR: np.ones((HEIGHT // 2, WIDTH // 2, 3), np.float32)}, number=2)
    for before, after, options, reason in (
            (scene(0), scene(1), {"is_cut": True}, "another shot"), (scene(0),
            replace(scene(1), reset=True), {}, "another shot"),
            (scene(0), replace(scene(0), number=2), {}, "nothing changes"),
            (scene(0), other, {}, "sizes differ: 112x72 and 56x36")):
        between = Between(before, after, **options)
        assert reason in (between.reason or "")
        np.testing.assert_array_equal(between.frame(0.4)[Role.COLOUR], before[Role.COLOUR])
        np.testing.assert_array_equal(between.frame(0.6, 9)[Role.COLOUR], after[Role.COLOUR])
        assert between.frame(0.6, 9).number == 9


HUD = np.s_[50:66, 6:40]


def drawn(frame: Frame, alpha: float, layer: bool = True, below: bool = False) -> Frame:
    """The frame under stripes of an overlay."""
    overlay = np.zeros((*SIZE, 4), np.float32)
    overlay[HUD] = np.where(np.arange(34)[None, :, None] % 6 < 3, 5.0, 0.25)
    overlay[HUD][..., 3], overlay[..., :3] = 1, overlay[..., :3] * alpha
    overlay[..., 3] *= alpha
    colour = overlay[..., :3] + (1 - overlay[..., 3:]) * frame[Role.COLOUR]
    planes = {**frame.planes, Role.COLOUR: colour}
    planes |= {Role.OVERLAY: overlay} if layer else {}
    planes |= {Role.OPAQUE_COLOUR: frame[Role.COLOUR]} if below else {}
    return replace(frame, planes=planes)


@pytest.mark.parametrize("options",
                         [{"layer": True}, {"layer": False}, {"layer": False, "below": True}])
def test_an_opaque_overlay_that_stands_still_is_exact(scene, options):
    """Given as a layer, not told at all, and by pictures without it; the scene beside it moves
    on."""
    before, after = (drawn(scene(t), 1.0, **options) for t in (0, 1))
    found = Between(before, after, composited=options["layer"]).frame(0.5)[Role.COLOUR]
    np.testing.assert_allclose(found[HUD], before[Role.COLOUR][HUD], atol=1e-4, rtol=0)
    assert error(found, 0.5, np.s_[8:45, 8:-8]) < 0.15 * error(faded(scene, 0.5), 0.5,
                                                               np.s_[8:45, 8:-8])


@pytest.mark.parametrize("options", [{"layer": True}, {"layer": False, "below": True}])
def test_the_scene_moves_on_under_a_transparent_overlay(scene, options):
    before, after = (drawn(scene(t), 0.5, **options) for t in (0, 1))
    wanted = drawn(Frame({Role.COLOUR: picture(0.5)[0]}), 0.5)[Role.COLOUR]
    found = Between(before, after, composited=options["layer"]).frame(0.5)[Role.COLOUR]
    blended = (before[Role.COLOUR] + after[Role.COLOUR]) / 2
    assert np.abs(found - wanted)[HUD].mean() < 0.25 * np.abs(blended - wanted)[HUD].mean()


def test_an_overlay_in_a_layer_of_its_own_is_mixed_or_held(scene):
    before, after = drawn(scene(0), 1.0), drawn(scene(1), 0.5)
    mixed = Between(before, after).frame(0.25)[Role.OVERLAY]
    np.testing.assert_allclose(mixed, 0.75 * before[Role.OVERLAY] + 0.25 * after[Role.OVERLAY],
                               rtol=1e-6)
    held = Between(before, after, overlay="hold").frame(0.25)[Role.OVERLAY]
    np.testing.assert_array_equal(held, before[Role.OVERLAY])


def test_alpha_is_mixed_and_ids_are_not(scene):
    frames = []
    for t in (0, 1):
        there = picture(t)[1][..., None].astype(np.float32)
        frame = scene(t)
        frames.append(replace(frame, planes={**frame.planes, Role.ALPHA: there},
                              parts={"id": there * 1e20 + 3},
                              part_sources={"id": PartSource(("id.V",), exact=True)}))
    found = Between(*frames).frame(0.5)
    assert set(np.unique(found.parts["id"])) == {np.float32(3), np.float32(1e20)}
    assert 0.97 < found[Role.ALPHA].sum() / picture(0.5)[1].sum() < 1.03
    assert found[Role.ALPHA].min() >= 0 and found[Role.ALPHA].max() <= 1 + 1e-6


@pytest.mark.parametrize("wrong", [
    lambda one: Between(one, np.ones((4, 4, 3), np.float32)),
    lambda one: Between(one, one).frame([0.5]),
    lambda one: Between(one, one).frame(None),
    lambda one: Between(one, one).frame("0.5"),
    lambda one: Interpolator().push(3),
    lambda one: Interpolator().push(one, None),
    lambda one: Interpolator().push(one, [1.0]),
])
def test_what_is_no_frame_or_no_time_is_told(scene, wrong):
    with pytest.raises(FrameError, match="give "):
        wrong(scene(0))


def test_a_stream_gives_frames_at_times_of_its_own(scene):
    stream = Interpolator()
    with pytest.raises(FrameError, match="push two frames first"):
        stream.frame(0.5)
    for t in (0, 1, 2):
        stream.push(scene(t), 1 / 24)
    np.testing.assert_array_equal(stream.at(2.25 / 24)[Role.COLOUR],
                                  stream.frame(0.25)[Role.COLOUR])
    assert error(stream.frame(0.5)[Role.COLOUR], 1.5) < 0.1
    with pytest.raises(FrameError, match="give 0 <= t <= 1"):
        stream.at(4 / 24)
    with pytest.raises(FrameError, match="give a time above 0"):
        stream.push(scene(3), 0)


def test_pictures_for_a_display_and_tiny_ones(scene):
    with pytest.raises(FrameError, match="frame 2 .* before the display transform"):
        Between(scene(0), replace(scene(1), encoding="srgb"))
    tiny = [Frame({Role.COLOUR: np.full((3, 5, 3), value, np.float32)}) for value in (1, 3)]
    np.testing.assert_allclose(Between(*tiny).frame(0.5)[Role.COLOUR], 2)


@pytest.mark.parametrize(("points", "reach", "found"), [
    # each has an edge on one side alone: right, left, below and above
    ([(4, 4), (4, 5), (8, 2), (9, 2)], 0, 4),
    ([(6, 6), *((6 + s, 6) for s in range(-4, 5) if s), *((6, 6 + s) for s in range(-4, 5) if s)],
     2, 1 + 4 * 3),
])
def test_an_overlay_in_the_picture_is_found_by_its_edges_and_grown(points, reach, found):
    before, after = np.random.default_rng(0).random((2, 13, 13, 3), np.float32)
    # the first differs from those beside it, as does each one of a pair
    for place, at in enumerate(points):
        before[at] = after[at] = 1.0 if place % 2 == 0 and (reach == 0 or place == 0) else 0.5
    known = np.ones((13, 13), np.bool_)
    find_overlay(before, after, np.ones((13, 13, 2), np.float32), reach, known)
    assert (~known).sum() == found and not known[points[0]]


def test_a_spark_without_vectors_is_shown_once_and_keeps_its_light(scene):
    """That of the nearer frame, and nothing of the other one's, not even its edge."""
    def lit(frame: Frame, row: float, column: float, light: float) -> Frame:
        y, x = np.indices(SIZE)
        share = (3.1 - np.hypot(y - row, x - column)).clip(0, 1)[..., None]
        colour = frame[Role.COLOUR] + np.float32(light) * share.astype(np.float32)
        return replace(frame, planes={**frame.planes, Role.COLOUR: colour})

    plain = [scene(0), scene(1)]
    frames = [lit(plain[0], 9, 22, 2000), lit(plain[1], 12, 70, 3500)]
    found, without = (Between(*two).frame(0.4)[Role.COLOUR] for two in (frames, plain))
    more = np.abs(found - without).sum(-1)
    assert more[:24, 56:90].max() < 20, "a ring would be 100 and more"
    assert more[5:15, 14:28].max() > 4000
    sums = [float((one[Role.COLOUR] - other[Role.COLOUR]).sum())
            for one, other in zip(frames, plain, strict=True)]
    assert float((found - without).sum()) == pytest.approx(0.6 * sums[0] + 0.4 * sums[1], rel=0.05)
    layer = np.zeros((*SIZE, 4), np.float32)
    layer[..., 3] = 1
    layer[6:20, 16:80, 3] = 0  # what is below is black elsewhere
    covered = [replace(frame, planes={**frame.planes, Role.OVERLAY: layer}) for frame in frames]
    assert not Between(*covered, composited=True)._sparks


@pytest.mark.parametrize("none", [np.nan, 1e10, -65504.0])
def test_vectors_that_stand_for_none_are_estimated(none):
    """Something textured pans by three pixels, of which only a part has vectors."""
    rows, columns = np.mgrid[0:96, 0:160].astype(np.float32)

    def shot(time: float) -> Frame:
        light = sum(np.sin(k * (columns + 3 * time) + j * rows + k)
                    for k, j in ((0.1, 0.2), (0.31, -0.2), (0.7, 0.5)))
        colour = np.repeat((0.5 + 0.15 * light)[..., None], 3, axis=2)
        motion = np.zeros((96, 160, 2), np.float32) + (3, 0)
        motion[:, 40:] = none
        planes = {Role.COLOUR: colour, Role.MOTION: motion,
                  Role.DEPTH: np.full((96, 160, 1), 5.0, np.float32)}
        return Frame(planes)

    found = Between(shot(0), shot(1)).frame(0.5)[Role.COLOUR]
    error = np.abs(found - shot(0.5)[Role.COLOUR])[8:-8, 8:-8].mean()
    assert error < 0.2 * np.abs((shot(0)[Role.COLOUR] + shot(1)[Role.COLOUR]) / 2
                                - shot(0.5)[Role.COLOUR]).mean()

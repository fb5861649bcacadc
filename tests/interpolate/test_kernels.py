"""Kernels of frames between frames: against their formulas in NumPy, and that none reads or writes
out of bounds."""

from __future__ import annotations

import numpy as np
import pytest

from postfx import Between
from postfx.frame import Frame, Role
from postfx.interpolate import blend, choose, paths, timing
from postfx.motion import flow


def bilinear(picture: np.ndarray, y: float, x: float, rows: int, columns: int) -> np.ndarray:
    """A window of a picture from a place on."""
    j, i = int(np.floor(y)), int(np.floor(x))
    v, u = y - j, x - i
    part = picture[j:j + rows + 1, i:i + columns + 1]
    lines = part[:, :-1] * (1 - u) + part[:, 1:] * u
    return lines[:-1] * (1 - v) + lines[1:] * v


def test_windows_are_compared_as_in_their_formula():
    before, after = np.random.default_rng(1).random((2, 40, 50), np.float32)
    known = np.ones((24, 34), np.bool_)
    margin = choose.MARGIN
    path = np.float32([1.3, -2.2, -0.6, 3.1])
    toned = choose.Toned(before, after, known, known, 1)
    ends = np.broadcast_to(path, (24, 34, 4)).copy()
    side = paths.Paths(ends, np.zeros((24, 34, 2), np.float32), np.ones((24, 34, 1), np.float32),
                       np.ones((24, 34), np.float32))
    cells = np.zeros((24, 34, 8), np.float32)
    cells[..., :4], cells[..., 4:6] = path, 1
    unlikely = cells.copy()
    choose.measure_detail(toned, 1.0, cells)
    choose.measure_detail(toned, 0.0, unlikely)

    def windows(y: float, x: float) -> list[np.ndarray]:
        return [bilinear(picture, y + v - 2.5 + margin, x + u - 3.5 + margin, 6, 9).astype(float)
                for picture, u, v in ((before, 1.3, -2.2), (after, -0.6, 3.1))]

    taper = np.array(choose.TAPER)
    first, last = windows(10, 14)
    assert choose.measure_misfits(toned, side)[2, 3] == pytest.approx(
        (np.abs(first - last)[:, :8] * taper).sum() / choose.COUNT, rel=1e-4)
    first, last = windows(10.5, 14.5)  # of four cells
    apart, common = ((taper * (np.diff(one[:, :8], axis=0)**2).sum(0)).sum()
                     + (taper * np.diff(one, axis=1)**2).sum()
                     for one in (first - last, first + last))
    assert cells[10, 14, 6] == pytest.approx(max(1 - apart / common, 0), abs=1e-4)
    assert unlikely[10, 14, 6] == 1, "without noise nothing is blurred"


def test_patches_of_the_flow_are_compared_as_in_their_formula():
    """Each patch's misfit is that of the motion that was found for it."""
    one, other = np.random.default_rng(2).random((2, 40, 50), np.float32)
    margin, size = flow.MARGIN, flow.PATCH
    moved = np.zeros((4, 6, 3), np.float32)
    flow._search(0, 1, one, other, np.full((20, 30, 2), 0.4, np.float32), moved)
    for row, column in ((0, 0), (1, 2), (3, 5)):
        u, v, misfit = moved[row, column].astype(float)
        top, left = 4 * row + margin, 4 * column + margin
        patch = bilinear(other, top + v, left + u, size,
                         size)[:size, :size] - one[top:, left:][:size, :size]
        assert misfit == pytest.approx(patch.var(), rel=1e-3)


def taps(t: float, sharp: float) -> np.ndarray:
    spline = [(1 - t)**3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    catmull_rom = [-t**3 + 2 * t**2 - t, 3 * t**3 - 5 * t**2 + 2, -3 * t**3 + 4 * t**2 + t,
                   t**3 - t**2]
    return sharp / 2 * np.array(catmull_rom) + (1 - sharp) / 6 * np.array(spline)


def cubic(picture: np.ndarray, y: float, x: float, sharp: float) -> np.ndarray:
    """A picture at a place, within the range of the four pixels around it."""
    j, i = int(np.floor(y)), int(np.floor(x))
    near = picture[j:j + 2, i:i + 2]
    found = np.einsum("jic,j,i->c", picture[j - 1:j + 3, i - 1:i + 3], taps(y - j, sharp),
                      taps(x - i, sharp))
    return found.clip(near.min((0, 1)), near.max((0, 1)))


def composed(cells: np.ndarray, pictures: blend.Pair, depth: blend.Pair | None = None,
             t: float = 0.5, scale: int = 1) -> np.ndarray:
    """The colour between two pictures."""
    size = pictures[0].shape[:2]
    known, nothing = np.ones(size, bool), np.empty((*size, 0), np.float32)
    none = np.empty((0, 0, 1), np.float32)
    planes = blend.PairPlanes(pictures, (known, known), depth or (none, none), (nothing, nothing),
                          (nothing, nothing))
    return blend.compose(cells, planes, blend.Mixture(t, scale, 1.0, False, (0.0, 0.0)), False)[0]


@pytest.mark.parametrize("sharp", [0, 0.4, 1])
def test_pictures_are_sampled_by_cubics_within_the_range_of_four_pixels(sharp):
    """In the middle, and near an edge, which is sampled otherwise."""
    picture = np.random.default_rng(3).random((12, 14, 3), np.float32)
    cells = np.zeros((12, 14, 8), np.float32)
    cells[..., :2], cells[..., 4], cells[..., 6:] = (0.8, 0.3), 1, (sharp, 1)
    found = composed(cells, (picture, picture[::-1].copy()))
    for y, x in ((5, 6), (8, 10), (1, 11)):
        np.testing.assert_allclose(found[y, x], cubic(picture, y + 0.3, x + 0.8, sharp), rtol=1e-5)


def inside(plane: np.ndarray) -> np.ndarray:
    """The plane in the middle of memory that holds NaN."""
    around = np.full(plane.size + 4000, np.nan, np.float32)
    held = around[2000:2000 + plane.size].reshape(plane.shape)
    held[:] = plane
    return held


@pytest.mark.parametrize("size", [(64, 67), (65, 130), (71, 64), (33, 40), (5, 7)])
@pytest.mark.parametrize("most", [0.7, 9, 300])
def test_nothing_beside_a_picture_gets_into_it(size, most):
    """Of any size, with motion to anywhere."""
    rng = np.random.default_rng(4)

    def make(number: int) -> Frame:
        planes = {Role.COLOUR: rng.random((*size, 3)),
                  Role.MOTION: rng.uniform(-most, most, (*size, 2)),
                  Role.DEPTH: rng.uniform(1, 9, (*size, 1)), Role.ALPHA: rng.random((*size, 1))}
        return Frame({role: inside(plane.astype(np.float32)) for role, plane in planes.items()},
                     number=number)

    found = Between(make(1), make(2), make(3)).frame(0.3)
    for role, highest in ((Role.COLOUR, 1), (Role.ALPHA, 1), (Role.DEPTH, 9)):
        assert 0 <= found[role].min() and found[role].max() <= highest + 1e-5, role
    assert np.isfinite(found[Role.MOTION]).all()


def test_the_nearest_surface_is_found_where_a_path_is_at_the_time():
    """A path from (1, 2) to (3, 6) past a pixel, bent by (1, 2), is at its start + t (end -
    start) + t (t - 1) bend."""
    ends, bend = np.zeros((12, 12, 4), np.float32), np.zeros((12, 12, 2), np.float32)
    depth, nearest = np.full((12, 12, 1), 9, np.float32), np.full((12, 12), np.inf, np.float32)
    ends[3, 4], bend[3, 4], depth[3, 4] = (1, 2, 3, 6), (1, 2), 1
    paths._splat_nearest(0, 12, ends, bend, depth, np.float32([0.75, 0.75 * -0.25]), nearest)
    across, down = 1 + 0.75 * 2 - 0.1875 * 1, 2 + 0.75 * 4 - 0.1875 * 2
    assert np.argwhere(nearest == 1).tolist() == [[int(3.5 + down), int(4.5 + across)]]


@pytest.mark.parametrize(("beside", "shares"), [(1.0, (0.5, 1, 1, 1)), (0.9, (0.5, 0.6, 0.8, 0.9))])
def test_a_cell_that_keeps_all_detail_keeps_it_up_to_the_middle_of_those_beside(beside, shares):
    """So that light does not leak over an edge; other cells share."""
    picture = np.random.default_rng(3).random((16, 16, 3), np.float32)
    cells = np.zeros((8, 8, 8), np.float32)
    cells[..., :2], cells[..., 4], cells[..., 6:] = (0.25, 0.5), 1, (0.5, 1)
    cells[:, 4:, 6] = beside
    found = composed(cells, (picture, picture), scale=2)
    for x, sharp in zip((6, 7, 8, 9), shares, strict=True):
        np.testing.assert_allclose(found[7, x], cubic(picture, 7.5, x + 0.25, sharp), rtol=1e-4)


def test_a_pixel_mixes_what_its_paths_show_by_how_well_both_frames_agree():
    """Less of what lies behind another thing that both frames show. The pixel (1, 1) lies a quarter
    of the way from the first of four cells to the others; the third follows the path of the
    first."""
    before = np.ones((4, 40, 3), np.float32)
    after = np.ones((4, 40, 3), np.float32)
    near = np.ones((4, 40, 1), "f4")
    before[:, 8:14], after[:, 8:14] = 3, 2
    before[:, 18:24], near[:, 18:24] = 8, 2
    before[:, 28:34], after[:, 28:34], near[:, 28:34] = 5, 5, 1.05
    cells = np.zeros((2, 2, 8), np.float32)
    cells[..., 4:7] = 1
    cells[0, 1, 5] = 0
    cells[..., 0] = cells[..., 2] = [[10, 20], [10, 30]]
    shares, hidden = np.array([0.75, 0.1875, 0.0625]), np.array([1, blend.HIDDEN, 1])
    apart = np.array([3 / 15, blend.UNSURE, 0])
    weights = shares * hidden / (blend.ALIKE + apart**2)
    found = composed(cells, (before, after), (near, near), scale=2)
    np.testing.assert_allclose(found[1, 1], weights @ [2.5, 8, 5] / weights.sum(), rtol=1e-5)


def test_inverted_motion_is_led_to_where_motion_leads_back():
    """Of a picture that turns by 40 degrees, away from its edges."""
    y, x = np.indices((40, 40)) - 19.5
    turn = np.radians(40)
    motion = np.stack([x * np.cos(turn) - y * np.sin(turn) - x,
                       x * np.sin(turn) + y * np.cos(turn) - y], -1)
    wanted = np.stack([x * np.cos(turn) + y * np.sin(turn) - x,
                       y * np.cos(turn) - x * np.sin(turn) - y], -1)
    inverse = (wanted
               + np.random.default_rng(3).uniform(-0.4, 0.4, wanted.shape)).astype(np.float32)
    paths.refine(motion.astype(np.float32), inverse)
    assert np.abs(inverse - wanted)[np.hypot(y, x) < 16].max() < 0.06


def test_motion_that_changes_from_pixel_to_pixel_is_found_in_any_direction():
    """Then inverted motion is led on, else it is left as it is, even where it misses by a tenth of
    a pixel."""
    def refined(motion: np.ndarray) -> bool:
        inverse = np.full((4, 4, 2), 99, np.float32)
        inverse[1, 1] = 0.5
        paths.refine(motion, inverse)
        return bool((inverse[1, 1] != 0.5).any())

    assert not refined(np.full((4, 4, 2), -0.6, np.float32))
    for pixel in ((1, 1), (1, 2), (2, 1), (2, 2)):
        for channel in range(2):
            for change in (-0.4, 0.4):
                motion = np.full((4, 4, 2), -0.6, np.float32)
                motion[(*pixel, channel)] += change
                assert refined(motion), (pixel, channel, change)


def test_flow_is_moved_along_itself_where_planes_do_not_know_of_it():
    """By half of its way, from cells of 2x2 pixels; where two arrive, the one whose ends look alike
    counts."""
    flow_, known = np.full((12, 12, 2), np.nan, np.float32), np.zeros((12, 12, 2), np.float32)
    one, other = np.zeros((2, 12, 12), np.float32)
    flow_[1, 2], flow_[1, 8], flow_[6, 3], known[6, 3] = (12, 8), (-12, 8), (8, 0), (4, 0)
    one[1, 8], other[5, 2] = 0.5, 0.1
    brought = flow.bring_to_time(flow_, known, one, other, 2, 0.5)
    # the four cells around the place; what planes tell
    flow_[3:5, 5:7], flow_[6, 3, 0] = flow_[1, 2], np.nan
    np.testing.assert_array_equal(brought, flow_)


def dark_with(*discs: tuple[int, int, float]) -> np.ndarray:
    """A dark picture with discs of 5 pixels, at these pixels, of this light."""
    picture = np.full((66, 91, 3), 0.1, np.float32)
    y, x = np.indices(picture.shape[:2])
    for row, column, light in discs:
        picture[np.hypot(y - row, x - column) < 2.6] = light / 3
    return picture


@pytest.mark.parametrize("scale", [1, 2])
def test_sparks_are_small_and_brighter_than_all_around(scale):
    picture = dark_with((20, 30, 50), (20, 70, 12), (50, 20, 4))
    picture[40:, 60:] = 50  # a lamp
    grid = -(-66 // scale), -(-91 // scale)
    found = timing.find_sparks(picture, scale, np.float32(0.3), grid)
    marks = {place: found[place[0] // scale, place[1] // scale] for place in
             ((20, 30), (20, 70), (50, 20), (55, 80), (20, 32 + 2 * scale), (20, 50))}
    assert list(marks.values()) == [3, 2, 0, 0, 1, 0]


@pytest.mark.parametrize("is_first", [True, False])
def test_a_spark_of_the_farther_frame_is_left_out_with_its_edge(is_first):
    before, after = dark_with((20, 30, 90)), dark_with((44, 60, 90))
    later = after if is_first else before
    later[np.logical_and(later < 1, np.roll(later, 1, 1) > 1)] = 3  # half of a spark
    dim, cells = np.float32(0.3), np.zeros((33, 46, 8), np.float32)
    cells[..., 4:6] = 1
    marks = [timing.find_sparks(picture, 2, dim, (33, 46)) for picture in (before, after)]
    sparks = timing.Sparks((before, after), marks, 2, dim)
    timing.settle_sparks(sparks, 0.25 if is_first else 0.75, cells.copy(), cells)
    near, far = ((20, 30), (44, 60)) if is_first else ((44, 60), (20, 30))
    of_one = cells[..., 4] + cells[..., 5] == 1
    assert cells[far[0] // 2, far[1] // 2, 4:6].tolist() == [is_first, not is_first]
    assert (of_one[far[0] // 2, far[1] // 2 + 1]
            and not of_one[near[0] // 2 - 3:near[0] // 2 + 4].any())
    shown = np.argwhere(np.abs(later - 0.1).max(-1) > 0)
    assert all(of_one[y // 2, x // 2] for y, x in shown), "nothing of it is mixed in"
    assert of_one.sum() < 40


def test_light_of_sparks_that_are_hidden_goes_to_those_that_are_shown():
    """At a quarter of the time, of two sparks before and one after, of which one is shown."""
    before = dark_with((20, 30, 90), (50, 70, 30))
    after = dark_with((20, 60, 60))
    picture = dark_with((20, 30, 70))
    kept, dim, own = picture.copy(), np.float32(0.3), np.zeros((66, 91, 8), np.float32)
    own[..., 4:6] = 1
    found = [timing.find_sparks(one, 1, dim, (66, 91)) for one in (before, after)]
    marks, sparks = np.maximum(*found), timing.Sparks((before, after), found, 1, dim)
    timing.keep_sparks(sparks, 0.25, own, marks, picture)
    light = [float((one - 0.1).sum()) for one in (before, after, picture)]
    assert light[2] == pytest.approx(0.75 * light[0] + 0.25 * light[1], rel=1e-4)
    np.testing.assert_array_equal(picture[kept < 1], kept[kept < 1])
    few = dark_with((20, 30, 20))
    timing.keep_sparks(sparks, 0.25, own, marks, few)
    assert few.max() == pytest.approx(0.1 + timing.SPARK_SCALES[1] * (20 / 3 - 0.1),
                                      rel=1e-4), "within bounds"

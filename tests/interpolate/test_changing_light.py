"""Frames between frames of changing light, of thin things, and with vectors that are of no use."""

from dataclasses import replace

import numpy as np
import pytest

from postfx import Between, Frame, Role
from postfx.cuts import CutDetector
from postfx.interpolate.lost import motion_of_lost
from postfx.interpolate.shares import BY_VECTORS
from postfx.interpolate.ways import unevenness

HEIGHT, WIDTH, PAN, FLY = 96, 160, 3.0, (7.0, 2.0)
Y, X = np.mgrid[:HEIGHT, :WIDTH] + 0.5


def texture(x, y, seed):
    random, value = np.random.default_rng(seed), np.zeros((*x.shape, 3))
    for _ in range(14):
        k = random.uniform(0.05, 0.9, 2) * random.choice((-1, 1), 2)
        value += np.sin(x * k[0] + y * k[1]
                        + random.uniform(0, 6.3))[..., None] * random.uniform(-0.5, 0.5, 3)
    return (0.5 + 0.16 * value).clip(0.02, None)


def picture(time: float, light=1.0) -> tuple[np.ndarray, np.ndarray]:
    """A wall that pans behind a disc that flies, and where the disc is."""
    x, y = 45 + FLY[0] * time, 40 + FLY[1] * time
    inside = ((X - x) ** 2 + (Y - y) ** 2 < 18**2)[..., None]
    wall, disc = texture(X + PAN * time, Y, 3), texture(X - x, Y - y, 5) * (1.2, 0.7, 0.3)
    return np.where(inside, disc, wall) * light, inside


def frame(time: float, light=1.0, vectors: bool = True, change=lambda motion: motion,
          number: int = 1) -> Frame:
    colour, inside = picture(time, light)
    planes = {Role.COLOUR: colour}
    if vectors:
        motion = np.where(inside, (-FLY[0], -FLY[1]), (PAN, 0.0))
        planes |= {Role.MOTION: change(motion), Role.DEPTH: np.where(inside, 5.0, 10.0)}
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()}, number=number)


def psnr(found: np.ndarray, truth: np.ndarray) -> float:
    one, other = ((light / (1 + light)) ** (1 / 2.2) for light in (np.maximum(found, 0), truth))
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


def lamp(time: float) -> np.ndarray:
    """Light around a lamp that moves on."""
    return 1 + 4 * np.exp(-(((X - 20 - 12 * time) ** 2 + (Y - 50) ** 2) / 30**2))[..., None]


LIGHTS = {
    "a flash": (1.0, 4.0),
    "lightning": (1.0, 50.0),
    "a fade": (1.0, 0.5),
    "another colour": (1.0, np.array([6.0, 2.0, 1.2])),
    "a lamp that moves": (lamp(0), lamp(1)),
    "a lamp that goes on": (1.0, lamp(1)),
}


@pytest.mark.parametrize("vectors", [True, False])
@pytest.mark.parametrize("kind", LIGHTS)
def test_light_is_that_of_the_time_everywhere(kind, vectors):
    """Also where one frame alone shows a place. Before, these were 3 to 15 dB below steady
    light."""
    first, last = (np.broadcast_to(light, (HEIGHT, WIDTH, 3)) for light in LIGHTS[kind])
    wanted, _ = picture(0.5, lamp(0.5) if kind == "a lamp that moves" else (first + last) / 2)
    pair = frame(0, first, vectors), frame(1, last, vectors)
    found = Between(*pair).frame(0.5)[Role.COLOUR]
    blend = (pair[0][Role.COLOUR] + pair[1][Role.COLOUR]) / 2
    assert psnr(found, wanted) > max(37 if vectors else 30, psnr(blend, wanted) - 0.2)


def test_the_first_quarter_has_a_quarter_of_the_change():
    found = Between(frame(0), frame(1, 4.0)).frame(0.25)[Role.COLOUR]
    assert psnr(found, picture(0.25, 1.75)[0]) > 37


def test_steady_light_is_left_as_it_is():
    assert Between(frame(0), frame(1))._pictures.change is None
    assert Between(frame(0, vectors=False), frame(1, vectors=False))._pictures.change is None
    assert Between(frame(0), frame(1, 1.05))._pictures.change is None


WRONG = {
    "the other sign": np.negative,
    "of half the time": lambda motion: motion / 2,
    "(1, 1) for none": np.ones_like,
    "parts of the picture": lambda motion: motion / WIDTH,
}


@pytest.mark.parametrize("kind", WRONG)
def test_vectors_that_do_not_fit_are_not_used(kind):
    """As of frames that are held: vectors of one step where the picture moves by two."""
    pair = frame(0, change=WRONG[kind]), frame(1, change=WRONG[kind])
    none = frame(0, vectors=False), frame(1, vectors=False)
    wanted, _ = picture(0.5)
    found, flow = (psnr(Between(*one).frame(0.5)[Role.COLOUR], wanted) for one in (pair, none))
    assert found > flow - 0.3


def test_a_held_frame_stays_where_its_vectors_say_that_it_moves():
    random = np.random.default_rng(5)
    pair = [frame(0), frame(0)]
    for one in pair:
        one.planes[Role.COLOUR] = (one[Role.COLOUR]
                                   + random.normal(0, 0.01, (HEIGHT, WIDTH, 3)).astype(np.float32))
    assert psnr(Between(*pair).frame(0.5)[Role.COLOUR], picture(0)[0]) > 48


def test_right_vectors_are_used():
    found = Between(frame(0), frame(1))
    assert found._motion.has_vectors
    assert psnr(found.frame(0.5)[Role.COLOUR], picture(0.5)[0]) > 38


SHOTS = {
    "one that pans": lambda time: texture(X - 4 * time, Y + time, 11),
    "one that stands still": lambda time: 0.8 * texture(X, Y, 12),
    "one that pans fast": lambda time: 1.3 * texture(X + 9 * time, Y - 3 * time, 13),
    "a brighter one": lambda time: 3 * texture(X - 2 * time, Y, 14),
    "black": lambda time: np.zeros((HEIGHT, WIDTH, 3)),
}


@pytest.mark.parametrize("kind", SHOTS)
def test_a_dissolve_is_no_worse_than_without_vectors_or_than_a_mean(kind):
    """To another shot, in seven steps, with the vectors of the one that goes, by two frames alone.
    The worst was 23 dB below; where neither way is right, the worst is still 1.4 dB below."""
    def shown(time):
        return picture(time)[0] * (1 - time / 7) + SHOTS[kind](time) * time / 7

    worse = []
    for time in range(7):
        pairs = {vectors: [frame(time + k, vectors=vectors) for k in range(2)]
                 for vectors in (True, False)}
        for pair in pairs.values():
            for k, one in enumerate(pair):
                one.planes[Role.COLOUR] = shown(time + k).astype(np.float32)
        found, flow = (Between(*pair).frame(0.5)[Role.COLOUR] for pair in pairs.values())
        mean = sum(one[Role.COLOUR] for one in pairs[True]) / 2
        wanted = shown(time + 0.5)
        worse.append(max(psnr(flow, wanted), psnr(mean, wanted)) - psnr(found, wanted))
    assert max(worse) < 1.5, worse


@pytest.mark.parametrize("kind", ["one that pans fast", "one that stands still"])
def test_frames_beside_a_dissolve_tell_which_way_counts(kind):
    """From a shot that pans fast, whose vectors are right to the end. Without them, the second step
    was 26 dB, and the third 3.8 dB below the flow's."""
    def pan(time: float) -> np.ndarray:
        return texture(X + 11 * time, Y + 2 * time, 3)

    def shown(time: float) -> np.ndarray:
        part = min(max(time / 8, 0), 1)
        return pan(time) * (1 - part) + SHOTS[kind](time) * part

    def at(time: float, *vectors: tuple[float, float]) -> Frame:
        planes = {Role.COLOUR: shown(time).astype(np.float32)}
        for vector in vectors:
            planes[Role.MOTION] = np.full((HEIGHT, WIDTH, 2), vector, np.float32)
        return Frame(planes, number=1)

    frames, between, gained = [at(time, (11, 2)) for time in range(1, 7)], None, []
    for i, (before, after, later) in enumerate(zip(frames, frames[1:], frames[2:], strict=False)):
        between = Between(before, after, later, last=between)
        wanted, mean = shown(i + 1.5), (before[Role.COLOUR] + after[Role.COLOUR]) / 2
        flow = Between(at(i + 1), at(i + 2)).frame(0.5)[Role.COLOUR]
        gained.append(psnr(between.frame(0.5)[Role.COLOUR], wanted)
                      - max(psnr(flow, wanted), psnr(mean, wanted)))
    assert min(gained) > -1 and gained[1] > 3, gained


def test_a_blend_counts_where_it_is_as_even_as_vectors_that_fit():
    """In the midst of a dissolve between two pans: vectors still explain more than standing still.
    By them alone, the picture was 1.2 dB below the blend."""
    def at(time: float) -> Frame:
        colour = (texture(X + 5 * time, Y + time, 127) * (1 - time / 9)
                  + texture(X - time, Y, 102) * time / 9)
        return Frame({Role.COLOUR: colour.astype(np.float32),
                      Role.MOTION: np.full((HEIGHT, WIDTH, 2), (5, 1), np.float32)}, number=1)

    earlier, before, after, later = (at(time) for time in range(3, 7))
    found = Between(before, after, later, last=Between(earlier, before)).frame(0.5)[Role.COLOUR]
    mean, wanted = (before[Role.COLOUR] + after[Role.COLOUR]) / 2, at(4.5)[Role.COLOUR]
    assert psnr(found, wanted) > psnr(mean, wanted) + 0.5


def test_copies_beside_held_frames_tell_nothing():
    """A shot in twos, with vectors of single steps: its copies go on evenly at the same place, so
    that the blend counted, 6.7 dB below what two frames alone gave."""
    before, after, later = (replace(frame(time), number=number + 1)
                            for number, time in enumerate((1, 3, 3)))
    found = Between(before, after, later).frame(0.5)[Role.COLOUR]
    alone = Between(before, after).frame(0.5)[Role.COLOUR]
    wanted = picture(2)[0]
    assert psnr(found, wanted) > psnr(alone, wanted) - 0.5


def test_motion_that_is_found_from_one_side_alone_is_found():
    """A pattern nearly repeats, so that the search from the frame after ends at a wrong place, and
    that from the frame before does not: the picture was 6.1 dB below the blend."""
    def at(time: float) -> Frame:
        x, y = X - 30 - 9 * time, Y - 70 + 4 * time
        disc = texture(x, y, 132) * (1.2, 0.7, 0.3)
        wall = texture(X + 4 * time, Y, 131)
        shot = np.where((x**2 + y**2 < 18**2)[..., None], disc, wall)
        colour = shot * time / 8 + texture(X - 5 * time, Y + time, 103) * (1 - time / 8)
        return Frame({Role.COLOUR: colour.astype(np.float32)}, number=1)

    before, after, wanted = at(7), at(8), at(7.5)[Role.COLOUR]
    found = Between(before, after).frame(0.5)[Role.COLOUR]
    mean = (before[Role.COLOUR] + after[Role.COLOUR]) / 2
    assert psnr(found, wanted) > psnr(mean, wanted) + 3


def stripes(time: float) -> np.ndarray:
    """A grey pattern that moves fast."""
    return np.repeat(0.5 + 0.4 * np.sin((X - 5 * time) / 2.2)[..., None], 3, 2)


def test_colours_tell_a_way_that_grey_pictures_do_not_show():
    """Red and green of equal luminance stand still: a way that leads elsewhere is uneven."""
    green = 0.2 * (texture(X, Y, 3)[..., 0] - 0.5)
    red = -green * 0.7152 / 0.2126
    colour = (0.5 + np.stack([red, green, np.zeros_like(red)], -1)).astype(np.float32)
    still = np.zeros((HEIGHT // 2, WIDTH // 2, 2), np.float32)
    for count in (2, 3, 4):
        row = [colour] * count
        assert unevenness(row, int(count > 2), still, 0.5) < 1e-6
        assert unevenness(row, int(count > 2), still + np.float32(5), 0.5) > 0.008


def test_what_goes_over_evenly_is_no_sign_of_another_way():
    """Of frames beside the two, where those are known: light that grows along the right way."""
    row = [(light * texture(X + 3 * time, Y, 3)).astype(np.float32)
           for time, light in zip(range(-1, 3), (0.4, 0.5, 0.6, 0.7), strict=True)]
    motion = np.zeros((HEIGHT, WIDTH, 2), np.float32) + np.float32((3, 0))
    assert unevenness(row, 1, motion, 0.5) < 0.2 * unevenness(row[1:3], 0, motion, 0.5)
    assert unevenness(row, 1, motion, 0.5) < 0.2 * unevenness(row, 1, 0 * motion, 0.5)


def test_noise_hides_less_of_which_way_is_right():
    """Its differences are not those of the cells beside. By their size alone, the right way was
    0.70 times as uneven as standing still."""
    random = np.random.default_rng(3)
    row = [(texture(X + 4 * time, Y, 3)
            * random.gamma(4, 1 / 4, (HEIGHT, WIDTH, 3))).astype(np.float32) for time in range(4)]
    motion = np.zeros((HEIGHT // 2, WIDTH // 2, 2), np.float32) + np.float32((4, 0))
    assert unevenness(row, 1, motion, 0.5) < 0.65 * unevenness(row, 1, 0 * motion, 0.5)


@pytest.mark.parametrize(("shot", "least"), [("stripes", -2), ("pan", 7)])
def test_a_shot_that_stands_still_goes_over_into_one_that_moves(shot, least):
    """What stands still is told from what moves: neither estimated motion nor a blend follows both.
    Stripes were 5.2 dB below the better one, the pan 0.6."""
    move = {"stripes": stripes, "pan": lambda time: texture(X - 4 * time, Y + time, 11)}[shot]
    first = {"stripes": 1, "pan": 2}[shot]
    row = []
    for time in range(first, first + 4):
        colour = (1 - time / 8) * texture(X, Y, 3) + time / 8 * move(time)
        row.append(Frame({Role.COLOUR: colour.astype(np.float32),
                          Role.MOTION: np.zeros((HEIGHT, WIDTH, 2), np.float32)}, number=time + 1))
    part = (first + 1.5) / 8
    wanted = (1 - part) * texture(X, Y, 3) + part * move(first + 1.5)
    found = Between(*row[1:], last=Between(*row[:2])).frame(0.5)[Role.COLOUR]
    mean = (row[1][Role.COLOUR] + row[2][Role.COLOUR]) / 2
    flow = Between(*(Frame({Role.COLOUR: one[Role.COLOUR]}, number=one.number)
                     for one in row[1:3])).frame(0.5)[Role.COLOUR]
    assert psnr(found, wanted) > max(psnr(mean, wanted), psnr(flow, wanted)) + least


@pytest.mark.parametrize(("shot", "first", "least"), [("stripes", 0, 2), ("pan", 2, -0.5)])
def test_a_shot_that_moves_by_vectors_goes_over_into_another(shot, first, least):
    """What moves by the vectors is told from what moves otherwise, as if it stood still. Stripes
    were 4.3 dB below the better one of estimated motion and a mean, the pan 2.3."""
    move = {"stripes": stripes, "pan": lambda time: texture(X - 4 * time, Y + time, 11)}[shot]

    def shown(time):
        return (1 - time / 8) * picture(time)[0] + time / 8 * move(time)

    row, alone = [], []
    for time in range(first, first + 4):
        planes = {Role.COLOUR: shown(time).astype(np.float32)}
        alone.append(Frame(dict(planes), number=time))
        planes[Role.MOTION] = frame(time)[Role.MOTION]
        row.append(Frame(planes, number=time))
    wanted = shown(first + 1.5)
    found = Between(*row[1:], last=Between(*row[:2])).frame(0.5)[Role.COLOUR]
    mean = (row[1][Role.COLOUR] + row[2][Role.COLOUR]) / 2
    flow = Between(*alone[1:3])
    flow._shares = BY_VECTORS  # which are estimated
    best = max(psnr(mean, wanted), psnr(flow.frame(0.5)[Role.COLOUR], wanted))
    assert psnr(found, wanted) > best + least


def test_where_vectors_do_not_fit_light_does_not_change_along_them_either():
    """At the end of a dissolve into stripes the picture is that of estimated motion alone. It was
    6.7 dB below: light that changes had been sought along the vectors of the shot that went."""
    def at(time: float, vectors: bool) -> Frame:
        planes = {Role.COLOUR: (1 - time / 8) * texture(X, Y, 3) + time / 8 * stripes(time)}
        if vectors:
            planes[Role.MOTION] = np.zeros((HEIGHT, WIDTH, 2))
        return Frame({role: plane.astype(np.float32) for role, plane in planes.items()}, number=1)

    wanted = 0.5 / 8 * texture(X, Y, 3) + 7.5 / 8 * stripes(7.5)
    found, flow = (Between(at(7, vectors), at(8, vectors)).frame(0.5)[Role.COLOUR]
                   for vectors in (True, False))
    assert psnr(found, wanted) > psnr(flow, wanted) - 0.1


def wire(time: float, vectors: bool, step: float = 5.0, seed: int = 3, pan: float = 0.0) -> Frame:
    """A line of one pixel in front of a wall that stands still or pans, with vectors of what covers
    most of a pixel."""
    size = 6
    y, x = (np.mgrid[:HEIGHT * size, :WIDTH * size] + 0.5) / size
    cover = np.abs((x - 30 - step * time) - (y - 40) * 0.3) / np.hypot(1, 0.3) < 0.5
    cover = cover.reshape(HEIGHT, size, WIDTH, size).mean((1, 3))[..., None]
    planes = {Role.COLOUR: texture(X + pan * time, Y, seed) * (1 - cover) + 0.02 * cover}
    if vectors:
        planes[Role.DEPTH] = np.where(cover > 0.3, 3.0, 10.0)
        planes[Role.MOTION] = np.where(cover > 0.3, (-step, 0.0), (pan, 0.0))
    return Frame({role: plane.astype(np.float32) for role, plane in planes.items()},
                 number=int(time))


@pytest.mark.parametrize("step, seed", [(5.0, 3), (5.0, 7), (8.0, 3), (3.0, 3)])
def test_a_wire_is_no_cut_and_no_worse_with_vectors(step, seed):
    """Last of four frames, as those beside them are looked at. Nothing dissolves there. The worst
    was 5.2 dB below estimated motion; 0.6 are left, where that is right to the pixel."""
    detect = CutDetector()
    assert not any(detect(wire(time, True, step, seed)) for time in range(4))
    wanted, quality = wire(2.5, False, step, seed)[Role.COLOUR], {}
    for vectors in (True, False):
        frames, last = [wire(time, vectors, step, seed) for time in range(5)], None
        for time in range(3):
            last = Between(*frames[time:time + 3], last=last)
        quality[vectors] = psnr(last.frame(0.5)[Role.COLOUR], wanted)
    mean = (frames[2][Role.COLOUR] + frames[3][Role.COLOUR]) / 2
    assert last._shares == BY_VECTORS, "without vectors, estimated motion alone"
    assert quality[True] > max(quality[False], psnr(mean, wanted)) - 0.6


NOTHING = {
    "everywhere": lambda motion, is_wire: np.ones_like(motion),
    "on the wall": lambda motion, is_wire: np.where(is_wire, motion, np.float32(1)),
    "on the wire": lambda motion, is_wire: np.where(is_wire, np.float32(1), motion),
}


@pytest.mark.parametrize("step, seed", [(5.0, 3), (5.0, 7), (8.0, 3), (3.0, 3)])
@pytest.mark.parametrize("where", NOTHING)
@pytest.mark.parametrize("count", [2, 5])
def test_vectors_of_one_pixel_for_none_beside_a_wire(step, seed, where, count):
    """(1, 1) stands for none. Where the wall has them they fit worse than standing still; where
    the wire has, estimated motion finds it. Pictures were up to 8.7 dB below that."""
    def at(time):
        found = wire(time, True, step, seed)
        found.planes[Role.MOTION] = NOTHING[where](found[Role.MOTION], found[Role.DEPTH] < 5)
        return found

    wanted = wire(2.5, False, step, seed)[Role.COLOUR]
    frames, last = [at(time) for time in (range(5) if count == 5 else (2, 3))], None
    for *both, later in zip(frames, frames[1:], [*frames[2:], None], strict=False):
        last = Between(*both, later, last=last)
        if both[1].number == 3:
            break
    flow = Between(*(wire(time, False, step, seed) for time in (2, 3))).frame(0.5)[Role.COLOUR]
    mean = (wire(2, False, step, seed)[Role.COLOUR] + wire(3, False, step, seed)[Role.COLOUR]) / 2
    best = max(psnr(flow, wanted), psnr(mean, wanted))
    assert psnr(last.frame(0.5)[Role.COLOUR], wanted) > best - 0.05


@pytest.mark.parametrize("told", [(1.0, 1.0), (0.0, 0.0), (5.0, 0.0)])
def test_wrong_vectors_of_a_wire_before_a_wall_that_pans(told):
    """What is left of the wall is spread over the picture, and hid that the wire goes elsewhere: up
    to 6.1 dB below estimated motion."""
    def at(time):
        found = wire(time, True, pan=-1)
        on_wire = found[Role.DEPTH] < 5
        found.planes[Role.MOTION] = np.where(on_wire, told, (-1.0, 0.0)).astype(np.float32)
        return found

    wanted = wire(2.5, False, pan=-1)[Role.COLOUR]
    flow = Between(*(wire(time, False, pan=-1) for time in (2, 3))).frame(0.5)[Role.COLOUR]
    mean = (wire(2, False, pan=-1)[Role.COLOUR] + wire(3, False, pan=-1)[Role.COLOUR]) / 2
    best = max(psnr(flow, wanted), psnr(mean, wanted))
    assert psnr(Between(at(2), at(3)).frame(0.5)[Role.COLOUR], wanted) > best - 0.1


@pytest.mark.parametrize("time", [1, 3])
def test_the_edge_of_a_disc_is_no_thin_thing(time):
    """Its top has the wall on both sides, and goes on below. The picture around it was that of
    estimated motion in a flash, 1.4 dB below that of vectors."""
    found = Between(frame(time), frame(time + 1, 4.0)).frame(0.5)[Role.COLOUR]
    assert psnr(found, picture(time + 0.5, 2.5)[0]) > 39.5


@pytest.mark.parametrize("none", [np.nan, 1e10, -65504.0, -999.0, 200.0])
def test_vectors_of_one_thing_alone_are_better_than_none(none):
    """The wall has no vectors: what is estimated around the disc goes on with the disc, and must
    not be the wall's."""
    def disc_alone(motion):
        return np.where(motion[..., :1] < 0, motion, none)

    pair = frame(0, change=disc_alone), frame(1, change=disc_alone)
    flow = frame(0, vectors=False), frame(1, vectors=False)
    wanted, _ = picture(0.5)
    found, without = (psnr(Between(*one).frame(0.5)[Role.COLOUR], wanted) for one in (pair, flow))
    assert found > without + 0.7


def test_lost_motion_is_that_of_what_is_lost_around():
    """A column of cells with the motion of something else that has vectors, beside it."""
    estimated = np.zeros((12, 20, 2), np.float32) + (1.5, 0)
    estimated[:, 8:12] = -3.5, -1
    is_lost = np.ones((12, 20), np.bool_)
    is_lost[:, 10:12] = False
    consistent = estimated.copy()
    consistent[:, 8:10] = np.nan
    found = motion_of_lost(estimated, consistent, is_lost)
    np.testing.assert_allclose(found[:, :10], np.broadcast_to(np.float32((1.5, 0)), (12, 10, 2)),
                               atol=1e-5)
    np.testing.assert_array_equal(found[:, 10:], estimated[:, 10:])
    np.testing.assert_array_equal(motion_of_lost(estimated, np.full_like(estimated, np.nan),
                                                 is_lost), estimated)


RAMP = np.linspace(0, 1, WIDTH)[None, :, None]
GROUPS = {
    "a lamp that moves": lambda time: {"key": picture(time)[0] * (lamp(time) - 1),
                                       "fill": picture(time)[0]},
    "one that goes as another comes": lambda time: {
        "key": picture(time)[0] * RAMP * max(1 - time, 0),
        "fill": picture(time)[0] * (1 - RAMP) * min(time, 1)},
    "a shot that goes over into one that stands still": lambda time: {
        "key": picture(time)[0] * RAMP * (1 - time / 8) + time / 8 * texture(X, Y, 12) * (1 - RAMP),
        "fill": picture(time)[0] * (1 - RAMP) * (1 - time / 8) + time / 8 * texture(X, Y, 12)
        * RAMP},
    "light below 0": lambda time: {"key": 2 * picture(time)[0], "dark": -picture(time)[0] * RAMP},
}


def grouped(time: float, kind: str, vectors: bool) -> Frame:
    parts = {name: part.astype(np.float32) for name, part in GROUPS[kind](time).items()}
    found = frame(time, vectors=vectors)
    return replace(found, parts=parts,
                   planes={**found.planes, Role.COLOUR: sum(parts.values())})


@pytest.mark.parametrize("vectors", [True, False])
@pytest.mark.parametrize("kind", GROUPS)
def test_light_groups_add_up_to_the_picture_and_have_the_light_of_the_time(kind, vectors):
    """They were up to 4.7 % of its light apart, and up to 9 dB worse than they are."""
    frames = [grouped(time, kind, vectors) for time in (-1, 0, 1, 2)]
    found = Between(*frames[1:], last=Between(*frames[:2])).frame(0.5)
    np.testing.assert_allclose(sum(found.parts.values()), found[Role.COLOUR], rtol=1e-4, atol=1e-5)
    for name, wanted in GROUPS[kind](0.5).items():
        blend = (frames[1].parts[name] + frames[2].parts[name]) / 2
        sign = -1 if name == "dark" else 1
        least = psnr(sign * blend, sign * wanted) + (1 if vectors else -0.3)
        assert psnr(sign * found.parts[name], sign * wanted) > least


@pytest.mark.parametrize("kind", SHOTS)
def test_a_dissolve_without_vectors_is_hardly_worse_than_a_mean(kind):
    """Estimated motion alone was up to 6.6 dB below. Where it matches other waves of the same
    pattern, 4.0 are left."""
    def at(time: float) -> Frame:
        shown = picture(time)[0] * (1 - time / 7) + SHOTS[kind](time) * time / 7
        return Frame({Role.COLOUR: shown.astype(np.float32)}, number=1)

    frames, last = [at(time) for time in range(8)], None
    worse = []
    for time in range(7):
        last = Between(*frames[time:time + 3], last=last)
        wanted = at(time + 0.5)[Role.COLOUR]
        mean = (last.before[Role.COLOUR] + last.after[Role.COLOUR]) / 2
        worse.append(psnr(mean, wanted) - psnr(last.frame(0.5)[Role.COLOUR], wanted))
    assert max(worse) < 4.2


def test_parts_of_a_dissolve_between_shots_that_stand_still_are_exact():
    def at(time: float) -> Frame:
        parts = {"key": texture(X, Y, 3) * (1 - time / 8), "fill": texture(X, Y, 12) * time / 8}
        parts = {name: part.astype(np.float32) for name, part in parts.items()}
        return Frame({Role.COLOUR: sum(parts.values()),
                      Role.MOTION: np.zeros((HEIGHT, WIDTH, 2), np.float32)}, parts=parts)

    found = Between(at(3), at(4)).frame(0.25)
    for name, part in at(3.25).parts.items():
        np.testing.assert_allclose(found.parts[name], part, atol=2e-6)


def test_parts_that_do_not_add_up_keep_their_own_light():
    """One brighter than the picture, such as light before it is filtered."""
    pair = [replace(one, parts={"other": 3 * one[Role.COLOUR]}) for one in (frame(0), frame(1))]
    found = Between(*pair).frame(0.5)
    assert abs(found.parts["other"].mean() / pair[0].parts["other"].mean() - 1) < 0.02

"""Pixels that are no number are counted and mended, stay local, and are forgotten."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.repair import repair_nonfinite
from postfx.runtime import Device
from postfx.system import Scratch
from tests.stress.bounds import bounds
from tests.stress.scenes import colours, display_psnr, on, pipeline

BAD = (np.nan, np.inf, -np.inf)
AT = 2
"""Frame that is broken."""
FIREFLY = 1e6


def changed(frame: Frame, role: Role, value: float,
            place: tuple[slice | int, ...] = (slice(None),)) -> Frame:
    plane = frame[role].copy()
    plane[place] = value
    return replace(frame, planes={**frame.planes, role: plane})


def with_broken(frames: list[Frame], value: float,
                place: tuple[slice | int, ...] = (slice(None),)) -> list[Frame]:
    return [changed(frame, Role.COLOUR, value, place) if n == AT else frame
            for n, frame in enumerate(frames)]


def difference(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(height, width): change of light by the light at the place, or by a twentieth of the mean
    where it is darker."""
    return np.abs(found - wanted).max(2) / np.maximum(wanted.max(2), wanted.mean() / 20)


@pytest.mark.parametrize("value", BAD, ids=str)
def test_pixels_are_mended_by_the_mean_of_their_neighbours(value: float) -> None:
    colour = np.random.default_rng(1).random((9, 11, 3), np.float32)
    broken = colour.copy()
    broken[4, 5, 1] = broken[0, 0] = value
    found, counts = repair_nonfinite(Frame({Role.COLOUR: broken}), (Role.COLOUR,))
    around = [colour[4 + y, 5 + x] for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]
    np.testing.assert_allclose(found[Role.COLOUR][4, 5], np.mean(around, axis=0), rtol=1e-6)
    np.testing.assert_allclose(found[Role.COLOUR][0, 0],
                               (colour[0, 1] + colour[1, 0] + colour[1, 1]) / 3, rtol=1e-6)
    assert counts == {Role.COLOUR: 2}
    unchanged = np.ones((9, 11), bool)
    unchanged[4, 5] = unchanged[0, 0] = False
    np.testing.assert_array_equal(found[Role.COLOUR][unchanged], colour[unchanged])
    assert not np.isfinite(broken[4, 5, 1])  # the frame that was given is as it was


def test_pixels_are_mended_within_a_budget() -> None:
    colour = np.random.default_rng(1).random((600, 800, 3), np.float32)
    colour[5, 5], colour[599, 7] = np.nan, np.inf
    frame = Frame({Role.COLOUR: colour})
    found, wanted = (repair_nonfinite(frame, (Role.COLOUR,), scratch)
                     for scratch in (Scratch("1M"), None))
    np.testing.assert_array_equal(found[0][Role.COLOUR], wanted[0][Role.COLOUR])
    assert found[1] == wanted[1] == {Role.COLOUR: 2} and np.isfinite(found[0][Role.COLOUR]).all()


def test_a_sun_that_overflowed_keeps_its_shape() -> None:
    colour = np.ones((40, 40, 3), np.float32)
    y, x = np.mgrid[:40, :40]
    sun = (y - 20) ** 2 + (x - 20) ** 2 < 60
    colour[sun] = np.inf
    found, counts = repair_nonfinite(Frame({Role.COLOUR: colour}), (Role.COLOUR,))
    np.testing.assert_array_equal(found[Role.COLOUR], colour)
    assert counts == {Role.COLOUR: int(sun.sum())}


def test_small_blocks_are_repaired_from_the_rim() -> None:
    """Blocks of up to 4 x 4 pixels come out as the slope around them; larger ones, and lines two
    wide, stay."""
    y, x = np.mgrid[:60, :60].astype(np.float32)
    slope = np.stack([1 + 0.05 * x, 2 + 0.03 * y, 1 + 0.02 * (x + y)], -1)
    for value in BAD:
        broken = slope.copy()
        for size in (2, 3, 4):
            broken[10 * size : 10 * size + size, 20 : 20 + size] = value
        # at the picture's edge, and a pair
        broken[0:2, 0:2] = broken[0:4, 56:60] = broken[12:14, 40] = value
        broken[45:50, 40:45] = broken[54:56, 5:25] = value
        repaired, _ = repair_nonfinite(Frame({Role.COLOUR: broken}), (Role.COLOUR,))
        found, stays = repaired[Role.COLOUR], np.zeros((60, 60), bool)
        stays[45:50, 40:45] = stays[54:56, 5:25] = True
        np.testing.assert_array_equal(~np.isfinite(found).all(2), stays)
        assert np.abs(found[10:45] / slope[10:45] - 1).max() < 0.03
        # a corner has a rim on two sides only
        assert np.abs(found[:4] / slope[:4] - 1).max() < 0.08


def test_frames_without_bad_pixels_are_passed_on_and_misses_do_not_count() -> None:
    planes = {Role.COLOUR: np.ones((300, 4, 3), np.float32),
              Role.DEPTH: np.full((300, 4, 1), np.inf, np.float32)}
    frame = Frame(planes)
    found, counts = repair_nonfinite(frame, tuple(planes))
    assert found is frame and counts == {}
    planes[Role.DEPTH][299, 3] = np.nan
    assert repair_nonfinite(Frame(planes), tuple(planes))[1] == {Role.DEPTH: 1}
    assert repair_nonfinite(Frame(planes), (Role.COLOUR,))[1] == {}


def test_unknown_motion_does_not_count_and_is_none_to_passes() -> None:
    motion = np.ones((4, 5, 2), np.float32)
    motion[1, 2] = np.nan
    frame = Frame({Role.MOTION: motion})
    found, counts = repair_nonfinite(frame, (Role.MOTION,))
    assert counts == {} and (found[Role.MOTION][1, 2] == 0).all() and found[Role.MOTION].sum() == 38
    assert np.isnan(motion[1, 2]).all(), "the given frame stays"
    motion[3, 3, 0] = np.inf
    found, counts = repair_nonfinite(frame, (Role.MOTION,))
    assert counts == {Role.MOTION: 1} and (found[Role.MOTION][3, 3] == 0).all()


@pytest.mark.parametrize("value", BAD, ids=str)
@on()
def test_a_bad_pixel_stays_local(model: str, value: float, rooms: list[Frame],
                                 device: Device) -> None:
    place = (48, 80)
    found, wanted = (colours(frames[: AT + 1], model, device)[AT]
                     for frames in (with_broken(rooms, value, place), rooms))
    change, held_to = difference(found, wanted), bounds(device, model)
    y, x = np.mgrid[: change.shape[0], : change.shape[1]]
    far = np.maximum(np.abs(y - 2 * place[0]), np.abs(x - 2 * place[1])) > held_to.reach
    print(f"{device.name} {model}: change {change.max():.2g}, far {change[far].max():.2g}")
    assert 0 < change.max() < held_to.local
    assert change[far].max() < held_to.far


@pytest.mark.parametrize("value", BAD, ids=str)
@on()
def test_a_frame_without_a_number_is_forgotten(
    model: str, value: float, rooms: list[Frame], device: Device
) -> None:
    """What comes after it is as if the sequence began there, to the bit, and soon as if it had not
    been."""
    unbroken = colours(rooms, model, device)
    after = colours(with_broken(rooms, value), model, device)
    fresh = colours(rooms[AT + 1 :], model, device)
    assert all(np.isfinite(picture).all() for picture in after)
    assert all(np.array_equal(*pair) for pair in zip(after[AT + 1 :], fresh, strict=True))
    assert display_psnr(after[-1], unbroken[-1]) > 40


@on()
def test_a_firefly_does_not_stay(model: str, rooms: list[Frame], device: Device) -> None:
    """It cannot be told from light; what it adds around it fades."""
    place, around = (48, 80), (slice(64, 130), slice(128, 194))
    unbroken, after = (colours(frames, model, device)
                       for frames in (rooms, with_broken(rooms, FIREFLY, place)))
    first, last = (np.abs(after[n] - unbroken[n])[around].sum() for n in (AT, len(rooms) - 1))
    assert last < first / 2
    assert display_psnr(after[-1], unbroken[-1]) > 40


def test_bad_pixels_are_counted(rooms: list[Frame], device: Device) -> None:
    chain = pipeline("s.fp32", device)
    chain(rooms[0])
    assert chain.bad_pixels == {}
    frame = changed(changed(rooms[1], Role.COLOUR, np.nan, (slice(3, 5), 7)), Role.NORMAL, np.inf,
                    (0, 0, 1))
    chain(frame)
    assert chain.bad_pixels == {Role.COLOUR: 2, Role.NORMAL: 1}
    chain(rooms[2])
    assert chain.bad_pixels == {}

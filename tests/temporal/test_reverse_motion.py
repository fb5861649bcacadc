"""Motion turned round, and how long pixels have been in sight, on scenes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.frame import Frame, Role
from postfx.temporal.reverse_motion import (
    LONGEST_HISTORY_FRAMES,
    LOST,
    HistoryLength,
    motion_to_next,
    reverse_motion,
)

HEIGHT, WIDTH = 20, 30


def moving(motion: tuple[float, float], depth: float = 4.0, size: tuple[int, int] = (HEIGHT, WIDTH),
           **kept) -> Frame:
    """A wall that moves by `motion` (towards where it was) all over the picture."""
    planes = {Role.COLOUR: np.ones((*size, 3)), Role.DEPTH: np.full((*size, 1), depth),
              Role.MOTION: np.broadcast_to(np.float64(motion), (*size, 2))}
    return Frame({role: np.ascontiguousarray(plane, np.float32) for role, plane in planes.items()},
                 **kept)


@pytest.mark.parametrize("motion", [(0, 0), (3, -2), (-1.25, 4.5), (0.4, 0.4)])
def test_a_moving_wall_comes_from_where_it_goes(motion):
    found = motion_to_next(moving((0, 0)), moving(motion))
    y, x = np.indices((HEIGHT, WIDTH))
    shown = ((0 <= x - motion[0]) & (x - motion[0] <= WIDTH - 1) & (0 <= y - motion[1])
             & (y - motion[1] <= HEIGHT - 1))
    np.testing.assert_array_equal(found[shown],
                                  np.broadcast_to(-np.float32(motion), (shown.sum(), 2)))


def test_what_the_next_frame_does_not_show_leads_out_of_the_picture():
    found = motion_to_next(moving((0, 0)), moving((8, 0)))
    assert (found[:, :5] == LOST).all()
    assert (found[:, 8:, 0] == -8).all()


def test_the_nearer_of_two_surfaces_counts():
    """A thing moves 6 pixels to the right over a wall at rest: where it was, it is what comes from
    there."""
    frame, after = moving((0, 0)), moving((0, 0))
    frame[Role.DEPTH][5:10, 4:10], after[Role.DEPTH][5:10, 10:16] = 1, 1
    after[Role.MOTION][5:10, 10:16] = -6, 0
    found = motion_to_next(frame, after)
    assert (found[5:10, 4:10] == (6, 0)).all()
    assert (found[5:10, 10:16] == LOST).any()  # wall that the thing hides in the next frame
    assert (found[12:] == 0).all()


def test_the_nearer_of_two_surfaces_counts_whichever_comes_first():
    """The same to the left: there the wall is looked at after the thing."""
    frame, after = moving((0, 0)), moving((0, 0))
    frame[Role.DEPTH][5:10, 10:16], after[Role.DEPTH][5:10, 4:10] = 1, 1
    after[Role.MOTION][5:10, 4:10] = 6, 0
    assert (motion_to_next(frame, after)[5:10, 10:16] == (-6, 0)).all()


def test_stretching_leaves_no_cracks():
    """A camera that comes nearer by 4 % a frame: pixels of the next frame come from closer together
    than they lie."""
    after = moving((0, 0))
    y, x = np.indices((HEIGHT, WIDTH), np.float32)
    after[Role.MOTION][..., 0], after[Role.MOTION][..., 1] = (x - 15) * 0.04, (y - 10) * 0.04
    found = motion_to_next(moving((0, 0)), after)
    assert (found[2:-2, 2:-2] != LOST).all()
    assert np.abs(found[2:-2, 2:-2, 0] + (x - 15)[2:-2, 2:-2] * 0.04).max() < 0.1


def test_frames_may_change_their_size():
    found = motion_to_next(moving((0, 0), size=(10, 15)), moving((4, 2)))
    assert (found[2:-3, 3:-3] == (-2, -1)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_broken_motion_and_depth_harm_no_neighbour(value):
    after = moving((2, 0))
    after[Role.MOTION][7, 7], after[Role.DEPTH][9, 9] = value, value
    found = motion_to_next(moving((0, 0)), after)
    assert np.isfinite(found).all()
    assert (found[:, 4:-3] == (-2, 0)).all()


def test_a_cut_and_the_end_begin_anew():
    frame, after = moving((1, 1), number=3), moving((1, 1), number=4)
    assert reverse_motion(frame, None).reset
    assert reverse_motion(frame, moving((1, 1), reset=True)).reset
    # its own cut lies at its other side
    assert not reverse_motion(moving((1, 1), reset=True), after).reset
    assert reverse_motion(frame,
                          Frame({Role.COLOUR: np.ones((HEIGHT, WIDTH, 3), np.float32)})).reset


def test_without_depth_motion_is_turned_all_the_same():
    frames = [moving((2, 1)), moving((2, 1))]
    for frame in frames:
        del frame.planes[Role.DEPTH]
    assert (motion_to_next(*frames)[3:-3, 3:-3] == (-2, -1)).all()


def test_frames_in_sight_are_counted_up_to_a_limit():
    lengths = HistoryLength()
    for number in range(1, LONGEST_HISTORY_FRAMES + 4):
        count = lengths(moving((0, 0)))
        assert (count == min(number, LONGEST_HISTORY_FRAMES)).all()


def test_what_comes_into_the_picture_counts_from_one():
    lengths = HistoryLength()
    # the wall moves to the left, new wall comes in at the right
    counts = [lengths(moving((3, 0))) for _ in range(4)]
    assert (counts[3][0] == np.repeat([4, 3, 2, 1], [WIDTH - 9, 3, 3, 3])).all()


def test_what_something_nearer_had_hidden_counts_from_one():
    lengths, hidden, free = HistoryLength(), moving((0, 0)), moving((0, 0))
    hidden[Role.DEPTH][5:12, 5:12] = 1
    lengths(hidden)
    count = lengths(free)
    assert (count[7:10, 7:10] == 1).all()
    assert (count[14:] == 2).all()


def test_a_cut_that_only_the_pictures_tell_counts_from_one():
    """Both pictures have one depth and no motion, but nothing else in common."""
    pictures = [moving((0, 0), size=(64, 96)) for _ in range(2)]
    for picture, seed in zip(pictures, (1, 2), strict=True):
        blocks = np.random.default_rng(seed).random((8, 12, 1)).repeat(8, 0).repeat(8, 1)
        picture[Role.COLOUR][:] = 0.05 + blocks**3
    for find_cuts, expected in ((True, 1), (False, 2)):
        lengths = HistoryLength(find_cuts)
        lengths(pictures[0])
        assert (lengths(pictures[1]) == expected).all()


def test_a_cut_counts_from_one():
    lengths = HistoryLength()
    lengths(moving((0, 0)))
    assert (lengths(moving((0, 0), reset=True)) == 1).all()
    lengths.reset()
    assert (lengths(moving((0, 0))) == 1).all()


def test_frames_may_come_in_the_same_arrays():
    one, other = HistoryLength(), HistoryLength()
    frame = moving((0, 0))
    for number in range(3):
        wanted = other(moving((0, 0), depth=4 + number))
        frame[Role.DEPTH][:] = 4 + number
        np.testing.assert_array_equal(one(frame), wanted)
        frame[Role.DEPTH][:] = 1000

"""What is kept of a sequence: numbers of all frames, pictures of a few, changes along the
motion."""

import numpy as np
import pytest

from postfx.tools.report.charts import charts
from postfx.tools.report.frame_log import LONGEST_SIDE_PX, FrameLog, Look, measure_change
from postfx.tools.report.pictures import encode_light

SCENE, DISPLAY = Look(False), Look(True)
STILL = np.zeros((8, 12, 2), np.float32)


def picture(value=0.5, size=(16, 24)):
    return np.full((*size, 3), value, np.float32)


def textured(size=(40, 60), seed=1):
    return np.random.default_rng(seed).random((*size, 3), np.float32)


def test_what_moves_along_does_not_change():
    before = textured()
    motion = np.zeros((20, 30, 2), np.float32)
    motion[..., 0] = -1  # of its own pixels: two of the picture's
    now = np.roll(before, 2, axis=1)
    assert measure_change(before, now, motion, lambda light: light) == pytest.approx(0, abs=1e-4)
    assert measure_change(before, now, 0 * motion, lambda light: light) > 100


def test_a_step_is_measured_and_a_fifth_of_the_picture_is_left_out():
    before, now = picture(), picture(0.53)
    now[:2] = 50
    assert measure_change(before, now, STILL, lambda light: light) == pytest.approx(30, rel=1e-3)


def test_nothing_is_said_of_other_sizes_and_of_what_comes_from_outside():
    assert measure_change(picture(), picture(size=(8, 12)), STILL, lambda light: light) is None
    assert measure_change(picture(), picture(), STILL + 100, lambda light: light) is None


def test_pictures_of_four_frames_are_kept_however_many_there_are():
    log = FrameLog(range(1, 41), SCENE, "after")
    for number in range(1, 41):
        level = 0.5 + 0.001 * number + (0.3 if number == 31 else 0.1 if number == 7 else 0)
        log.add(number, {"before": picture(), "after": picture(level)}, 1.0, STILL)
        assert len(log._sights) <= 4
    found = {frame["number"]: frame["why"] for frame in log.frames()}
    assert found == {1: "first", 21: "middle", 31: "least steady", 40: "last"}
    assert len(log.rows) == 40 and set(log.frames()[0]["pictures"]) == {"before", "after"}


def test_one_frame_may_be_chosen_for_two_reasons_and_two_frames_are_first_and_last():
    log = FrameLog([5, 6], SCENE, "after")
    for number, level in ((5, 0.5), (6, 0.6)):
        log.add(number, {"after": picture(level)}, 2.0, STILL)
    assert [frame["why"] for frame in log.frames()] == ["first", "last, least steady"]
    assert [frame["exposure_ev"] for frame in log.frames()] == [1.0, 1.0]


def test_cuts_break_the_curve():
    log = FrameLog([1, 2, 3, 4], SCENE, "after")
    for number in (1, 2, 3, 4):
        log.add(number, {"after": picture(number / 4)}, 1.0, STILL, cut=number == 3,
                readings={"exposure used": 0.5})
    values = [row.readings["change after"] for row in log.rows]
    assert values[0] is values[2] is None and values[1] > 0 and values[3] > 0
    first, second = charts(log.rows)
    assert first["curves"] == {"after": values} and second["curves"] == {"used": [0.5] * 4}


def test_a_curve_of_one_value_is_none():
    log = FrameLog([1, 2], SCENE, "after")
    for number in (1, 2):
        log.add(number, {"after": picture()}, 1.0, STILL)
    assert charts(log.rows) == []


def test_large_frames_are_reduced_and_the_exposure_is_in_the_codes():
    log = FrameLog([1], SCENE, "after")
    log.add(1, {"after": picture(0.5, (900, 1600))}, 4.0, maps={"FLIP": picture(1.0, (900, 1600))})
    (frame,) = log.frames()
    packed = frame["pictures"]["after"]
    assert (frame["size"] == (1600, 900)
            and (packed["width"], packed["height"]) == (LONGEST_SIDE_PX, 450))
    assert (log._sights[1].pictures["after"]
            == encode_light(picture(2.0, (1, 1)), SCENE.highest)[0, 0]).all()
    assert (log._sights[1].maps["FLIP"].shape == (450, 800, 3)
            and (log._sights[1].maps["FLIP"] == 255).all())


def test_light_of_a_display_is_not_exposed_again():
    assert np.array_equal(DISPLAY.expose(picture(), 4.0), picture())
    assert DISPLAY.codes(picture(2.0), 4.0).max() == pytest.approx(1) and DISPLAY.highest == 1

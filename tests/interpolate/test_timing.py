"""Times, numbers, frame rates and time codes of sequences with frames between frames."""

from __future__ import annotations

from fractions import Fraction

import pytest

from postfx.errors import OptionError
from postfx.interpolate.timing import Moment, as_rate, make_code, parse_times, read_code

NTSC, FILM = Fraction(30000, 1001), Fraction(24)


def test_twice_as_many_frames_are_numbered_on():
    found = list(parse_times("2").moments([1001, 1002, 1003]))
    assert found == [Moment(1001, 0, 0, 0), Moment(1002, 0, 0.5, 0), Moment(1003, 1, 0, 0.5),
                     Moment(1004, 1, 0.5, 0), Moment(1005, 2, 0, 0.5)]


def test_24_to_60_frames_a_second_keep_every_second_of_the_old_ones():
    found = list(parse_times(None, "24:60").moments([1, 2, 3]))
    assert [(moment.number, moment.start, moment.t) for moment in found] == [
        (1, 0, 0), (2, 0, 0.4), (3, 0, 0.8), (4, 1, pytest.approx(0.2)), (5, 1, pytest.approx(0.6)),
        (6, 2, 0)]
    assert found[3].previous == pytest.approx(-0.2), ("the new frame before lies in the interval "
                                                      "before")
    assert found[5].previous == pytest.approx(0.6)


def test_times_of_ones_own_choice_have_no_rate():
    times = parse_times("0.25,0.5")
    assert [moment.t for moment in times.moments([1, 2])] == [0, 0.25, 0.5, 0]
    known = {"framesPerSecond": 24.0, "timeCode": (0, 0), "owner": "me"}
    assert times.header(known, 1, known) == {"owner": "me"}


@pytest.mark.parametrize(("times", "rates", "message"), [
    ("1", None, "2 to 64"), ("0.5,1.5", None, "1.5 is not between"),
    ("a", None, "'a' is no number"), (None, "60:24", "24 is not above 60"),
    ("2", "24:60", "both say"), (None, "0", "no number above 0")])
def test_what_cannot_be_is_said(times, rates, message):
    with pytest.raises(OptionError, match=message):
        parse_times(times, rates)


@pytest.mark.parametrize(("frames", "code"), [
    (0, 0x00000000), (1799, 0x00005929), (1800, 0x00010002), (17981, 0x00095929),
    (17982, 0x00100000), (107892, 0x01000000)])
def test_dropped_frame_numbers_keep_up_with_the_clock(frames, code):
    """Numbers 0 and 1 of each minute are left out, but not of each tenth (SMPTE ST 12-1)."""
    assert make_code(frames, NTSC, drop=True) == code | 1 << 6
    assert read_code(code | 1 << 6, NTSC) == frames


@pytest.mark.parametrize(("rate", "drop"),
                         [(FILM, False), (Fraction(25), False), (Fraction(48), False), (NTSC, True),
                          (Fraction(60000, 1001), True), (Fraction(24000, 1001), False)])
def test_codes_are_read_as_they_are_made(rate, drop):
    for frames in range(0, 80 * 3600, 37):
        assert read_code(make_code(frames, rate, drop), rate) == frames


def test_a_time_code_goes_on_at_the_new_rate():
    """01:00:00:12 at 24 is 01:00:00:24 at 48, which is counted in pairs: 12; the field bit tells
    the second of one."""
    first = {"framesPerSecond": 24.0, "timeCode": (0x01000012, 7)}
    found = [parse_times("2").header(first, count, first) for count in range(3)]
    assert [one["framesPerSecond"] for one in found] == [48.0] * 3
    assert [one["timeCode"] for one in found] == [(0x01000012, 7), (0x01000012 | 1 << 15, 7),
                                                  (0x01000013, 7)]


def test_without_a_rate_there_is_no_time_code_and_above_60_none_either():
    first = {"timeCode": (0x01000012, 0), "owner": "me"}
    assert parse_times("2").header(first, 1, first) == {"owner": "me"}
    assert parse_times("2", "24").header(first, 0, first)["timeCode"] == (0x01000012, 0)
    assert "timeCode" not in parse_times("4", "24").header(first, 1, first)


def test_broadcast_rates_are_exact():
    assert (as_rate(23.976) == Fraction(24000, 1001) and as_rate(29.97002997) == NTSC
            and as_rate(25.0) == 25)
    assert as_rate("fast") is None and as_rate(0.0) is None

"""Patterns, ranges, folders and holes."""

import os
import pickle
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from postfx.errors import MissingFrameError, SequenceError, WriteError
from postfx.frame import Role
from postfx.io.pattern import format_frames, locate, parse_frames, parse_pattern
from postfx.io.sequence import read_sequence
from postfx.io.writer import OutputFiles


@pytest.fixture
def shot(write_exr, tmp_path: Path):
    """Writes frames of one channel value each and gives their folder."""

    def write(*numbers: int, name: str = "shot.{:04d}.exr") -> Path:
        for number in numbers:
            write_exr(name.format(number), {c: np.full((2, 3), number, np.float32) for c in "RGB"})
        return tmp_path

    return write


@pytest.mark.parametrize("number", ["%04d", "####", "@@@@", "$F4", "<F4>"])
def test_all_spellings_of_the_frame_number(shot, number):
    frames = list(read_sequence(f"{shot(1, 2, 3)}/shot.{number}.exr"))
    assert [frame.number for frame in frames] == [1, 2, 3]
    assert [frame[Role.COLOUR][0, 0, 0] for frame in frames] == [1, 2, 3]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [("a.%d.exr", "a.7.exr"), ("a.#.exr", "a.7.exr"), ("d/a_$F3.exr", "d/a_007.exr"),
     ("####.exr", "0007.exr")],
)
def test_frame_numbers_are_padded_as_the_pattern_says(pattern, expected):
    assert parse_pattern(pattern).path(7) == Path(expected)


@pytest.mark.parametrize("source", ["shot.####.exr", ".", "shot.0003.exr", "shot.*.exr",
                                    ["shot.0003.exr", "shot.0001.exr"]])
def test_a_pickled_sequence_begins_anew(source, shot, monkeypatch):
    """As where frames are shared among processes."""
    monkeypatch.chdir(shot(1, 2, 3))
    sequence = read_sequence(source, colourspace="acescg")
    first = [frame[Role.COLOUR].tolist() for frame in sequence]
    copied = pickle.loads(pickle.dumps(sequence))
    assert repr(copied) == repr(sequence)
    assert [frame[Role.COLOUR].tolist() for frame in copied] == first


def test_negative_frames_keep_their_digits():
    assert parse_pattern("a.####.exr").path(-3) == Path("a.-0003.exr")


def test_two_numbers_in_a_name_are_refused():
    with pytest.raises(SequenceError, match="give the frame number once"):
        parse_pattern("a.####.%04d.exr")


@pytest.mark.parametrize("name", ["shots #12", "a@@b", "take %04d", "$F4", "{view}", "{plane}",
                                  "%V", "[x]*?"])
def test_signs_in_the_name_of_a_folder_that_is_there_are_part_of_it(name, shot, tmp_path):
    """Also where a wildcard in its place would fit another folder."""
    folder, beside = tmp_path / name, tmp_path / "another shot"
    folder.mkdir()
    beside.mkdir()
    for path in shot(1, 2).glob("*.exr"):
        (beside / path.name).write_bytes(path.read_bytes())
        path.rename(folder / path.name)
    for source in (folder, f"{folder}/shot.####.exr", f"{folder}/shot.*.exr",
                   [folder / "shot.0001.exr"]):
        sequence = read_sequence(source)
        numbers = [1] if isinstance(source, list) else [1, 2]
        assert [frame.number for frame in sequence] == numbers
        assert sequence.inputs(1) == [folder / "shot.0001.exr"]
    outputs = OutputFiles(f"{folder}/out.####.exr", read_sequence(folder))
    assert outputs.path(2) == folder / "out.0002.exr"
    assert OutputFiles(f"{tmp_path}/new {name}/",
                       read_sequence(folder)).path(2).parent.name == f"new {name}"
    with pytest.raises(WriteError, match="would be a frame of the input"):
        OutputFiles(f"{folder}/shot.0003.exr", read_sequence(f"{folder}/shot.####.exr", frames="1"))


def test_a_number_in_the_name_of_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SequenceError,
                       match=r"once, in the file name, or make the folder '.*shots #12' first"):
        parse_pattern(f"{tmp_path}/shots #12/a.####.exr")


def test_numbers_that_outgrow_their_digits_are_all_read(shot):
    """Frames that nothing pads: 998 is as much one of #### as 1002."""
    folder = shot(*range(998, 1003), name="shot.{}.exr")
    sequence = read_sequence(f"{folder}/shot.####.exr")
    assert ([frame.number for frame in sequence] == [998, 999, 1000, 1001, 1002]
            and not sequence.warnings)


def test_shorter_numbers_beside_padded_ones_are_left_out_and_named(shot):
    folder = shot(7, name="shot.{}.exr")
    shot(1, 2)
    sequence = read_sequence(f"{folder}/shot.####.exr")
    assert sequence.numbers == (1, 2)
    assert [warning.split(":")[0] for warning in sequence.warnings] == ["shot.7.exr"]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [("1-10x3", [1, 4, 7, 10]), ("1,5,7-9", [1, 5, 7, 8, 9]), ("3-1", [1, 2, 3]), ("3,1", [1, 3])],
)
def test_frame_ranges(text, numbers):
    assert parse_frames(text) == numbers


@pytest.mark.parametrize(("text", "right"),
                         [("1-8:4", "1-8x4"), ("1-100,2-9:3", "2-9x3"), ("1-8y2", "1-8x2")])
def test_steps_of_other_kinds_are_refused(text, right):
    with pytest.raises(SequenceError, match=f"a step is written with x.*give {right}"):
        parse_frames(text)


@pytest.mark.parametrize("text", ["1-8", "1-9x2", "4,7-9", "-3--1", "12"])
def test_frames_are_told_as_they_are_read(text):
    assert format_frames(reversed(parse_frames(text))) == text


@pytest.mark.parametrize("text", ["1-", "a-b", "", "1..5"])
def test_malformed_ranges(text):
    with pytest.raises(SequenceError, match="--frames"):
        parse_frames(text)


@pytest.mark.parametrize("name", ["n.{:04d}.exr", "n_{:04d}.exr", "{:04d}.exr"])
@pytest.mark.parametrize("signed", ["-{:04d}", "-{:03d}"],
                         ids=["beside the digits", "among the digits"])
def test_frames_before_zero_are_in_order_of_time(shot, tmp_path, name, signed):
    """However wide a program makes a number with a minus, in a folder, by a pattern and by one
    file's name."""
    shot(0, 1, name=name)
    for number in (-2, -1):
        shot(number, name=name.replace("{:04d}", signed.format(-number)))
    for source in (tmp_path, tmp_path / name.replace("{:04d}", "%04d")):
        frames = list(read_sequence(source))
        assert ([frame.number for frame in frames] == [-2, -1, 0, 1]
                and not any(frame.reset for frame in frames))
        assert [frame[Role.COLOUR][0, 0, 0] for frame in frames] == [-2, -1, 0, 1]
    (frame,) = read_sequence(tmp_path / name.replace("{:04d}", signed.format(2)))
    assert frame.number == -2
    for path in tmp_path.glob("*00[01].exr"):
        if "-" not in path.name:
            path.unlink()
    assert [frame.number for frame in read_sequence(tmp_path)] == [-2, -1]


def test_a_hyphen_before_a_number_is_no_minus(shot):
    assert [frame.number for frame in read_sequence(shot(1, 2, name="shot-{:04d}.exr"))] == [1, 2]


def test_iterations_do_not_make_cuts_in_each_other(shot):
    sequence = read_sequence(f"{shot(1, 2, 3, 4)}/shot.####.exr")
    assert [(one.reset, other.reset)
            for one, other in zip(sequence, sequence, strict=True)] == [(False, False)] * 4
    assert [frame.reset for frame in sequence if list(sequence) and sequence.read(1)] == [False] * 4
    frames = iter(sequence)
    assert [next(frames).reset, next(frames).reset, sequence.read(4).reset] == [False, False, True]


def test_frames_are_whole_numbers(shot):
    with pytest.raises(SequenceError, match="whole number"):
        read_sequence(f"{shot(1, 2)}/shot.####.exr", frames=[1.5])


def test_a_hole_is_reported_by_name_when_it_is_reached(shot):
    frames = iter(read_sequence(f"{shot(1, 2, 4)}/shot.####.exr"))
    assert [next(frames).number, next(frames).number] == [1, 2]
    with pytest.raises(MissingFrameError, match=r"shot\.0003\.exr: frame 3 is missing"):
        next(frames)


def test_frames_beyond_the_disk_are_reported(shot):
    with pytest.raises(MissingFrameError, match=r"shot\.0005\.exr"):
        list(read_sequence(f"{shot(1, 2)}/shot.####.exr", frames="5"))


def test_a_sequence_on_twos_has_no_holes(shot):
    frames = list(read_sequence(f"{shot(1, 3, 5, 7)}/shot.####.exr"))
    assert [frame.number for frame in frames] == [1, 3, 5, 7]
    assert not any(frame.reset for frame in frames)


def test_leaving_frames_out_is_a_cut(shot):
    sequence = read_sequence(f"{shot(1, 2, 3, 4, 5)}/shot.####.exr", frames="1-2,4-5")
    assert [frame.reset for frame in sequence] == [False, False, True, False]
    assert "the history begins anew" in sequence.warnings[0]


def test_a_cut_of_the_header_is_one_cut(write_exr):
    for number in (1, 2, 3, 4):
        write_exr(f"shot.{number:04d}.exr", {name: np.ones((4, 6)) for name in "RGB"},
                  postfx__reset=number in (1, 3))
    sequence = read_sequence(write_exr("shot.0005.exr", {name: np.ones((4, 6)) for name in "RGB"})
                             .parent)
    for _ in range(2):
        assert [sequence.read(number).reset for number in sequence.numbers] == [True, False, True,
                                                                                False, False]


def test_folder_single_file_and_first_file(shot):
    folder = shot(3, 4)
    assert [frame.number for frame in read_sequence(folder)] == [3, 4]
    assert [frame.number for frame in read_sequence(folder / "shot.0004.exr")] == [4]
    assert [frame.number
            for frame in read_sequence(folder / "shot.0003.exr", frames="3-4")] == [3, 4]


def test_single_file_without_number(write_exr, ramp):
    assert [frame.number
            for frame in read_sequence(write_exr("still.exr", ramp("R", "G", "B")))] == [1]


def test_folder_of_several_sequences_asks_for_one(shot):
    shot(1, name="a.{:04d}.exr")
    with pytest.raises(SequenceError,
                       match=r"holds 2 sequences \(a\.####\.exr, b\.####\.exr\): name one"):
        read_sequence(shot(1, name="b.{:04d}.exr"))


def test_nothing_there(tmp_path):
    with pytest.raises(SequenceError, match="no such file"):
        read_sequence(tmp_path / "x.####.exr")
    with pytest.raises(SequenceError, match="holds no OpenEXR file"):
        read_sequence(tmp_path)


@pytest.mark.parametrize("layout",
                         ["{plane}.%04d.exr", "{plane}/shot.%04d.exr", "shot_{plane}.%04d.exr"])
def test_one_file_a_plane(write_exr, tmp_path, ramp, layout):
    colour, normal = ramp("R", "G", "B"), ramp("X", "Y", "Z")
    for number in (1, 2):
        write_exr(layout.replace("{plane}", "beauty") % number, colour)
        write_exr(layout.replace("{plane}", "normal") % number, normal)
        write_exr(layout.replace("{plane}", "depth") % number,
                  {"R": np.full((6, 8), 5, np.float32)})
    frames = list(read_sequence(f"{tmp_path}/{layout}"))
    assert [frame.number for frame in frames] == [1, 2]
    np.testing.assert_array_equal(frames[1][Role.NORMAL][:, :, 0], normal["X"])
    np.testing.assert_array_equal(frames[1][Role.COLOUR][:, :, 0], colour["R"])
    assert frames[1][Role.DEPTH][0, 0, 0] == 5


def test_folder_with_one_file_a_plane(write_exr, tmp_path, ramp):
    write_exr("beauty.0001.exr", ramp("R", "G", "B"))
    write_exr("specular_albedo.0001.exr", ramp("R", "G", "B"))
    (frame,) = read_sequence(tmp_path)
    assert set(frame.planes) == {Role.COLOUR, Role.SPECULAR_ALBEDO}


def test_frames_before_a_frame_stop_at_a_hole(shot):
    sequence = read_sequence(f"{shot(1, 3, 4, 5, 6)}/shot.####.exr", frames="6")
    assert sequence.before(6, 2) == [4, 5]
    assert sequence.before(6, 8) == [3, 4, 5]
    assert sequence.before(3, 8) == []


def test_frames_after_a_frame_stop_at_a_hole(shot):
    sequence = read_sequence(f"{shot(1, 2, 3, 4, 6)}/shot.####.exr", frames="1")
    assert [sequence.after(1, count) for count in (0, 2, 8)] == [[], [2, 3], [2, 3, 4]]
    assert sequence.after(4, 8) == sequence.after(6, 8) == []


def test_headers_or_cuts_tell_where_shots_begin(write_exr, tmp_path):
    for number in range(1, 4):
        write_exr(f"shot.{number:04d}.exr", {name: np.ones((4, 6)) for name in "RGB"},
                  postfx__reset=number == 2)
    by_header, by_cuts = (read_sequence(tmp_path / "shot.####.exr", cuts=cuts)
                          for cuts in (None, [3]))
    assert [[sequence.begins_shot(number) for number in (1, 2, 3)]
            for sequence in (by_header, by_cuts)] == [
        [False, True, False], [False, False, True]]
    with pytest.raises(MissingFrameError):
        by_header.begins_shot(4)


def test_wildcards_lists_and_the_home_folder(shot, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    shot(1, 2, 4, 5)
    shot(1, name="other.{:04d}.exr")
    (tmp_path / "there").mkdir()
    shutil.copy("shot.0001.exr", "there/shot.0001.exr")
    (tmp_path / "shot.txt").write_text("no picture")
    whole, some = (1, 2, 3, 4, 5), (1, 2)
    files = [f"shot.000{number}.exr" for number in (1, 2, 4, 5)]
    for source, numbers in [
        ("shot.*.exr", whole), ("sho?.####.exr", whole), ("shot.*", whole), ("~/shot.*.exr", whole),
        ("~/shot.####.exr", whole), (files, whole), ("shot.000[12].exr", some), (files[:2], some),
        ([f"~/{name}" for name in files[1::-1]], some), (files[:1], (1,)),
    ]:
        assert read_sequence(source).numbers == numbers, source
    for source, told in [("*.exr", "holds 2 sequences"), ("no*.exr", "no*.exr: no such file"),
                         ([files[0], "other.0001.exr"], "2 files: holds 2 sequences"),
                         ([files[0], "x.exr"], "x.exr: no such file"),
                         ([files[0], "there/shot.0001.exr"],
                          "(shot.####.exr, there/shot.####.exr): name one")]:
        with pytest.raises(SequenceError, match=re.escape(told)):
            locate(source)
    (tmp_path / "shot.0001.exr").rename(tmp_path / "a[1]*.0001.exr")  # a name means itself first
    assert locate("a[1]*.####.exr")[0].path(1).name == "a[1]*.0001.exr"


def test_a_number_of_numpy_is_a_frame_s(shot):
    pattern = f"{shot(1, 2, 3)}/shot.####.exr"
    for frames in (np.int64(2), 2, [np.uint8(2)], np.array([2])):
        assert read_sequence(pattern, frames=frames).numbers == (2,)
    with pytest.raises(SequenceError, match="a whole number"):
        read_sequence(pattern, frames=np.float32(2))


def test_wildcards_pass_over_what_may_not_be_looked_at(tmp_path, monkeypatch):
    """Linux, for one, refuses to say what some entries of /proc are."""
    (tmp_path / "shut").mkdir()
    (tmp_path / "shot.0001.exr").touch()
    look = os.stat

    def refuse(path, *args, **options):
        if str(path).endswith("shut"):
            raise PermissionError(13, "Permission denied", str(path))
        return look(path, *args, **options)

    monkeypatch.setattr(os, "stat", refuse)
    assert str(locate(tmp_path / "sh*")[0]) == str(tmp_path / "shot.####.exr")


def test_wildcards_that_fit_too_many_folders_end_in_one_line(tmp_path, monkeypatch):
    """So that `/*/*/*/*/shot.####.exr` does not walk through everything that the machine can
    reach."""
    for name in "abc":
        (tmp_path / name / "beauty").mkdir(parents=True)
    (tmp_path / "a" / "beauty" / "shot.0001.exr").touch()
    wild = f"{tmp_path}/*/beauty/shot.####.exr"
    assert str(locate(wild)[0]) == f"{tmp_path}/a/beauty/shot.####.exr"
    monkeypatch.setattr("postfx.io.pattern.MOST_FOLDERS", 2)
    with pytest.raises(SequenceError,
                       match=re.escape(f"{tmp_path}/*: the wildcards fit 3 folders: name more")):
        locate(wild)


@pytest.mark.parametrize("level", ["*/", "{view}/", "a*/b/"])
def test_wildcards_over_thousands_of_levels_fit_nothing(level, tmp_path, monkeypatch):
    """glob.glob calls itself for each level, and Python ends that after a thousand."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SequenceError, match="no such file"):
        read_sequence(level * 3000 + "shot.####.exr")


@pytest.mark.parametrize("spelling", ["%00d", "$F0", "<F0>"])
def test_a_number_has_a_digit_at_least(spelling, tmp_path):
    for name in ("n..exr", "n.7.exr"):
        (tmp_path / name).touch()
    pattern = parse_pattern(f"{tmp_path}/n.{spelling}.exr")
    assert str(pattern).endswith("n.#.exr") and list(pattern.find_frames()) == [7]


@pytest.mark.parametrize("text", ["12345678901", "3,12345678901", "\uff11"])
def test_frames_have_nine_digits_at_most(text):
    with pytest.raises(SequenceError, match="not a frame range"):
        parse_frames(text)


def test_files_beside_those_of_planes_are_another_sequence(tmp_path):
    """All sequences of a folder are planes of one picture, or the folder is refused."""
    for name in ("beauty", "depth", "turntable"):
        (tmp_path / f"{name}.0001.exr").touch()
    with pytest.raises(SequenceError, match="holds 3 sequences"):
        locate(tmp_path)
    (tmp_path / "turntable.0001.exr").unlink()
    assert str(locate(tmp_path)[0]) == f"{tmp_path}/{{plane}}.####.exr"


def test_files_of_one_plane_each_may_have_the_same_channels(write_exr, tmp_path, ramp):
    """Files that are alike share what is known of their parts, not their pixels."""
    planes = {"beauty": ramp("R", "G", "B"),
              "albedo": {name: 1 - plane for name, plane in ramp("R", "G", "B").items()}}
    for number in (1, 2):
        for word, channels in planes.items():
            write_exr(f"{word}.{number:04d}.exr",
                      {name: plane / number for name, plane in channels.items()})
    for frame in read_sequence(str(tmp_path / "{plane}.####.exr")):
        for role, word in ((Role.COLOUR, "beauty"), (Role.DIFFUSE_ALBEDO, "albedo")):
            wanted = np.stack(list(planes[word].values()), -1) / frame.number
            np.testing.assert_allclose(frame[role], wanted, atol=1e-3)

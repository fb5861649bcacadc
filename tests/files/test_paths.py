"""Links, `..`, letter case, names and rights: inputs stay, outputs go where they should, mistakes
get one line."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from postfx.errors import ReadError, SequenceError, WriteError
from postfx.io.pattern import parse_frames, parse_pattern
from postfx.io.sequence import Sequence, read_sequence
from postfx.io.writer import ExistingFiles, OutputFiles, write_frame
from tests.files.conftest import names
from tests.files.exr_files import channel_hashes, write_mixed
from tests.toys import make_frame

REPOSITORY = Path(__file__).resolve().parents[2]


def link(folder: Path) -> str:
    (folder / "link").symlink_to("in", target_is_directory=True)
    return "link/shot.####.exr"


def linked_file(folder: Path) -> str:
    (folder / "out").mkdir()
    (folder / "out/shot.0002.exr").symlink_to("../in/shot.0002.exr")
    return "out/shot.####.exr"


def hard_link(folder: Path) -> str:
    (folder / "out").mkdir()
    os.link(folder / "in/shot.0002.exr", folder / "out/clean.0002.exr")
    return "out/clean.####.exr"


OVER_INPUTS: dict[str, tuple[Callable[[Path], str], str]] = {
    "by the same name": (lambda folder: "in/shot.####.exr", "is an input"),
    "by its folder": (lambda folder: "in/", "is an input"),
    "by dots": (lambda folder: "in/../in/./shot.####.exr", "is an input"),
    "by an absolute path": (lambda folder: f"{folder}/in/shot.%04d.exr", "is an input"),
    "by a linked folder": (link, "is an input"),
    "by a linked file": (linked_file, "is an input"),
    "by a hard link": (hard_link, "is an input"),
    "by letter case": (lambda folder: "in/SHOT.####.EXR", "is an input"),
    "by other digits": (lambda folder: "in/shot.1####.exr", "would be a frame of the input"),
    "by other digits and a link": (lambda folder: link(folder).replace("shot.", "shot.1"),
                                   "would be a frame"),
}


@pytest.mark.parametrize("way", OVER_INPUTS)
def test_inputs_are_never_replaced(postfx, shot, tmp_path: Path, way: str) -> None:
    shot(1, 2)
    before = {path: path.read_bytes() for path in (tmp_path / "in").iterdir()}
    make, message = OVER_INPUTS[way]
    done = postfx("in/shot.####.exr", "-o", make(tmp_path), "--overwrite")
    assert done.code == 2 and message in done.error
    assert {path: path.read_bytes() for path in (tmp_path / "in").iterdir()} == before


def test_an_output_that_is_a_link_is_replaced_and_not_what_it_leads_to(postfx, shot,
                                                                       tmp_path: Path) -> None:
    shot(1)
    (tmp_path / "precious.exr").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/shot.0001.exr").symlink_to("../precious.exr")
    assert postfx("in/", "-o", "out/").code == 2
    assert postfx("in/", "-o", "out/", "--overwrite").code == 0
    assert ((tmp_path / "precious.exr").read_text() == "mine"
            and not (tmp_path / "out/shot.0001.exr").is_symlink())


def test_an_output_that_is_a_link_to_nothing_is_there_already(postfx, shot, tmp_path: Path) -> None:
    shot(1)
    (tmp_path / "out").mkdir()
    (tmp_path / "out/shot.0001.exr").symlink_to("nowhere.exr")
    done = postfx("in/", "-o", "out/")
    assert done.code == 2 and "out/shot.0001.exr: is already there" in done.error


def test_an_output_folder_within_the_input_folder_is_not_read(postfx, shot) -> None:
    shot(1)
    assert postfx("in/", "-o", "in/clean/").code == 0
    assert postfx("in/", "-o", "in/clean/", "--overwrite").code == 0


def test_two_sequences_of_a_folder_that_differ_by_case_are_told_apart(shot, tmp_path: Path) -> None:
    folder = shot(1)
    write_mixed(folder / "SHOT.0001.exr")
    with pytest.raises(SequenceError,
                       match=r"holds 2 sequences \(SHOT\.####\.exr, shot\.####\.exr\): name one"):
        read_sequence(folder)


def test_two_files_of_one_frame_are_told(shot) -> None:
    folder = shot(1)
    write_mixed(folder / "shot.00001.exr")
    with pytest.raises(SequenceError,
                       match=r"shot\.00001\.exr and shot\.0001\.exr: both are frame 0+1: remove "
                       r"one"):
        read_sequence(folder / "shot.####.exr")


def test_hidden_files_are_no_frames(shot) -> None:
    folder = shot(1)
    (folder / ".shot.0002.exr").write_bytes(b"left behind")
    (folder / ".shot.0002.exr.host-1-0.part").write_bytes(b"left behind")
    assert read_sequence(folder).numbers == (1,)


@pytest.mark.parametrize("name", ["a b.####.exr", "ä-日本.####.exr", "-dash.####.exr",
                                  "100%.####.exr", "[x]*?.####.exr", "'quote\".####.exr",
                                  "new\nline.####.exr", "x" * 240 + ".####.exr"])
def test_names_of_any_characters(postfx, shot, tmp_path: Path, name: str) -> None:
    shot(1, 2)
    done = postfx("in/shot.####.exr", "-o", f"out/{name}")
    assert done.code == 0, done.err
    assert names(tmp_path / "out") == [name.replace("####", f"{number:04d}") for number in (1, 2)]
    assert postfx(f"out/{name}", "-o", "again/x.####.exr").code == 0
    second = tmp_path / "out" / name.replace("####", "0002")
    assert channel_hashes(tmp_path / "again/x.0002.exr") == channel_hashes(second)


def test_names_are_printed_as_they_are(postfx, shot, tmp_path: Path) -> None:
    """And not taken for the marks and signs that rich, which prints them, knows."""
    shot(1)
    done = postfx("in/shot.####.exr", "-o", "out/[/b][red] :bug:.####.exr")
    assert done.code == 0 and done.err.count("out/[/b][red] :bug:.0001.exr") == 2
    assert names(tmp_path / "out/[") == ["b][red] :bug:.0001.exr"]


def test_names_that_are_not_utf_8_are_refused(postfx, shot, tmp_path: Path) -> None:
    """OpenImageIO takes text only."""
    folder = shot(1)
    done = postfx("in/", "-o", "out/\udcff.####.exr")
    assert (done.code == 2
            and done.error.endswith("out/?.####.exr: is not UTF-8: choose another name"))
    (folder / "shot.0001.exr").rename(folder / "\udcff.0001.exr")
    done = postfx("in/", "-o", "out/a.####.exr")
    assert done.code == 2 and "in/?.0001.exr: its name is not UTF-8: rename it" in done.error


@pytest.mark.parametrize(("target", "told"), [("", "nowhere to write: give -o"),
                                              ("{plane}/a.####.exr", "make the folder '{plane}'"),
                                              ("{view}/a.####.exr", "make the folder '{view}'"),
                                              ("out/{plane}.####.exr", "is for input"),
                                              ("out/####", "write it like out/####.exr"),
                                              ("out/shot_%04d", "write it like out/shot_%04d.exr"),
                                              ("out/shot.####", "write it like out/shot.####.exr")])
def test_outputs_that_are_no_names_are_refused(postfx, shot, target: str, told: str) -> None:
    shot(1)
    done = postfx("in/shot.####.exr", "-o", target)
    assert done.code == 2 and told in done.error


def test_a_name_that_is_too_long_is_told(postfx, shot, tmp_path: Path) -> None:
    shot(1)
    done = postfx("in/shot.####.exr", "-o", f"out/{'x' * 300}.####.exr")
    assert done.code == 2 and "cannot be written: File name too long" in done.error
    assert not (tmp_path / "out").exists() or names(tmp_path / "out") == []


@pytest.mark.parametrize("pattern", ["shot.%0999999999d.exr", "shot.$F99999999999.exr",
                                     f"shot.{'#' * 5000}.exr"])
def test_endless_digits_are_refused(pattern: str) -> None:
    with pytest.raises(SequenceError, match="a frame number has at most 32 digits"):
        parse_pattern(pattern)


@pytest.mark.parametrize("frames", ["1-99999999999", "0-1000000000x1", "1-5x0", "--", "1-2-3", "",
                                    ",", "1e9"])
def test_odd_frame_ranges_are_refused(frames: str) -> None:
    with pytest.raises(SequenceError, match="--frames"):
        parse_frames(frames)


def test_an_input_folder_that_links_to_itself(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop", target_is_directory=True)
    with pytest.raises(SequenceError, match="loop.*no such file"):
        Sequence(f"{tmp_path}/loop/shot.####.exr")


def test_an_output_folder_that_links_to_itself(shot, tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop", target_is_directory=True)
    outputs = OutputFiles(f"{tmp_path}/loop/a.####.exr", Sequence(shot(1)), ExistingFiles.OVERWRITE)
    assert outputs.path(1).name == "a.0001.exr"


@pytest.fixture
def visible() -> Iterator[Path]:
    """A folder that every user may enter."""
    with tempfile.TemporaryDirectory(prefix="postfx-") as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


def as_nobody(*commands: str) -> list[str]:
    """Lines that Python expressions print, run by a user without rights."""
    drop = ("import os; os.setgroups([]) if os.getuid() == 0 else 0; os.setegid(65534) if "
           "os.getuid() == 0 else 0; os.seteuid(65534) if os.getuid() == 0 else 0\n")
    imports = "import sys; sys.path.insert(0, sys.argv[1])\nfrom postfx.io.sequence import *\n" \
              "from postfx.io.writer import write_frame\nfrom postfx.errors import PostfxError\n" \
              "import postfx.frame, postfx.io.exr.picture, numpy as np\n" \
              "postfx.io.exr.picture.to_halves(np.zeros(1))\n" \
              "frame = postfx.frame.Frame({'colour': np.ones((4, 4, 3), np.float32)})\n"
    guarded = [f"try:\n    {command}\nexcept PostfxError as error:\n    "
               "print(type(error).__name__, error)\n" for command in commands]
    return subprocess.run([sys.executable, "-c", "".join([imports, drop, *guarded]),
                           str(REPOSITORY)], check=True,
                          capture_output=True, text=True, timeout=120).stdout.splitlines()


def test_a_file_without_rights(visible: Path) -> None:
    write_mixed(visible / "a.0001.exr").chmod(0)
    (told,) = as_nobody(f"list(read_sequence('{visible}/a.0001.exr'))")
    assert (told == f"ReadError {visible}/a.0001.exr: cannot be read: Permission denied; check the "
            "file's rights")


def test_an_input_folder_without_rights(visible: Path) -> None:
    (visible / "in").mkdir()
    write_mixed(visible / "in/a.0001.exr")
    (visible / "in").chmod(0)
    folder, pattern = as_nobody(f"read_sequence('{visible}/in')",
                                f"read_sequence('{visible}/in/a.####.exr')")
    assert (folder == f"SequenceError {visible}/in: cannot be read: Permission denied; check its "
            "rights")
    assert pattern == folder


def test_an_output_folder_without_rights(visible: Path) -> None:
    (visible / "there").mkdir(mode=0o755)
    new, there = as_nobody(*(f"write_frame('{visible}/{folder}/a.exr', frame)"
                             for folder in ("new", "there")))
    assert new.startswith(f"WriteError {visible}/new/a.exr: cannot be written: Permission denied; "
                          "check the folder")
    assert "Permission denied" in there
    assert names(visible) == ["there"] and names(visible / "there") == []


def test_a_folder_whose_name_is_a_pattern(postfx, shot, tmp_path: Path) -> None:
    shot(1)
    (tmp_path / "####").mkdir()
    for target in ("####", "new_####/"):
        assert postfx("in/shot.####.exr", "-o", target).code == 0
        assert (tmp_path / target / "shot.0001.exr").exists()


@pytest.mark.parametrize("target", ["file/shot.####.exr", "file/below/shot.####.exr", "file"])
def test_an_output_folder_that_is_a_file(postfx, shot, tmp_path: Path, target: str) -> None:
    shot(1)
    (tmp_path / "file").touch()
    done = postfx("in/shot.####.exr", "-o", target)
    assert done.code == 2
    assert "shot.0001.exr: cannot be written: 'file' is no folder: choose another" in done.error


def test_a_frame_into_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file/a.exr", tmp_path / "file/below/a.png"):
        with pytest.raises(WriteError, match=f"'{tmp_path}/file' is no folder: choose another"):
            write_frame(path, make_frame(1))


def test_an_output_that_is_a_folder(postfx, shot, tmp_path: Path) -> None:
    shot(1)
    (tmp_path / "out/shot.0001.exr").mkdir(parents=True)
    done = postfx("in/", "-o", "out/", "--overwrite")
    assert done.code == 2 and "out/shot.0001.exr: cannot be written: Is a directory" in done.error
    assert names(tmp_path / "out") == ["shot.0001.exr"]


def test_errors_of_a_disk_while_reading_are_told(shot, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shot(1)

    def fail(*_: object) -> bytes:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("postfx.io.exr.container.read_headers", fail)
    with pytest.raises(ReadError, match=r"shot\.0001\.exr: cannot be read: Input/output error"):
        list(read_sequence(folder))


def test_writing_to_an_input_is_refused_in_the_library_as_well(shot, tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="is an input"):
        OutputFiles(str(tmp_path / "in/SHOT.####.exr"), Sequence(shot(1)), ExistingFiles.OVERWRITE)

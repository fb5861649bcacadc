"""`postfx watch`: frames are previewed in order as they are written, whatever order and pace they
come in."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from postfx.io.sequence import Sequence

QUICK = ("--settle", "0.1", "--json")


@pytest.fixture
def render(noise) -> Callable[..., None]:
    """Copies frames of in/ to render/ in the background, at seconds from now: whole, or the first
    bytes only."""
    (noise / "render").mkdir()
    threads = []

    def write(number: int, after: float, share: float = 1.0) -> None:
        def copy() -> None:
            time.sleep(after)
            content = (noise / f"in/shot.{number:04d}.exr").read_bytes()
            part = noise / f"render/.{number}"
            part.write_bytes(content[: int(share * len(content))])
            part.replace(noise / f"render/shot.{number:04d}.exr")

        threads.append(threading.Thread(target=copy))
        threads[-1].start()

    yield write
    for thread in threads:
        thread.join()


def colour(path: Path):
    sequence = Sequence(path)
    return sequence.read(sequence.numbers[0])["colour"]


def test_frames_in_order_with_the_history_of_those_before(postfx, render, noise):
    for number, after in ((1, 0.0), (3, 0.2), (2, 0.6), (4, 0.7)):
        render(number, after)
    run = ("--scale", "1", "--model", "s", "--threads", "1")
    done = postfx("watch", "render/", "-o", "out/", "--until", "4", *QUICK, "--", *run)
    assert done.code == 0, done.err
    assert [line.split(",")[0] for line in done.out.splitlines()] == [f'{{"frame": {number}'
                                                                      for number in range(1, 5)]
    assert postfx("run", "in/", "-o", "one/", "--frames", "1-4", "--run-up", "0", *run).code == 0
    for path in sorted((noise / "one").glob("*.exr")):
        assert (colour(path) == colour(noise / "out" / path.name)).all()


def test_a_file_that_is_still_written_is_waited_for(postfx, render, noise):
    render(1, 0.0, share=0.6)
    render(1, 0.8)
    done = postfx("watch", "render/", "-o", "out/", "--until", "1", *QUICK, "--", "--no-denoise",
                  "--bits", "32")
    assert (done.code == 0
            and (colour(noise / "out/shot.0001.exr") == colour(noise / "in/shot.0001.exr")).all())


def test_what_does_not_come_is_left_out(postfx, render, noise):
    shutil.copy(noise / "in/shot.0001.exr", noise / "render")
    shutil.copy(noise / "in/shot.0003.exr", noise / "render")
    (noise / "render/shot.0004.exr").write_bytes(b"no picture")
    shutil.copy(noise / "in/shot.0002.exr", noise / "render/shot.0005.exr")
    done = postfx("watch", "render/", "-o", "out/", "--idle", "1", "--patience", "0.3", *QUICK,
                  "--", "--no-denoise")
    assert done.code == 0, done.err
    assert ("frame 2 did not come within 0.3 s: going on with 3" in done.err and "frame 4 is left "
            "out: " in done.err)
    assert [path.name for path in sorted((noise / "out").iterdir())] == [f"shot.000{n}.exr"
                                                                         for n in (1, 3, 5)]


@pytest.mark.parametrize(("words", "message"), [
    (("--", "--both-ways"), "--both-ways needs all frames"),
    (("--", "--preset", "final"), "--both-ways of --preset final needs all frames"),
    (("--", "--sacle", "2"), "did you mean --scale?"),
    (("--idle", "x"), "'x' is not a number from 0"),
])
def test_wrong_words(postfx, noise, words, message):
    done = postfx("watch", "in/", "-o", "out/", *words)
    assert done.code == 2 and message in done.err


def test_two_sequences_in_the_folder_are_an_error(postfx, noise):
    shutil.copy(noise / "in/shot.0001.exr", noise / "in/other.0001.exr")
    assert "holds 2 sequences" in postfx("watch", "in/", "-o", "out/").err

"""`postfx chunks`: chunks that join without a seam, as commands and as an Open Job Description,
verified together."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.chunks import describe_job
from postfx.io.sequence import Sequence, read_sequence
from postfx.passes.denoise import default_network
from postfx.runs.schedule import Chunk, fill_gaps, find_preroll, make_chunks

CHOOSES_NETWORK = True
"""For `quick_network`."""
RUN = ("--scale", "1", "--model", "s", "--threads", "1")
SIZED = ("--size", "96x64")


@pytest.fixture
def six(write_exr, noise, tmp_path) -> Path:
    """Six frames of noise, the fifth of another shot."""
    for name in sorted((tmp_path / "in").iterdir())[4:5]:
        header = Sequence(name).open(5)
        planes = {channel: header.read(5)["colour"][..., 0] * 3 for channel in "RGB"}
        header.close()
        write_exr(f"in/{name.name}", planes | {"depth.Z": planes["R"] * 0 + 3}, postfx__reset=1)
    return tmp_path


def test_chunks_give_the_pixels_of_an_unbroken_run(postfx, noise):
    done = postfx("chunks", "in/shot.####.exr", "--size", "3", "-o", "parts/a.####.exr", "--json",
                  "--", *RUN)
    found = done.json
    assert [(chunk["frames"], chunk["preroll"], chunk["reads"]) for chunk in found["chunks"]] == [
        ("1-3", "", "1-6"), ("4-6", "1-3", "1-6")]
    assert (found["frames"], found["notes"]) == ("1-6", [])
    for chunk in reversed(found["chunks"]):
        assert postfx(*chunk["command"][1:]).code == 0
    assert postfx("run", "in/shot.####.exr", "-o", "one/a.####.exr", *RUN).code == 0
    for path in sorted((noise / "one").glob("*.exr")):
        one, other = Sequence(path), Sequence(noise / "parts" / path.name)
        assert (one.read(one.numbers[0])["colour"]
                == other.read(one.numbers[0])["colour"]).all(), path.name
    assert postfx(*found["verify"][1:]).code == 0


def test_a_chunk_that_no_machine_took_is_told(postfx, noise):
    chunks = postfx("chunks", "in/shot.####.exr", "--size", "3", "--json", "--",
                    "--no-denoise").json
    assert postfx(*chunks["chunks"][0]["command"][1:]).code == 0
    done = postfx(*chunks["verify"][1:])
    assert done.code == 1 and done.out.count("was to be written and was not") == 3
    assert "unfinished shot.0004.exr: was to be written and was not" in done.out
    assert postfx(*chunks["chunks"][1]["command"][1:], "--bits", "32").code == 0
    done = postfx(*chunks["verify"][1:])
    assert done.code == 1 and "its run had other settings or versions than the first" in done.out


def test_folders_of_several_machines(postfx, noise):
    for folder, frames in (("one", "1-3"), ("two", "4-6")):
        assert postfx("run", "in/", "-o", f"{folder}/", "--frames", frames,
                      "--no-denoise").code == 0
    assert postfx("verify", "one/", "two/", "--frames", "1-6").code == 0
    done = postfx("verify", "one/", "two/", "--frames", "1-7", "--json")
    assert done.code == 1 and done.json["unfinished"] == ["shot.0007.exr"]
    assert "give --frames, the frames that they hold" in postfx("verify", "one/", "two/").err


def test_a_preroll_ends_where_the_shot_begins_and_where_a_frame_is_missing(six):
    files = str(six / "in/shot.####.exr")
    shot = Sequence(files)
    assert find_preroll(shot, 4) == [1, 2, 3] and find_preroll(shot, 4, 2) == [2, 3]
    assert (find_preroll(shot, 5) == [] and find_preroll(shot, 6) == [5]
            and find_preroll(shot, 1) == [])
    assert find_preroll(read_sequence(files, cuts=[3]), 6) == [3, 4, 5]
    (six / "in/shot.0002.exr").unlink()
    assert find_preroll(Sequence(files), 4) == [3]


def test_chunks_of_two_shots(six):
    parts = make_chunks(Sequence(str(six / "in/shot.####.exr")), 2, ahead=1)
    assert list(parts) == [Chunk((1, 2), (), (3,)), Chunk((3, 4), (1, 2), (5,)), Chunk((5, 6))]


def test_a_chunk_of_frames_apart_reads_those_between(six):
    shot = read_sequence(str(six / "in/shot.####.exr"), "1-3x2")
    (chunk,) = make_chunks(shot, 2)
    assert chunk.frames == (1, 3) and chunk.between == (2,) and chunk.reads == (1, 2, 3)


def test_a_chunk_names_the_frame_that_motion_is_estimated_from(write_exr, tmp_path, monkeypatch):
    flat = np.ones((4, 6), np.float32)
    for number in range(1, 7):
        planes = {name: flat for name in ("R", "G", "B", "albedo.R", "albedo.G", "albedo.B")}
        write_exr(f"without.{number}.exr", planes)
        write_exr(f"with.{number}.exr", planes | {"motion.X": flat, "motion.Y": flat})
    monkeypatch.setattr("postfx.runs.schedule.find_preroll",
                        lambda sequence, number: find_preroll(sequence, number, 1))
    for name, motion, first in (("without", "auto", 1), ("with", "estimate", 1),
                                ("with", "auto", 2), ("without", "file", 2)):
        shot = read_sequence(str(tmp_path / f"{name}.#.exr"), motion=motion)
        assert [chunk.reads[0]
                for chunk in make_chunks(shot, 2)] == [1, first, first + 2], (name, motion)


def test_what_does_not_join_is_said(postfx, noise):
    def notes(*words: str, output: str = "out/") -> str:
        return " ".join(postfx("chunks", "in/", "-o", output, "--json", "--", *words).json["notes"])

    assert "--both-ways works in parts" in notes("--both-ways")
    assert "--exposure smooth meters each chunk" in notes("--tonemap", "--exposure", "smooth")
    assert "pictures are exposed as their chunk" in notes(output="out/a.####.png")
    assert notes("--exposure", "0", output="out/a.####.png") == ""


@pytest.mark.parametrize("words", [(), ("--scale", "2"), SIZED, ("--device", "cpu"),
                                   ("--preset", "final"), ("--no-denoise",), ("--memory", "2G"),
                                   ("--model", "s")])
def test_machines_of_any_memory_run_one_network(postfx, noise, monkeypatch, words):
    """That of the machine that cuts: others are larger or smaller, and would choose by that."""
    def cut(memory: int) -> dict:
        monkeypatch.setattr(default_network, "usable_memory", lambda: memory)
        return postfx("chunks", "in/shot.####.exr", "--size", "3", "--json", "--", *words).json

    large, small = cut(1 << 40), cut(1 << 10)
    chooses = words in ((), ("--device", "cpu"), ("--scale", "2"), SIZED)
    assert (large["network"], small["network"]) == (("xl", "m") if chooses else (None, None))
    monkeypatch.setattr(default_network, "usable_memory", lambda: 1 << 10)
    for facts in (large, small):
        for chunk in facts["chunks"]:
            command = chunk["command"]
            assert command.count("--model") == (words != ("--no-denoise",) and not (
                {"--memory", "--preset"} & {*words}))
            if facts["network"]:
                assert command[command.index("--model") + 1] == facts["network"]


def test_a_large_machines_chunk_keeps_its_network_on_a_small_one(postfx, noise, monkeypatch):
    monkeypatch.setattr(default_network, "usable_memory", lambda: 1 << 40)
    chunk = postfx("chunks", "in/shot.####.exr", "--size", "1", "--frames", "1-2", "--json", "--",
                   "--device", "cpu").json["chunks"][0]
    monkeypatch.setattr(default_network, "usable_memory", lambda: 1 << 10)
    assert postfx(*chunk["command"][1:]).code == 0
    (run,) = json.loads((noise / "out" / "postfx.manifest.json").read_text())["runs"].values()
    assert run["settings"]["model"] == "xl"


@pytest.mark.parametrize(("words", "message"), [
    (("--size", "0"), "'0' is not a whole number from 1"),
    (("--", "--sacle", "2"), "unrecognized arguments: --sacle 2: did you mean --scale?"),
    (("--", "--no-denoise", "--scale", "2"),
     "--scale is for the denoiser, which --no-denoise leaves out"),
    (("--openjd", "in/job.json"), "--openjd in/job.json: write it into this folder, "),
    (("--frames", "1-9"), "3 of 9 frames are missing: 7-9"),
    (("-o", "farm/one.exr"),
     "farm/one.exr: one file for 6 frames, 1-6: write it like one.####.exr"),
])
def test_options_are_checked_before_a_machine_gets_them(postfx, noise, words, message):
    done = postfx("chunks", "in/shot.####.exr", *words)
    assert done.code == 2 and message in done.err


def test_frames_with_gaps_are_tasks_of_their_own():
    job = describe_job("a", [Chunk((1, 3)), Chunk((5, 7))], 2, ["postfx", "run"],
                       ["postfx", "verify"])
    (parameter,) = job["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
    assert "extensions" not in job and parameter == {"name": "Frames", "type": "STRING",
                                                     "range": ["1,3", "5,7"]}


def test_openjd_runs_the_template(postfx, noise):
    pytest.importorskip("openjd.cli")
    words = ("chunks", "in/shot.####.exr", "--size", "4", "-o", "out/a.####.exr", "--openjd",
             "job.json")
    assert postfx(*words, "--", "--no-denoise", "--bits", "32").code == 0
    job = json.loads((noise / "job.json").read_text())
    (parameter,) = job["steps"][0]["parameterSpace"]["taskParameterDefinitions"]
    assert (job["extensions"] == ["TASK_CHUNKING"]
            and parameter["chunks"]["rangeConstraint"] == "CONTIGUOUS")
    tools = noise / "tools"
    tools.mkdir()
    (tools / "postfx").write_text(f'#!/bin/sh\nexec {sys.executable} -m postfx "$@"\n')
    (tools / "postfx").chmod(0o755)
    done = subprocess.run(
        [sys.executable, "-c", "from openjd.cli import main; main()", "run", "job.json", "--step",
         "Verify", "--run-dependencies"],
        cwd=noise, capture_output=True, text=True,
        env={**os.environ, "PATH": f"{tools}:{os.environ['PATH']}"})
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(list((noise / "out").glob("a.*.exr"))) == 6
    assert "6 whole, 0 altered" in done.stdout


def test_looking_for_what_leads_over_gaps_opens_no_frame_twice(monkeypatch):
    room = Path(__file__).resolve().parents[2] / "samples" / "room" / "noisy.####.exr"
    shot, opened = read_sequence(room, "1-7x2"), []
    begins = Sequence.begins_shot
    monkeypatch.setattr(Sequence, "begins_shot",
                        lambda self, number: opened.append(number) or begins(self, number))
    assert fill_gaps(shot, shot.numbers) == [1, 2, 3, 4, 5, 6, 7]
    assert sorted(opened) == sorted(set(opened))

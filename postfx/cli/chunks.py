"""`postfx chunks`: a sequence in chunks for the machines of a farm."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence as Words
from pathlib import Path
from typing import TYPE_CHECKING, Any

from postfx.cli.options import parse_path, parse_positive

if TYPE_CHECKING:
    from postfx.io.sequence import Sequence
    from postfx.runs.schedule import Chunk

DESCRIPTION = """\
Cut a sequence into chunks that machines process side by side, and print for each the frames that it reads and its
command. Frames before a chunk run first, without being written, so that no seam is seen (docs/farm.md). Nothing is
processed here. Options of 'postfx run' go behind --.
"""
EXAMPLES = """\
examples:
  postfx chunks 'shot/####.exr' --size 50 -o out/clean.####.exr
  postfx chunks 'shot/####.exr' --size 50 --json
  postfx chunks 'shot/####.exr' --size 50 -o out/clean.####.exr -- --scale 1.5 --model l
  postfx chunks 'shot/####.exr' --size 50 -o out/clean.####.exr --openjd job.json && openjd run job.json --step Verify
  postfx verify out/ --frames 1-200
"""
_UNEVEN = {
    "both_ways": "--both-ways works in parts of 32 frames that begin with each chunk: seams may be seen; leave it out",
    "smooth": "--exposure smooth meters each chunk by itself: brightness may jump at seams; give --exposure EV",
    "metered": "pictures are exposed as their chunk is metered, which follows slowly: brightness may differ at seams; "
               "give --exposure EV, lit or metadata",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="INPUT", nargs="+",
                        help="frames to read: a pattern, a folder, wildcards or files")
    parser.add_argument("-o", "--output", metavar="OUTPUT", default="out/", type=parse_path,
                        help="files to write: a pattern or a folder (default: out/)")
    parser.add_argument("--frames", metavar="RANGE", help="frames to process, e.g. 1-100 or 1-100x2 (default: all)")
    parser.add_argument("--size", metavar="N", type=parse_positive, default=50, help="frames of a chunk (default: 50)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--openjd", metavar="FILE", type=parse_path,
                        help="also write the job as an Open Job Description template, as JSON")
    parser.usage = f"{parser.prog} INPUT... [-o OUTPUT] [--size N] [--frames RANGE] [--json] [--openjd FILE] " \
                   "[-- RUN OPTIONS]"


def execute(arguments: argparse.Namespace) -> int:
    """Print the chunks; returns the exit code."""
    from postfx.cli.main import make_parser
    from postfx.cli.run_options import RUN
    from postfx.errors import OptionError
    from postfx.files import write_atomically
    from postfx.io.pattern import format_frames
    from postfx.runs.schedule import make_chunks

    rest = arguments.forwarded
    words = [*arguments.input, "-o", arguments.output, *rest]
    given = make_parser(["run"]).parse_args(["run", *words])
    RUN.refuse_conflicts(given)
    sequence = _open(given, arguments.frames or given.frames)
    chunks = list(make_chunks(sequence, arguments.size, _frames_ahead(given, sequence)))
    own = [] if given.preroll is not None else ["--preroll", "auto"]
    own += [] if given.overwrite or given.skip_existing else ["--skip-existing"]
    run = ["postfx", "run", *words, *own]
    folder = Path(arguments.output) if arguments.output.endswith("/") else Path(arguments.output).parent
    whole = format_frames(sequence.numbers)
    verify = ["postfx", "verify", str(folder), f"--frames={whole}"]
    notes = _notes(given, arguments.output)
    before = sum(len(chunk.preroll) for chunk in chunks) if given.preroll is None else 0
    notes += [f"{before} frames run twice, for the history of chunks: larger chunks need fewer, and -- --preroll 32 is "
              "enough for most shots"] if before > len(sequence) // 2 else []
    if arguments.openjd:
        if Path(arguments.openjd).resolve().parent != Path.cwd():
            raise OptionError(f"--openjd {arguments.openjd}: write it into this folder, {Path.cwd()}: names of files "
                              "in it are relative to where it lies")
        name = f"postfx {Path(str(sequence.pattern)).name}"
        job = json.dumps(describe_job(name, chunks, arguments.size, run, verify), indent=2)
        write_atomically(Path(arguments.openjd), lambda file: file.write(f"{job}\n".encode()))
    facts: dict[str, Any] = {
        "input": str(sequence.pattern), "output": arguments.output, "frames": whole,
        "chunks": [{**chunk.as_dict(), "command": _command(run, chunk)} for chunk in chunks],
        "verify": verify, "notes": notes}
    print(json.dumps(facts, indent=2) if arguments.json else "\n".join(_lines(facts)))
    return 0


def _open(given: argparse.Namespace, frames: str | None) -> Sequence:
    from postfx.cli.run_options import RUN
    from postfx.io.sequence import Sequence

    sequence = Sequence(given.input, frames, **RUN.values_for("sequence", given))
    if given.on_error == "stop":
        sequence.refuse_holes(sequence.numbers)
    return sequence


def _frames_ahead(given: argparse.Namespace, sequence: Sequence) -> int:
    """Frames after a chunk that it may read."""
    from postfx.cli.run_options import make_run_up
    from postfx.temporal.run_up import FRAMES

    if given.both_ways:
        return FRAMES
    run_up = make_run_up(given, sequence, "auto") if not given.no_denoise else None
    return 0 if run_up is None else FRAMES if given.run_up is None else int(given.run_up)


def _notes(given: argparse.Namespace, output: str) -> list[str]:
    from postfx.cli.run_options import RUN, is_shown
    from postfx.io.writer import is_display_format

    is_picture = bool(Path(output).suffix) and is_display_format(output)
    shown = is_shown(is_picture, **RUN.values_for("look", given))
    found = ["both_ways"] if given.both_ways else []
    found += ["smooth"] if given.exposure == "smooth" else ["metered"] if given.exposure == "auto" and shown else []
    return [_UNEVEN[name] for name in found]


def _command(run: Words[str], chunk: Chunk) -> list[str]:
    return [*run, f"--frames={chunk.as_dict()['frames']}"]


def _lines(facts: dict[str, Any]) -> list[str]:
    lines = [f"{shlex.join(chunk['command'])}  # reads {chunk['reads']}" for chunk in facts["chunks"]]
    return [*lines, f"{shlex.join(facts['verify'])}  # after all of them", *(f"# {note}" for note in facts["notes"])]


FRAMES, FOLDER = "Frames", "Folder"
"""Names of the task's and of the job's parameter of an Open Job Description."""


def describe_job(name: str, chunks: Words[Chunk], size: int, run: Words[str], verify: Words[str]) -> dict[str, Any]:
    """The job as an Open Job Description template (2023-09): a step that processes the chunks, and one that checks all
    of them together afterwards. They run in the template's folder, which the scheduler maps to each machine.

    Where all frames follow each other, the scheduler makes the chunks (extension TASK_CHUNKING, contiguous); else each
    chunk is a task.

    Args:
        run: command and arguments of a chunk, without its frames.
        verify: those of the check.
    """
    from postfx.io.pattern import format_frames

    numbers = [number for chunk in chunks for number in chunk.frames]
    is_contiguous = numbers == list(range(numbers[0], numbers[-1] + 1))
    parameter = {"name": FRAMES, "type": "CHUNK[INT]", "range": f"{numbers[0]}-{numbers[-1]}",
                 "chunks": {"defaultTaskCount": size, "rangeConstraint": "CONTIGUOUS"}}
    if not is_contiguous:
        parameter = {"name": FRAMES, "type": "STRING", "range": [format_frames(chunk.frames) for chunk in chunks]}
    return {
        "specificationVersion": "jobtemplate-2023-09",
        **({"extensions": ["TASK_CHUNKING"]} if is_contiguous else {}),
        "name": name,
        "parameterDefinitions": [{"name": FOLDER, "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "INOUT",
                                  "default": "."}],
        "steps": [
            {"name": "Process", "parameterSpace": {"taskParameterDefinitions": [parameter]},
             "script": _script([*run, f"--frames={{{{Task.Param.{FRAMES}}}}}"])},
            {"name": "Verify", "dependencies": [{"dependsOn": "Process"}], "script": _script(verify)},
        ],
    }


def _script(words: Words[str]) -> dict[str, Any]:
    """A script that runs a command in the job's folder: schedulers start each in a folder of its own."""
    args = ["-c", 'cd "$0" && exec "$@"', f"{{{{Param.{FOLDER}}}}}", *words]
    return {"actions": {"onRun": {"command": "sh", "args": args}}}

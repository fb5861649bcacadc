"""A sequence in chunks for the machines of a farm: `postfx chunks` prints them, `postfx run --ray`
has Ray run them."""

from __future__ import annotations

import argparse
import json
import logging
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence as Words
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from postfx.cli.options import CHUNK_FRAMES, parse_path, parse_positive
from postfx.version import pip_install

if TYPE_CHECKING:
    from postfx.io.sequence import Sequence
    from postfx.runs.schedule import Chunk

DESCRIPTION = """\
Cut a sequence into chunks that machines process side by side, and print for each the frames that it
reads and its command. Frames before a chunk run first, without being written, so that no seam
shows (docs/howto/farm.md). Nothing is processed here. Options of 'postfx run' go after --.
"""
EXAMPLES = """\
examples:
  postfx chunks 'shot/####.exr' --size 50 -o out/clean.####.exr
  postfx chunks 'shot/####.exr' --size 50 --json
  postfx chunks 'shot/####.exr' --size 50 -o out/clean.####.exr -- --scale 1.5 --model l
  postfx chunks 'shot/####.exr' --size 50 -o out/clean.####.exr --openjd job.json
  openjd run job.json --step Verify --run-dependencies    # runs all of that job on this machine
  postfx verify out/ --frames 1-200
"""
_NETWORK = ("all chunks run network {}, chosen for this machine: --model NAME (after --) chooses "
            "another")
_UNEVEN = {
    "both_ways": "--both-ways works in parts of 32 frames that begin with each chunk: seams may be "
    "seen; leave it out",
    "smooth": "--exposure smooth meters each chunk by itself: brightness may jump at seams; give "
    "--exposure EV",
    "metered": "pictures are exposed as their chunk is metered, which follows slowly: brightness "
    "may differ at seams; give --exposure EV, lit or metadata",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this verb's arguments."""
    parser.add_argument("input", metavar="INPUT", nargs="+",
                        help="frames to read: a pattern, a folder, wildcards or files")
    parser.add_argument("-o", "--output", metavar="OUTPUT", default="out/", type=parse_path,
                        help="files to write: a pattern or a folder (default: out/)")
    parser.add_argument("--frames", metavar="RANGE",
                        help="frames to process, e.g. 1-100 or 1-100x2 (default: all)")
    parser.add_argument("--size", metavar="N", type=parse_positive, default=CHUNK_FRAMES,
                        help=f"frames of a chunk (default: {CHUNK_FRAMES})")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--openjd", metavar="FILE", type=parse_path,
                        help="also write the job as an Open Job Description template, as JSON")
    parser.usage = (f"{parser.prog} INPUT... [-o OUTPUT] [--size N] [--frames RANGE] [--json] "
                   "[--openjd FILE] [-- RUN OPTIONS]")


def execute(arguments: argparse.Namespace) -> int:
    """Print the chunks; returns the exit code."""
    from postfx.cli.main import make_parser
    from postfx.errors import OptionError
    from postfx.files import output_file

    words = ["run", *arguments.input, "-o", arguments.output, *arguments.forwarded]
    cut = cut_up(words, make_parser(["run"]).parse_args(words), arguments.size, arguments.frames)
    if arguments.openjd:
        if Path(arguments.openjd).resolve().parent != Path.cwd():
            raise OptionError(f"--openjd {arguments.openjd}: write it into this folder, "
                              f"{Path.cwd()}: names of files in it are relative to where it lies")
        name = f"postfx {Path(str(cut.sequence.pattern)).name}"
        job = json.dumps(describe_job(name, cut.chunks, arguments.size, cut.run, cut.verify),
                         indent=2)
        with output_file(Path(arguments.openjd)) as temporary:
            temporary.write_text(f"{job}\n", "utf-8")
    facts: dict[str, Any] = {
        "input": str(cut.sequence.pattern), "output": arguments.output, "frames": cut.frames,
        "chunks": [{**chunk.as_dict(), "command": cut.command(chunk)} for chunk in cut.chunks],
        "verify": cut.verify, "notes": cut.notes, "network": cut.network}
    print(json.dumps(facts, indent=2) if arguments.json else "\n".join(_lines(facts)))
    return 0


class Cut(NamedTuple):
    """A sequence in chunks.

    Attributes:
        frames: numbers of all frames, as text.
        run: command of a chunk, without its frames; verify: of the check of all chunks together.
        notes: what may be seen at seams, and what takes long.
        network: the denoiser's, where nobody chose one; else None.
    """

    sequence: Sequence
    chunks: list[Chunk]
    frames: str
    run: list[str]
    verify: list[str]
    notes: list[str]
    network: str | None = None

    def command(self, chunk: Chunk) -> list[str]:
        """Command of a chunk."""
        return [*self.run, f"--frames={chunk.as_dict()['frames']}"]


def cut_up(words: Words[str], given: argparse.Namespace, size: int,
           frames: str | None = None) -> Cut:
    """Cut what a `postfx run` would process.

    Args:
        words: the verb and its arguments.
        given: these, parsed.
        size: frames of a chunk.
        frames: range of frames, if not as `given` says.

    Raises PostfxError for options that do not go together, and for frames that are missing.
    """
    from postfx.cli.run_options import RUN
    from postfx.files import with_slashes
    from postfx.io.pattern import format_frames
    from postfx.io.writer import ExistingFiles, OutputFiles
    from postfx.passes.registry import create
    from postfx.runs.schedule import make_chunks

    RUN.refuse_conflicts(given)
    if not given.no_denoise:
        # whose errors belong here, not on a farm
        create("denoise_upscale", **RUN.values_for("denoiser", given))
    sequence = _open(given, frames or given.frames)
    OutputFiles(given.output, sequence, ExistingFiles.OVERWRITE)  # whose errors do, too
    chunks = list(make_chunks(sequence, size, _frames_ahead(given, sequence)))
    own = [] if given.preroll is not None else ["--preroll", "auto"]
    own += [] if given.overwrite or given.skip_existing else ["--skip-existing"]
    network = _network(given, sequence)
    own += [] if network is None else ["--model", network]
    own += _pixel_filter(given, sequence, network)
    folder = (Path(given.output) if with_slashes(given.output).endswith("/")
              else Path(given.output).parent)
    whole = format_frames(sequence.numbers)
    notes = _notes(given, given.output)
    before = sum(len(chunk.preroll) for chunk in chunks) if given.preroll is None else 0
    notes += ([f"{before} frames run twice, for the history of chunks: larger chunks need fewer, "
               "and --preroll 32 is enough for most shots"]
              if before > len(sequence) // 2 else [])
    verify = ["postfx", "verify", str(folder), f"--frames={whole}"]
    return Cut(sequence, chunks, whole, ["postfx", *words, *given.defaults, *own], verify, notes,
               network)


def _network(given: argparse.Namespace, sequence: Sequence) -> str | None:
    """The network of all chunks, where nobody chose one: as this machine would. Each machine would
    choose by its own memory and device, and seams would show. None where --model, --budget or
    --memory decide, or nothing is denoised."""
    from postfx.cli.interruptions import OnError, first_readable
    from postfx.cli.run_options import RUN
    from postfx.cli.usual_network import choose_network, is_chosen
    from postfx.errors import DeviceError
    from postfx.passes.denoise.default_network import USUAL_NETWORK
    from postfx.runtime import Device

    options = RUN.values_for("denoiser", given)
    if given.no_denoise or is_chosen(given, options):
        return None
    with sequence.open(first_readable(sequence, OnError(given.on_error))) as files:
        spec = files.spec()
    try:
        device = Device() if given.device == "auto" else Device(given.device)
    except DeviceError:  # nobody knows here how much memory the farm's GPUs have
        return USUAL_NETWORK
    return choose_network(spec, options, device).network


def _pixel_filter(given: argparse.Namespace, sequence: Sequence,
                  network: str | None) -> list[str]:
    """The option that names the pixel filter of all chunks, which each would look for in its own
    first frame; none where one is named, or nothing is denoised, or the network undoes none."""
    from postfx.cli.interruptions import OnError, first_readable
    from postfx.cli.run_options import RUN
    from postfx.cli.usual_network import choose_pixel_filter

    options = RUN.values_for("denoiser", given)
    if given.no_denoise or "pixel_filter" in options:
        return []
    options |= {} if network is None else {"model": network}
    first = first_readable(sequence, OnError(given.on_error))
    found = choose_pixel_filter(sequence, first, options)
    return [] if found == "auto" else ["--pixel-filter", str(found)]


def _open(given: argparse.Namespace, frames: str | None) -> Sequence:
    from postfx.cli.run_options import RUN
    from postfx.io.sequence import read_sequence

    sequence = read_sequence(given.input, frames, **RUN.values_for("sequence", given))
    if given.on_error == "stop":
        sequence.refuse_holes(sequence.numbers)
    return sequence


def _frames_ahead(given: argparse.Namespace, sequence: Sequence) -> int:
    """Frames after a chunk that it may read."""
    from postfx.cli.run_options import make_run_up
    from postfx.temporal.reverse_order import RUN_UP

    if given.both_ways:
        return RUN_UP
    run_up = make_run_up(given, sequence, "auto") if not given.no_denoise else None
    return 0 if run_up is None else RUN_UP if given.run_up is None else int(given.run_up)


def _notes(given: argparse.Namespace, output: str) -> list[str]:
    from postfx.cli.run_options import RUN
    from postfx.io.writer import is_display_format
    from postfx.passes.display import is_shown

    is_picture = bool(Path(output).suffix) and is_display_format(output)
    shown = is_shown(is_picture, **RUN.values_for("look", given))
    found = ["both_ways"] if given.both_ways else []
    found += (["smooth"] if given.exposure == "smooth" else ["metered"]
              if given.exposure == "auto" and shown else [])
    return [_UNEVEN[name] for name in found]


def _lines(facts: dict[str, Any]) -> list[str]:
    join = subprocess.list2cmdline if os.name == "nt" else shlex.join
    lines = [f"{join(chunk['command'])}  # reads {chunk['reads']}" for chunk in facts["chunks"]]
    notes = [*facts["notes"], *([_NETWORK.format(facts["network"])] if facts["network"] else [])]
    return [*lines, f"{join(facts['verify'])}  # after all of them",
            *(f"# {note}" for note in notes)]


# Names of the task's and of the job's parameter of an Open Job Description.
FRAMES_PARAMETER = "Frames"
FOLDER_PARAMETER = "Folder"


def describe_job(name: str, chunks: Words[Chunk], size: int, run: Words[str],
                 verify: Words[str]) -> dict[str, Any]:
    """The job as an Open Job Description template (2023-09): a step that processes the chunks, and
    one that checks all of them together afterwards. They run in the template's folder, which the
    scheduler maps to each machine.

    Where all frames follow each other, the scheduler makes the chunks (extension TASK_CHUNKING,
    contiguous); else each chunk is a task.

    Args:
        run: command and arguments of a chunk, without its frames.
        verify: those of the check.
    """
    from postfx.io.pattern import format_frames

    numbers = [number for chunk in chunks for number in chunk.frames]
    is_contiguous = numbers == list(range(numbers[0], numbers[-1] + 1))
    parameter = {"name": FRAMES_PARAMETER, "type": "CHUNK[INT]",
                 "range": f"{numbers[0]}-{numbers[-1]}",
                 "chunks": {"defaultTaskCount": size, "rangeConstraint": "CONTIGUOUS"}}
    if not is_contiguous:
        parameter = {"name": FRAMES_PARAMETER, "type": "STRING",
                     "range": [format_frames(chunk.frames) for chunk in chunks]}
    return {
        "specificationVersion": "jobtemplate-2023-09",
        **({"extensions": ["TASK_CHUNKING"]} if is_contiguous else {}),
        "name": name,
        "parameterDefinitions": [{"name": FOLDER_PARAMETER, "type": "PATH",
                                  "objectType": "DIRECTORY", "dataFlow": "INOUT", "default": "."}],
        "steps": [
            {"name": "Process", "parameterSpace": {"taskParameterDefinitions": [parameter]},
             "script": _script([*run, f"--frames={{{{Task.Param.{FRAMES_PARAMETER}}}}}"])},
            {"name": "Verify", "dependencies": [{"dependsOn": "Process"}],
             "script": _script(verify)},
        ],
    }


def _script(words: Words[str]) -> dict[str, Any]:
    """A script that runs a command in the job's folder: schedulers start each in a folder of its
    own."""
    args = ["-c", 'cd "$0" && exec "$@"', f"{{{{Param.{FOLDER_PARAMETER}}}}}", *words]
    return {"actions": {"onRun": {"command": "sh", "args": args}}}


# Ray

RESTARTS = 3
"""How often a chunk goes to another machine because its own one died; a chunk may also be what
kills them."""
RAY_TIMEOUT_SECONDS = 5.0
"""Seconds to wait for Ray's port. Without looking there first, Ray itself tries for a minute and
ends the process."""
CLAIM_PAUSE_SECONDS = 2.0
"""Seconds between two tries to take over files that another run has claimed."""


class ChunkActor:
    """Runs a chunk in a process on a machine that Ray chooses, and keeps the chunk's history from
    frame to frame."""

    def run(self, folder: str, version: str,
            command: list[str]) -> tuple[str, list[str], list[str]]:
        """Run a chunk's command as `postfx run` does, in `folder`; the machine's name, warnings,
        and which frames failed and were let pass.

        If the machine dies, Ray calls it again on another one: finished frames are kept, and the
        history comes from the last checkpoint. Until the claim of the dead process counts as ended,
        its files are waited for.
        """
        from postfx.cli.job import Job
        from postfx.cli.main import make_parser, read_and_write_by
        from postfx.errors import FarmError, RunError
        from postfx.runs.locks import BEAT, SILENT_SECONDS
        from postfx.version import __version__

        machine = socket.gethostname()
        if version != __version__:
            raise FarmError(f"{machine} has postfx {__version__}, not {version}: install the same "
                            "everywhere")
        if not Path(folder).is_dir():
            raise FarmError(f"{machine} has no folder {folder}: frames must be at the same place "
                            "on all machines")
        os.chdir(folder)
        sys.argv = command  # the manifest records it
        given = make_parser(["run"]).parse_args(command[1:])
        given.ray = None
        read_and_write_by(given.threads)
        end = time.monotonic() + SILENT_SECONDS + BEAT
        while True:
            job = Job(given)
            try:
                job.run()
                break
            except RunError:
                if time.monotonic() > end:
                    raise
                time.sleep(CLAIM_PAUSE_SECONDS)
        report = job.report()
        faults = [f"frame {fault.frame}, {fault.instead}: {fault.why}" for fault in report.faults]
        return machine, list(report.warnings), faults


def run_on_ray(arguments: argparse.Namespace) -> int:
    """`postfx run --ray`: let Ray run the chunks, then check all of them together; returns the exit
    code.

    Ray alone decides which chunk runs where and when. Raises FarmError if Ray cannot be reached or
    a chunk failed.
    """
    from postfx.cli.interruptions import EXIT_FAULTS
    from postfx.cli.main import make_parser
    from postfx.cli.run_setup import NOWHERE
    from postfx.errors import WriteError

    if not arguments.output:
        raise WriteError(NOWHERE)
    address, size = arguments.ray
    cut = cut_up(arguments.words, arguments, size)
    ray = _connect(address)
    try:
        faults = _hand_out(ray, cut, _share_of_machine(ray, address, arguments))
    finally:
        ray.shutdown()
    check = make_parser(["verify"]).parse_args(cut.verify[1:])
    code: int = check.execute(check)
    return EXIT_FAULTS if faults else code


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _connect(address: str) -> Any:
    """The module ray, connected; FarmError if that fails."""
    from postfx.errors import FarmError

    try:
        ray = import_module("ray")
    except ImportError:
        raise FarmError("--ray needs Ray, which is not installed here: "
                        f"{pip_install('ray')}") from None
    remedy = ("give the address that 'ray start --head' printed, auto for the cluster of this "
              "machine, or local")
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        if port.isdigit():
            socket.create_connection((host, int(port)), RAY_TIMEOUT_SECONDS).close()
        ray.init(address, log_to_driver=False, logging_level=logging.CRITICAL)
    except Exception as error:  # of many kinds, by Ray's version and the address
        raise FarmError(f"--ray {address}: cannot be reached: {_first_line(error)}: "
                        f"{remedy}") from None
    return ray


def _share_of_machine(ray: Any, address: str, given: argparse.Namespace) -> dict[str, int]:
    """The part of a machine that Ray reserves for a chunk: a GPU if there are any, and as many
    cores as the smallest machine has, or has for each of its GPUs."""
    from postfx.errors import FarmError

    machines = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    gpus = 1 if given.device != "cpu" and any(each.get("GPU") for each in machines) else 0
    cores = [each["CPU"] / (each["GPU"] if gpus else 1) for each in machines
             if each.get("CPU") and (each.get("GPU") or not gpus)]
    if not cores:
        raise FarmError(f"--ray {address}: Ray has no machine with cores: start one with 'ray "
                        "start --address'")
    _tell(f"Ray at {address}, machines: {len(cores)}")
    return {"num_cpus": max(1, int(min(cores))), "num_gpus": gpus}


def _hand_out(ray: Any, cut: Cut, share: dict[str, int]) -> bool:
    """Have all chunks run; whether frames failed and were skipped. FarmError at the end if a chunk
    failed."""
    from postfx.errors import FarmError, Interrupted
    from postfx.version import __version__

    asked: list[int] = []
    # Ray's own handler prints a trace and exits with 1
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    # with its source, so that a machine without postfx can say so
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    actors = ray.remote(ChunkActor).options(**share, max_restarts=RESTARTS, max_task_retries=-1)
    pending: dict[Any, tuple[Chunk, Any]] = {}
    for chunk in cut.chunks:
        actor = actors.remote()
        pending[actor.run.remote(os.getcwd(), __version__, cut.command(chunk))] = chunk, actor
    del actor
    for note in cut.notes:
        _tell(f"note: {note}")
    warnings: dict[str, None] = {}
    failed: list[str] = []
    faults: list[str] = []
    while pending:
        found, _ = ray.wait(list(pending), num_returns=1, timeout=1.0)
        if asked:
            raise Interrupted(asked[0])
        if not found:
            continue
        ready = found[0]
        # without its handle the actor ends, and makes room for the next one
        chunk = pending.pop(ready)[0]
        frames = chunk.as_dict()["frames"]
        try:
            machine, texts, lost = ray.get(ready)
        except ray.exceptions.RayError as error:
            failed.append(f"frames {frames}: {_explain(error)}")
            _tell(failed[-1])
            continue
        warnings |= dict.fromkeys(texts)
        faults += [f"failed: {line}" for line in lost]
        _tell(f"frames {frames}: done on {machine}, {len(pending)} of {len(cut.chunks)} chunks "
              "left")
    for line in [*(f"warning: {text}" for text in warnings), *faults]:
        _tell(line)
    if failed:
        raise FarmError(f"{len(failed)} of {len(cut.chunks)} chunks failed, {failed[0]}; the same "
                        "command goes on from here")
    return bool(faults)


def _explain(error: Exception) -> str:
    """Why a chunk failed, in one line."""
    from postfx.errors import PostfxError

    cause = getattr(error, "cause", None)
    if isinstance(cause, PostfxError):
        return str(cause)
    if missing := re.search(r"No module named '([^']*)'", str(error)):
        place = re.search(r"\bip=([^,)\s]+)", str(error))
        return (f"machine {place[1] if place else '?'} has no Python package '{missing[1]}': "
               "install postfx into the Python that runs Ray there")
    return _first_line(cause or error)


def _first_line(error: BaseException) -> str:
    from postfx.runtime.session import first_line

    return getattr(error, "strerror", None) or first_line(error)

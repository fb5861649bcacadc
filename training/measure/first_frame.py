"""What the first frame of a fresh checkout takes: the compiler's processor time, and that of all
else.

    python -m training.measure.first_frame [--times 3] [--list] [ARGUMENTS OF POSTFX RUN ...]

Copies what git knows of this checkout, without compiled kernels, to a folder of its own with an
empty cache, and runs one frame of the sample sequence there, by default at the render's size.
Prints the seconds of processor time of several copies, median and least: work beside makes a
processor's second worth less. --list also prints each file that the last copy compiled with its
seconds, the longest first.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
FRAMES = ROOT / "samples/room/noisy.####.exr"
TRACE = """
import json, os, subprocess, sys
from postfx.compiled import build

def run(command, **options):
    done = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                            env=options["env"])
    text = done.stdout.read().decode(errors="replace")
    _, status, used = os.wait4(done.pid, 0)
    done.returncode = os.waitstatus_to_exitcode(status)
    made.append((" ".join(map(str, command)), used.ru_utime + used.ru_stime))
    return subprocess.CompletedProcess(command, done.returncode, text, text)

made = []
build.subprocess = type("Traced", (), {"run": staticmethod(run)})
from postfx.cli.main import main
code = 0
try:
    code = main(sys.argv[2:])
finally:
    with open(sys.argv[1], "w") as file:
        json.dump(made, file)
sys.exit(code)
"""
"""Runs the command and writes down each call of the compiler with its seconds."""


def copy_to(folder: Path) -> None:
    """Copy the files that git knows, as they are now."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True,
                            check=True).stdout
    for name in filter(None, listed.decode().split("\0")):
        if ((ROOT / name).is_file()
            and not name.startswith(("docs/", "tests/", "training/", "web/"))):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, folder / name)


def measure(arguments: list[str]) -> tuple[float, list[tuple[str, float]]]:
    """Seconds of processor time of all processes, and the compiler's calls with theirs."""
    with tempfile.TemporaryDirectory() as made:
        checkout, trace = Path(made) / "checkout", Path(made) / "trace.json"
        copy_to(checkout)
        environment = os.environ | {"PYTHONPATH": str(checkout),
                                    "XDG_CACHE_HOME": str(Path(made) / "cache")}
        command = [sys.executable, "-c", TRACE, str(trace), "run", str(FRAMES), "-o",
                   f"{made}/out.####.exr", "--frames", "1", *arguments]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(command, cwd=made, env=environment, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(done.stderr)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return used, [tuple(call) for call in json.loads(trace.read_text("utf-8"))]


def name_of(command: str) -> str:
    """The file that a call compiles and the kernel that it compiles alone, or that it links."""
    words = command.split()
    if "-c" not in words:
        return "link"
    alone = [word[len("-DALONE_"):].partition("=")[0]
             for word in words if word.startswith("-DALONE_")]
    return " ".join([Path(words[-1]).name, *alone])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--list", action="store_true")
    given, arguments = parser.parse_known_args()
    runs = [measure(arguments) for _ in range(given.times)]
    calls = runs[-1][1]
    compiling = [sum(seconds for _, seconds in calls) for _, calls in runs]
    rest = [used - seconds for (used, _), seconds in zip(runs, compiling, strict=True)]
    print(f"compiler, {len(calls)} calls: median {statistics.median(compiling):.1f} s, least "
          f"{min(compiling):.1f} s")
    print(f"all else: median {statistics.median(rest):.1f} s, least {min(rest):.1f} s")
    if given.list:
        for command, seconds in sorted(calls, key=lambda call: -call[1]):
            print(f"  {seconds:5.2f} {name_of(command)}")


if __name__ == "__main__":
    main()

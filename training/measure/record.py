"""Record what a script prints, as the source of figures in the documents.

    python -m training.measure.record NAME [--tolerance 0.05] [--repeat] -- COMMAND ...

writes docs/measured/runs/NAME.txt: the command, commit, date and machine, then what the command
printed. A document names it before the figures that it gives: `<!-- measured: NAME -->`.
`tests/test_figures.py` compares the two, and runs what is recorded with `--repeat` again: its
output may differ by the tolerance, a share of each number, or by one in a number's last digit.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
RUNS = ROOT / "docs/measured/runs"
NUMBER = re.compile(r"(?<![\w.])[+-]?\d[\d,]*\.?\d*(?:e[+-]?\d+)?")
"""A number as scripts and documents write it: 12, -0.8, 1,234, 3e-05."""


@dataclass(frozen=True)
class Run:
    """A recorded run; `facts` are what its header says."""

    facts: dict[str, str]
    output: str

    @property
    def tolerance(self) -> float:
        return float(self.facts.get("tolerance", "0"))

    @property
    def is_repeatable(self) -> bool:
        return self.facts.get("repeat") == "yes"

    def numbers(self) -> list[str]:
        """All numbers of the output, as they are printed."""
        return NUMBER.findall(self.output)

    def has(self, figure: str) -> bool:
        """Whether a number of the output, rounded to as many digits, is this figure; signs do not
        count."""
        wanted = figure.lstrip("+-").replace(",", "")
        return any(is_same(number, wanted) for number in self.numbers())


def value_of(number: str) -> float:
    return abs(float(number.replace(",", "")))


def digits_of(number: str) -> int:
    """Digits behind the point."""
    return len(number.partition(".")[2])


def is_same(number: str, figure: str) -> bool:
    """Whether a printed number is a document's figure, which has fewer digits or as many."""
    if "e" in number or "e" in figure:
        return f"{value_of(number):.3g}" == f"{value_of(figure):.3g}"
    return abs(value_of(number) - value_of(figure)) <= 0.5001 * 10.0 ** -digits_of(figure)


def agrees(number: str, other: str, tolerance: float) -> bool:
    """Whether two runs printed the same, but for the tolerance or one in the last digit."""
    one, two = value_of(number), value_of(other)
    last = 0.0 if "e" in number else 1.001 * 10.0 ** -digits_of(number)
    return abs(one - two) <= max(tolerance * max(one, two), last)


def load(name: str) -> Run:
    """The recorded run of this name."""
    head, _, output = (RUNS / f"{name}.txt").read_text(encoding="utf-8").partition("\n\n")
    return Run(dict(line[2:].split(": ", 1) for line in head.splitlines()), output)


def run(command: list[str]) -> str:
    """The output of a command, run from the project's folder by this interpreter."""
    words = [sys.executable if word == "python" else word for word in command]
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(words, cwd=ROOT, env=os.environ | {"PYTHONPATH": paths},
                          capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{shlex.join(command)}: exit code {done.returncode}\n"
                         f"{done.stdout}{done.stderr}")
    return done.stdout


def machine() -> str:
    """Cores, processor, and the GPU if there is one."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file():
        name = next((line.partition(": ")[2] for line in info.read_text().splitlines()
                     if line.startswith("model name")), name)
    tool = shutil.which("nvidia-smi")
    gpus = subprocess.run([tool, "--query-gpu=name", "--format=csv,noheader"], capture_output=True,
                          text=True).stdout.split("\n") if tool else []
    return ", ".join(filter(None, [f"{os.cpu_count()} cores of {name.strip()}", *gpus]))


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name")
    parser.add_argument("--tolerance", type=float, default=0.0,
                        help="share of a number that runs may differ by")
    parser.add_argument("--repeat", action="store_true",
                        help="short enough to be run again by the tests")
    parser.add_argument("--note", help="what else one should know, such as where the data are from")
    parser.add_argument("--commit", help="where there is no repository: that of the files here")
    parser.add_argument("command", nargs="+")
    given = parser.parse_args(argv)
    commit = (given.commit or subprocess.run(["git", "rev-parse", "--short=10", "HEAD"], cwd=ROOT,
                                             capture_output=True, text=True, check=True)
              .stdout.strip())
    output = run(given.command).replace(f"{ROOT}/", "")
    facts = {"command": shlex.join(given.command), "commit": commit,
             "date": f"{datetime.date.today()}", "machine": machine(),
             "tolerance": f"{given.tolerance:g}", "repeat": "yes" if given.repeat else "no"}
    facts |= {"note": given.note} if given.note else {}
    RUNS.mkdir(parents=True, exist_ok=True)
    head = "".join(f"# {key}: {value}\n" for key, value in facts.items())
    (RUNS / f"{given.name}.txt").write_text(f"{head}\n{output}", encoding="utf-8")


if __name__ == "__main__":
    main()

"""The log of training runs: their table, their curves.

    python -m training.measure.runs table [--log training/runs.jsonl] [--write docs/lab/training.md]
    python -m training.measure.runs curves RUN [RUN ...] -o curves.png

The log has one JSON object a line, one line a run: `run` (a name), `date`, `commit`, `start`
(weights it began from), `options` (those of training.denoise.train that are not its defaults),
`data` (the kind of clips), `clips`, `gpus`, `batch`, `steps`, `minutes`, `validation_psnr` (dB, on
that run's own held-out clips), `validation_flicker`, `kinds` (mean gain over Open Image Denoise in
dB, by kind of content and network), `outcome`. An unknown fact is null. `training.denoise.train
--log FILE` appends a run, `training.measure.kinds score CLIPS --log FILE --run NAME` adds `kinds`.

table prints the log as Markdown, or writes it between the markers of a document. curves draws
folders of training.denoise.train: PSNR and flicker of training windows and of held-out clips
against steps, and the learning rate.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

LOG = Path(__file__).resolve().parents[1] / "runs.jsonl"

# The log ------------------------------------------------------------------------------------------


def read_runs(log: Path) -> list[dict[str, Any]]:
    """All runs, oldest first. Raises ValueError with the number of a line that is not a JSON object
    with a `run`."""
    runs = []
    for number, line in enumerate(log.read_text(encoding="utf-8").splitlines(), 1):
        try:
            run = json.loads(line)
        except ValueError:
            run = None
        if not isinstance(run, dict) or "run" not in run:
            raise ValueError(f"{log}, line {number}: not a run: a JSON object with the key 'run' "
                             "is expected")
        runs.append(run)
    return runs


def append_run(log: Path, run: Mapping[str, Any]) -> None:
    """Add a run to the log, which is created if it does not exist."""
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as file:
        file.write(dump(run) + "\n")


def record_kinds(log: Path, name: str, gains: Mapping[str, Mapping[str, float]]) -> None:
    """Set the scores by kind, kind -> network -> dB over Open Image Denoise, of the newest run of a
    name.

    Raises ValueError where the log has no such run.
    """
    runs = read_runs(log)
    found = [run for run in runs if run["run"] == name]
    if not found:
        known = ", ".join(dict.fromkeys(str(run["run"]) for run in runs))
        raise ValueError(f"{log}: no run '{name}': it has {known or 'none'}")
    found[-1]["kinds"] = {kind: dict(scores) for kind, scores in gains.items()}
    partial = log.with_suffix(".tmp")
    partial.write_text("".join(dump(run) + "\n" for run in runs), encoding="utf-8")
    os.replace(partial, log)


def dump(run: Mapping[str, Any]) -> str:
    """One line of JSON; NaN and infinity become null."""
    plain = {k: None if isinstance(v, float) and not math.isfinite(v) else v
             for k, v in run.items()}
    return json.dumps(plain, ensure_ascii=False)


# Its table ----------------------------------------------------------------------------------------

BEGIN, END = "<!-- runs: begin -->", "<!-- runs: end -->"
COLUMNS = ("run", "date", "began from", "options", "clips", "GPUs x batch", "steps", "minutes",
           "PSNR, dB", "flicker, x1000", "by kind, dB over OIDN", "outcome")


def table(runs: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row a run; `?` is an unknown fact."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + " --- |" * len(COLUMNS)]
    return "\n".join(lines + ["| " + " | ".join(cells(run)) + " |" for run in runs])


def cells(run: Mapping[str, Any]) -> list[str]:
    options = run.get("options")
    told = "?" if options is None else " ".join(f"`--{k.replace('_', '-')}{spelt(v)}`"
                                                for k, v in options.items())
    flicker, gpus = run.get("validation_flicker"), run.get("gpus")
    batch = f"{gpus} x {run['batch'] // gpus}" if gpus and run.get("batch") else "?"
    kinds = "; ".join(f"{kind} " + ", ".join(f"{network} {gain:+.2f}"
                                             for network, gain in gains.items())
                      for kind, gains in sorted((run.get("kinds") or {}).items()))
    return [str(run["run"]), cell(run.get("date")), cell(run.get("start")), told or "defaults",
            cell(run.get("clips")), batch, cell(run.get("steps")), cell(run.get("minutes")),
            cell(run.get("validation_psnr"), "{:.2f}"),
            "?" if flicker is None else f"{1000 * flicker:.1f}", kinds, run.get("outcome") or ""]


def cell(value: object, form: str = "{}") -> str:
    return "?" if value is None else form.format(value)


def spelt(value: object) -> str:
    """The value of an option as it is typed."""
    if value is True:
        return ""
    return " " + (" ".join(map(str, value)) if isinstance(value, list) else str(value))


def write_table(document: Path, runs: Sequence[Mapping[str, Any]]) -> None:
    """Put the table between the markers of a document. Raises ValueError where it has none."""
    text = document.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{document}: no place for the table: {BEGIN} and {END} mark it")
    before, after = text[:text.index(BEGIN)], text[text.index(END):]
    document.write_text(f"{before}{BEGIN}\n{table(runs)}\n{after}", encoding="utf-8")


# Curves -------------------------------------------------------------------------------------------

# Columns of a run's own tables: training rows are step, seconds, rate, loss, psnr, flicker, norm;
# validation rows have no rate.
PANELS = (("PSNR (dB)", 4, 2), ("flicker", 5, 3), ("learning rate", 2, None))


def rows(path: Path) -> list[list[float]]:
    """The numbers of a table; empty if it does not exist yet."""
    if not path.exists():
        return []
    with path.open() as file:
        return [[float(x) for x in row] for row in csv.reader(file)]


def draw(runs: list[Path], target: Path) -> None:
    """Write the picture; one colour a run, training thin and validation thick."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(PANELS), figsize=(14, 4), constrained_layout=True)
    for i, run in enumerate(runs):
        training, validation = rows(run / "log.csv"), rows(run / "validation.csv")
        for axis, (title, column, checked) in zip(axes, PANELS, strict=True):
            axis.set(title=title, xlabel="step")
            axis.grid(alpha=0.3)
            axis.plot([r[0] for r in training], [r[column] for r in training], color=f"C{i}",
                      alpha=0.4, linewidth=0.8)
            if checked:
                axis.plot([r[0] for r in validation], [r[checked] for r in validation],
                          color=f"C{i}", marker=".", label=run.name)
    axes[0].legend(title="held-out clips")
    figure.savefig(target, dpi=110)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    listing = commands.add_parser("table", help="the log as a table")
    listing.add_argument("--log", type=Path, default=LOG, help="default: %(default)s")
    listing.add_argument("--write", type=Path, metavar="DOCUMENT",
                         help="put it between the document's markers")
    curves = commands.add_parser("curves", help="draw the curves of runs")
    curves.add_argument("runs", type=Path, nargs="+", help="folders of training.denoise.train")
    curves.add_argument("-o", "--output", type=Path, default=Path("curves.png"))
    args = parser.parse_args(argv)
    if args.command == "curves":
        draw(args.runs, args.output)
        print(args.output)
        return
    try:
        runs = read_runs(args.log)
        if args.write:
            write_table(args.write, runs)
        else:
            print(table(runs))
    except (OSError, ValueError) as fault:
        parser.error(str(fault))


if __name__ == "__main__":
    main()

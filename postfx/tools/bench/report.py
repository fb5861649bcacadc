"""Results of a benchmark: a table, CSV and comparisons."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

from postfx.files import atomic_file
from postfx.streams import make_printable, styled

HIGHER_IS_BETTER = ("psnr", "ssim")
COMPARED_FIGURES = ("psnr_late", "ssim_late", "flip_late", "flicker_late")
TIMES = ("wall_ms", "wall_ms_min", "wall_ms_max", "cpu_s", "gpu_ms", "first_ms", "peak_mb")
ROW_FACTS = ("name", "title", "family", "model", "precision", "guides", "alone", "run_up", "both",
             "without")


def is_better(figure: str, one: float, other: float) -> bool:
    """Whether `one` beats `other` in a figure."""
    return one > other if _rises(figure) else one < other


def front(rows: list[dict[str, Any]], figure: str, time: str = "wall_ms") -> list[str]:
    """Names of the methods that no other beats in both time and a figure, fastest first."""
    known = [row
             for row in rows if row["scores"][figure] is not None and row["time"][time] is not None]
    best: dict[str, Any] | None = None
    found = []
    for row in sorted(known, key=lambda row: (row["time"][time], row["name"])):
        if best is None or is_better(figure, row["scores"][figure], best["scores"][figure]):
            best = row
            found.append(row["name"])
    return found


def compare(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each of our methods against the best of the others, figure by figure; empty if there are no
    others.

    psnr_late and ssim_late are differences, flip_late and flicker_late quotients; frames_below_oidn
    counts frames whose PSNR is below that of OIDN high.
    """
    others = [row for row in rows if row["family"] != "ours"]
    oidn = next((row for row in rows if row["name"] == "oidn-high"), None)
    found = []
    for row in [row for row in rows if row["family"] == "ours"] if others else []:
        entry: dict[str, Any] = {"name": row["name"]}
        for figure in COMPARED_FIGURES:
            entry[figure] = _against(row["scores"][figure], figure, others)
        if oidn:
            pairs = zip(row["frames"], oidn["frames"], strict=True)
            entry["frames_below_oidn"] = sum(ours["psnr"] < its["psnr"] for ours, its in pairs)
        found.append(entry)
    return found


def choices(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """All methods but ablations."""
    return [row for row in rows if not row["without"]]


def ablations(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Each network without some planes against the same with all: differences and quotients as in
    `compare`."""
    found = []
    for row in rows:
        whole = next((other for other in choices(rows)
                      if row["without"] and _is_same_network(row, other)), None)
        if whole:
            against = {figure: _against(row["scores"][figure], figure, [whole])
                       for figure in COMPARED_FIGURES}
            found.append({"name": row["name"], "of": whole["name"], **against})
    return found


def _is_same_network(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return all(one[key] == other[key]
               for key in ("family", "model", "guides", "alone", "run_up", "both"))


def write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """One line per method: facts, times and figures; unknown cells are empty."""
    figures = list(rows[0]["scores"])
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*ROW_FACTS, *TIMES, *figures])
        for row in rows:
            facts = {**row, "without": " ".join(row["without"])}
            writer.writerow([*(facts[key] for key in ROW_FACTS),
                             *(row["time"][key] for key in TIMES),
                             *(row["scores"][key] for key in figures)])


def print_table(facts: dict[str, Any]) -> None:
    """The table on standard output, then comparisons and the methods that were left out, with
    reasons."""
    from rich.console import Console

    console = Console(file=styled(sys.stdout))
    if not console.is_terminal:
        console = Console(file=styled(sys.stdout), width=160)
    console.print(_table(facts))
    for line in _notes(facts):
        console.print(make_printable(line), highlight=False, markup=False, soft_wrap=True)


def _table(facts: dict[str, Any]) -> Any:
    """The methods as a table for a terminal, a row each."""
    from rich.table import Table

    gpu = facts["device"] != "cpu"
    sizes = ["x".join(map(str, facts[key])) for key in ("render_size", "output_size")]
    frames = len(facts["sequence"]["frames"])
    title = f"{sizes[0]} to {sizes[1]}, {frames} frame{'s' * (frames > 1)}, {facts['device']}"
    threads, runs = facts["threads"], facts["runs"]
    times = f"median of {runs} runs" if runs > 1 else "1 run"
    table = Table(title=f"{title}, {threads} thread{'s' * (threads > 1)}, {times}",
                  header_style="bold")
    table.add_column("method", no_wrap=True)
    heads = ["ms/frame", "min..max", "CPU s", *(["GPU ms"] if gpu else []), "peak MB", "PSNR",
             "SSIM", "FLIP", "relMSE", "flicker", "PSNR all", "flicker all", "worst"]
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    family = None
    for row in facts["methods"]:
        if family not in (None, row["family"]):
            table.add_section()
        family = row["family"]
        table.add_row(row["title"], *_cells(row, gpu))
    table.caption = ("Figures are means over the second half of the frames, 'all' over all of "
                     "them; worst: least PSNR")
    return table


def _cells(row: dict[str, Any], gpu: bool) -> list[str]:
    time, scores = row["time"], row["scores"]
    cells = [f"{time['wall_ms']:.1f}", f"{time['wall_ms_min']:.1f}..{time['wall_ms_max']:.1f}",
             f"{time['cpu_s']:.3f}"]
    cells += [_number(time["gpu_ms"], ".2f")] if gpu else []
    cells += [f"{time['peak_mb']:.0f}"]
    for figure, form in (("psnr_late", ".2f"), ("ssim_late", ".4f"), ("flip_late", ".4f"),
                         ("relmse_late", ".4g"),
                         ("flicker_late", ".2f"), ("psnr", ".2f"), ("flicker", ".2f")):
        cells.append(_number(scores[figure], form))
    return [*cells, f"{scores['worst_psnr']:.2f} @{scores['worst_frame']}"]


def _notes(facts: dict[str, Any]) -> list[str]:
    """Lines below the table: comparisons, ablations and warnings."""
    titles = {row["name"]: row["title"] for row in facts["methods"]}
    lines = []
    for entry in facts["against_best_baseline"]:
        parts = _differences(entry)
        if "frames_below_oidn" in entry:
            parts.append(f"{entry['frames_below_oidn']} frames below OIDN high")
        lines.append(f"{titles[entry['name']]} against the best of the others: {', '.join(parts)}")
    lines += [f"{titles[entry['name']]} against {titles[entry['of']]}: "
              f"{', '.join(_differences(entry))}" for entry in facts["ablations"]]
    broken = [row for row in facts["methods"] if row["scores"]["not_finite"]]
    lines += [f"warning: {row['title']} wrote {row['scores']['not_finite']} values that are not "
              "finite" for row in broken]
    return lines + [f"not measured: {item['what']}: {item['why']}" for item in facts["left_out"]]


def _differences(entry: dict[str, Any]) -> list[str]:
    return [f"PSNR {_number(entry['psnr_late'], '+.2f')} dB",
            f"SSIM {_number(entry['ssim_late'], '+.4f')}",
            f"FLIP {_number(entry['flip_late'], '.2f')}x",
            f"flicker {_number(entry['flicker_late'], '.2f')}x"]


def _against(value: float | None, figure: str, others: list[dict[str, Any]]) -> float | None:
    values = [row["scores"][figure] for row in others if row["scores"][figure] is not None]
    if value is None or not values:
        return None
    best = max(values) if _rises(figure) else min(values)
    difference: float = value - best if _rises(figure) else value / best
    return difference


def _rises(figure: str) -> bool:
    return figure.removesuffix("_late") in HIGHER_IS_BETTER


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


"""What the sweep found: a row for each variant, the Pareto front, and its files."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from training.quality_report.markdown import table

Row = dict[str, Any]
COLUMNS = {"name": "variant", "psnr": "PSNR, dB", "flicker": "flicker, x1000", "parameters": "parameters", "ms": "ms",
           "ms_min": "least", "ms_max": "most", "network_ms": "network, ms", "filter_ms": "filters, ms",
           "steps": "steps", "minutes": "minutes", "clips": "clips", "batch": "batch", "front": "on the front"}
FORMS = {"psnr": ".2f", "flicker": ".2f", "parameters": ",", "ms": ".1f", "ms_min": ".1f", "ms_max": ".1f",
         "network_ms": ".1f", "filter_ms": ".1f"}
SAME = ("minutes", "clips", "batch")
SPOTS = ((0.7, 0.7), (-0.7, 0.7), (0.7, -0.7), (-0.7, -0.7), (1, 0.2), (-1, 0.2), (0.2, 1), (-0.2, 1), (0.2, -1),
         (-0.2, -1))
"""Directions from a dot to its name."""
NEAR = 1.25


def mark_front(rows: list[Row]) -> None:
    """Set `front` of each row: no other variant is as fast and as good, and better in one of both."""
    best = float("-inf")
    for row in sorted(rows, key=lambda row: (row["ms"], -row["psnr"])):
        row["front"] = row["psnr"] > best
        best = max(best, row["psnr"])


def markdown(rows: list[Row]) -> str:
    """The table, fastest first."""
    lines = [[_cell(key, row[key]) for key in COLUMNS] for row in sorted(rows, key=lambda row: row["ms"])]
    return table(list(COLUMNS.values()), lines)


def remarks(rows: list[Row]) -> list[str]:
    """In what the variants were not trained alike."""
    found = {key: sorted({row[key] for row in rows}) for key in SAME}
    return [f"not trained alike: {key} from {values[0]:g} to {values[-1]:g}" for key, values in found.items()
            if values[-1] - values[0] > 0.02 * values[-1]]


def write(rows: list[Row], facts: dict[str, Any], folder: Path) -> None:
    """Write sweep.csv, sweep.json and sweep.png."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "sweep.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(COLUMNS), extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    (folder / "sweep.json").write_text(json.dumps({**facts, "variants": rows}, indent=2) + "\n")
    draw(rows, facts, folder / "sweep.png")


def draw(rows: list[Row], facts: dict[str, Any], path: Path) -> None:
    """PSNR over time, with the front; beside it those that take about as long as `w64`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    middle = next((row["ms"] for row in rows if row["name"] == "w64"), 0)
    near = [row for row in rows if middle / NEAR < row["ms"] < middle * NEAR]
    panels = [rows, near] if 2 < len(near) < len(rows) else [rows]
    figure = Figure(figsize=(9 * len(panels), 6.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, shown in zip(grid, panels, strict=True):
        _dots(axes, shown, log=shown is rows)
        axes.set_xlabel(f"milliseconds a frame of {facts['size']} for network and filters")
    grid[0].set_ylabel("PSNR on held-out clips, dB")
    grid[0].legend(loc="lower right")
    figure.suptitle(f"{facts['processor']}, {facts['threads']} threads, median of {facts['runs']} runs")
    figure.canvas.draw()
    for axes, shown in zip(grid, panels, strict=True):
        _label(axes, shown)
    figure.savefig(path)


def _dots(axes: Any, rows: list[Row], log: bool) -> None:
    """A dot for each variant, with bars from its least to its longest run, and the front's steps."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    for row in rows:
        colour = "#0b62b8" if row["front"] else "#777777"
        spread = [[row["ms"] - row["ms_min"]], [row["ms_max"] - row["ms"]]]
        axes.errorbar([row["ms"]], [row["psnr"]], xerr=spread, fmt="o", color=colour, elinewidth=0.8)
    front = sorted((row["ms"], row["psnr"]) for row in rows if row["front"])
    if front:
        axes.step(*zip(*front, strict=True), where="post", color="#0b62b8", alpha=0.5, label="Pareto front")
    if log:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    axes.margins(0.12)
    axes.grid(True, which="both", color="#e4e4e4")
    axes.set_axisbelow(True)


def _label(axes: Any, rows: list[Row]) -> None:
    """Name the dots, each at the first spot around it where no other name or dot is."""
    from matplotlib.text import Text

    renderer = axes.figure.canvas.get_renderer()
    dots = [axes.transData.transform((row["ms"], row["psnr"])) for row in rows]
    taken = []
    spots = [(8 * k * x, 8 * k * y) for k in range(1, 12) for x, y in SPOTS]
    for row in rows:
        for x, y in spots:
            text = axes.annotate(row["name"], (row["ms"], row["psnr"]), (x, y), textcoords="offset points", fontsize=9,
                                 ha="left" if x > 0 else "right", va="bottom" if y > 0 else "top",
                                 arrowprops={"arrowstyle": "-", "linewidth": 0.4, "color": "#777777"})
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer)  # the annotation's own would hold its line, too
            if (x, y) == spots[-1] or not (any(box.overlaps(other) for other in taken)
                                           or any(box.contains(*dot) for dot in dots)):
                taken.append(box)
                break
            text.remove()


def _cell(key: str, value: Any) -> str:
    return "yes" * value if isinstance(value, bool) else format(value, FORMS.get(key, ""))

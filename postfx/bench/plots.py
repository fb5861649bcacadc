"""Plots of run time against error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator
from matplotlib.transforms import Bbox

from postfx.bench.methods import FAMILIES
from postfx.bench.report import offered

COLOURS = {"ours": "#0b62b8", "oidn": "#c8500a", "plain": "#666666"}
LABELS = {"psnr_late": "PSNR, dB (up is better)", "flicker_late": "flicker, x1000 (down is better)"}
SPOTS = [(8, 5), (8, -13), (-8, 5), (-8, -13), (0, 10), (0, -18), (14, -4), (-14, -4), (10, 18), (10, -26), (-10, 18),
         (-10, -26), (0, 26), (0, -34), (24, 30), (24, -38)]
"""Where a label may stand, in points from its dot; the first free one is taken, and a line drawn to those not NEAR."""
NEAR = 8
Point = tuple[float, float, dict[str, Any]]
"""Where a method's dot is, and its row."""


def pareto(facts: dict[str, Any], figure: str, path: Path) -> None:
    """Plot a figure over time a frame and draw the front; a PNG.

    Methods without a denoiser that lie far off are shown by an arrow at the edge.
    """
    gpu = facts["device"] != "cpu"
    time = "gpu_ms" if gpu else "wall_ms"
    rows = [row for row in offered(facts["methods"])
            if row["scores"][figure] is not None and row["time"][time] is not None]
    if not rows:
        return
    picture = Figure(figsize=(9, 6), dpi=130, layout="constrained")
    canvas = FigureCanvasAgg(picture)
    axes = picture.add_subplot()
    low, high = _range(rows, figure)
    points = [(row["time"][time], min(max(row["scores"][figure], low), high), row) for row in rows]
    axes.set_xscale("log")
    _limits(axes, [x for x, _, _ in points], low, high)
    _draw_front(axes, points, facts["fronts"][figure], figure)
    for x, y, row in points:
        _dot(axes, x, y, row, figure)
    _dress(axes, facts, rows, figure, "GPU milliseconds a frame" if gpu else "milliseconds a frame (wall clock)")
    picture.canvas.draw()
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]  # matplotlib leaves it untyped
    _label(axes, points, figure, renderer)
    picture.savefig(path)


def _range(rows: list[dict[str, Any]], figure: str) -> tuple[float, float]:
    """Values that the axis shows: all that denoise, and a little more."""
    inner = [row["scores"][figure] for row in rows if row["family"] != "plain"]
    values = inner or [row["scores"][figure] for row in rows]
    low, high = min(values), max(values)
    margin = 0.15 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def _limits(axes: Axes, times: list[float], low: float, high: float) -> None:
    axes.set_xlim(min(times) / 1.6, max(times) * 2.2)
    space = 0.06 * (high - low)
    axes.set_ylim(low - space, high + space)


def _draw_front(axes: Axes, points: list[Point], names: list[str], figure: str) -> None:
    """Steps through the methods shown: until the next one is affordable, the last one is the best there is."""
    ordered = sorted((x, y) for x, y, row in points if row["name"] in names and row["scores"][figure] == y)
    axes.step(*zip(*ordered, strict=True), where="post", color="#222222", linewidth=1.2, alpha=0.5, zorder=1,
              label="Pareto front")
    axes.plot([ordered[-1][0], axes.get_xlim()[1]], [ordered[-1][1]] * 2, color="#222222", linewidth=1.2, alpha=0.5,
              zorder=1)


def _dot(axes: Axes, x: float, y: float, row: dict[str, Any], figure: str) -> None:
    value, colour = row["scores"][figure], COLOURS[row["family"]]
    marker = "v" if value < y else "^" if value > y else "D" if row["guides"] else "o"
    axes.plot([x], [y], marker, markersize=8, color=colour, markerfacecolor="white" if row["alone"] else colour,
              markerfacecoloralt="white", fillstyle=_fill(row), markeredgewidth=1.8, zorder=3)
    spread = [[max(x - row["time"]["wall_ms_min"], 0)], [max(row["time"]["wall_ms_max"] - x, 0)]]
    if row["time"]["gpu_ms"] is None:
        axes.errorbar([x], [y], xerr=spread, color=colour, linewidth=1, alpha=0.6, zorder=2)


def _fill(row: dict[str, Any]) -> str:
    """Which part of a dot is filled."""
    return "left" if row["both"] else "bottom" if row["run_up"] else "full"


def _dress(axes: Axes, facts: dict[str, Any], rows: list[dict[str, Any]], figure: str, time: str) -> None:
    sizes = ["x".join(map(str, facts[key])) for key in ("render_size", "output_size")]
    axes.set_title(f"{sizes[0]} to {sizes[1]}, second half of {len(facts['sequence']['frames'])} frames, "
                   f"{facts['device']}, {facts['threads']} CPU threads")
    axes.set_xlabel(f"{time}, logarithmic")
    axes.set_ylabel(LABELS[figure])
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    axes.grid(True, which="major", color="#dddddd", linewidth=0.8)
    axes.set_axisbelow(True)
    for family in dict.fromkeys(row["family"] for row in rows):
        axes.plot([], [], "o", color=COLOURS[family], label=FAMILIES[family])
    if any(row["alone"] for row in rows):
        axes.plot([], [], "o", color=COLOURS["ours"], markerfacecolor="white", label="history reset every frame")
    for kind, label in (("run_up", "with a run-up"), ("both", "both ways")):
        if shown := next((row for row in rows if row[kind]), None):
            axes.plot([], [], "o", color=COLOURS["ours"], markerfacecoloralt="white", fillstyle=_fill(shown),
                      label=label)
    if any(row["guides"] for row in rows):
        axes.plot([], [], "D", color=COLOURS["ours"], label="with guides at output size")
    axes.figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)


def _label(axes: Axes, points: list[Point], figure: str, renderer: RendererAgg) -> None:
    """Name every dot, beside it where nothing else is."""
    dots = [axes.transData.transform((x, y)) for x, y, _ in points]
    taken = [Bbox.from_bounds(x - 8, y - 8, 16, 16) for x, y in dots]
    frame = axes.get_window_extent(renderer)
    for x, y, row in points:
        value, text = row["scores"][figure], _name(row)
        text += f" {value:.3g}" if value != y else ""
        taken.append(_place(axes, renderer, (x, y), text, COLOURS[row["family"]], taken, frame))


def _name(row: dict[str, Any]) -> str:
    """Short name: the marker says what is not in it."""
    if row["family"] != "ours":
        return str(row["title"])
    return str(row["model"]).split(".")[0] + ("" if row["precision"] == "fp32" else f" {row['precision']}")


def _place(
    axes: Axes, renderer: RendererAgg, dot: tuple[float, float], text: str, colour: str, taken: list[Bbox], frame: Bbox
) -> Bbox:
    """Write a label at the first free spot, else at the one that covers least; returns where it stands."""
    label = axes.annotate(text, dot, (0, 0), textcoords="offset points", fontsize=10.5, color=colour, zorder=4,
                          fontweight="bold" if len(text) <= 2 else "normal",
                          arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkB": 4})
    found: list[tuple[float, int, Bbox]] = []
    for index, (dx, dy) in enumerate(SPOTS):
        _stand(label, dx, dy)
        label.update_positions(renderer)
        box = Text.get_window_extent(label, renderer)  # the annotation's own would hold its line, too
        outside = box.x0 < frame.x0 or box.x1 > frame.x1 or box.y0 < frame.y0 or box.y1 > frame.y1
        cost = sum(_overlap(box, other) for other in taken) + (1e6 if outside else 0)
        found.append((cost, index, box))
        if cost == 0:
            break
    _, index, box = min(found, key=lambda item: item[:2])
    _stand(label, *SPOTS[index])
    assert label.arrow_patch is not None  # it was made with arrowprops
    label.arrow_patch.set_visible(index >= NEAR)
    return box


def _stand(label: Any, dx: float, dy: float) -> None:
    label.set_position((dx, dy))
    label.set_horizontalalignment("left" if dx > 0 else "right" if dx < 0 else "center")


def _overlap(one: Bbox, other: Bbox) -> float:
    shared = Bbox.intersection(one, other)
    return shared.width * shared.height if shared else 0.0

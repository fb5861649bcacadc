"""Pictures of a benchmark: run time against error as plots, and details side by side where methods
differ most."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator
from matplotlib.transforms import Bbox
from scipy.ndimage import uniform_filter

from postfx.colour.views import to_codes
from postfx.files import atomic_file
from postfx.frame import Role
from postfx.tools.bench.measure import Material
from postfx.tools.bench.methods import FAMILIES
from postfx.tools.bench.metrics import grey_factor, psnr
from postfx.tools.bench.report import choices

CROP_COUNT = 3
CROP_SIDE_PX = 96
LONGEST_CROP_SHARE = 0.35
"""Longest side of a crop, as a part of the picture's shorter side."""


class Column(NamedTuple):
    """One method's picture (H, W, 3), code values 0..1; `measured`: whether to print its PSNR."""

    title: str
    picture: np.ndarray
    measured: bool = True


def draw_crops(material: Material, rows: list[dict[str, Any]], path: Path) -> None:
    """Crops of the last frame: noisy, OIDN, ours, reference, with the PSNR of each crop; a PNG.

    Crops are where OIDN's picture and ours differ most; without OIDN, where the result and the
    reference do.
    """
    columns = _columns(material, rows, material.noisy.numbers[-1])
    one, other = _choose_pair(columns)
    places = pick(np.abs(one - other).mean(-1), CROP_COUNT)
    _draw(columns, places, f"frame {material.noisy.numbers[-1]}", "where methods differ most", path)


def draw_worst(material: Material, rows: list[dict[str, Any]], path: Path) -> None:
    """Crops where we are furthest behind OIDN's methods, in one frame; a PNG.

    Ours is the largest network without guides, which has the same input as OIDN. The frame is the
    one whose PSNR leads the best OIDN method's least, or lags furthest. Removes the picture if
    there is nothing to compare or if ours is nowhere behind.
    """
    path.unlink(missing_ok=True)
    wanted = _choose_methods(rows)
    ours = next((row for row in wanted if row["family"] == "ours"), None)
    theirs = [row for row in wanted if row["family"] == "oidn"]
    if not ours or not theirs:
        return
    gaps = [own["psnr"] - max(row["frames"][index]["psnr"] for row in theirs)
            for index, own in enumerate(ours["frames"])]
    number = material.noisy.numbers[int(np.argmin(gaps))]
    columns = _columns(material, wanted, number)
    errors = {column.title: np.square(column.picture - columns[-1].picture).mean(-1)
              for column in columns}
    places = pick_deficits(errors[ours["title"]], [errors[row["title"]] for row in theirs],
                           CROP_COUNT)
    if places:
        _draw(columns, places, f"frame {number}", f"where {ours['title']} is behind OIDN most",
              path)


def pick(difference: np.ndarray, count: int) -> list[tuple[int, int]]:
    """Upper left corners (y, x) of up to `count` squares with the greatest mean `difference` (H,
    W), which do not overlap."""
    return _greatest(_means(difference), count, _side(difference.shape))


def pick_deficits(ours: np.ndarray, others: list[np.ndarray], count: int) -> list[tuple[int, int]]:
    """Corners as from `pick`, of the squares where our mean error (H, W) exceeds the others' least
    mean error most.

    Squares where it does not exceed that are left out.
    """
    losses = _means(ours) - np.min([_means(other) for other in others], axis=0)
    return _greatest(np.where(losses > 0, losses, -np.inf), count, _side(ours.shape))


def _means(values: np.ndarray) -> np.ndarray:
    """Means of all squares in the picture, by their upper left corners."""
    side = _side(values.shape)
    means: np.ndarray = uniform_filter(values.astype(np.float64), side, mode="nearest",
                                       origin=-(side // 2))
    return means[: values.shape[0] - side + 1, : values.shape[1] - side + 1]


def _greatest(means: np.ndarray, count: int, side: int) -> list[tuple[int, int]]:
    """Corners of the squares with the greatest means, which do not overlap; minus infinity is never
    taken."""
    open_ = means.copy()
    found: list[tuple[int, int]] = []
    while len(found) < count and np.isfinite(open_).any():
        y, x = np.unravel_index(int(np.argmax(open_)), open_.shape)
        found.append((int(y), int(x)))
        open_[max(y - side + 1, 0) : y + side, max(x - side + 1, 0) : x + side] = -np.inf
    return found


def _draw(columns: list[Column], places: list[tuple[int, int]], frame: str, why: str,
          path: Path) -> None:
    """A line of crops for each place, the PSNR of each below it."""
    reference = columns[-1].picture
    side = _side(reference.shape[:2])
    figure = Figure(figsize=(len(columns) * 2.9, len(places) * 3.1 + 0.5), dpi=100,
                    layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(places), len(columns), squeeze=False)
    for line, (y, x) in zip(grid, places, strict=True):
        cut = (slice(y, y + side), slice(x, x + side))
        for axes, column in zip(line, columns, strict=True):
            axes.imshow(column.picture[cut], interpolation="nearest", vmin=0, vmax=1)
            axes.set_xticks([])
            axes.set_yticks([])
            if column.measured:
                axes.set_xlabel(f"{psnr(column.picture[cut], reference[cut]):.2f} dB", fontsize=10)
        line[0].set_ylabel(f"x {x}, y {y}", fontsize=9)
    for axes, column in zip(grid[0], columns, strict=True):
        axes.set_title(column.title, fontsize=11)
    figure.suptitle(f"{frame}: {side}x{side} pixels of the output {why}", fontsize=10)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:])


def _side(shape: tuple[int, ...]) -> int:
    return max(1, min(CROP_SIDE_PX, round(LONGEST_CROP_SHARE * min(shape[:2]))))


def _columns(material: Material, rows: list[dict[str, Any]], number: int) -> list[Column]:
    reference = material.reference(number)
    first = material.reference(material.noisy.numbers[0])
    factor = reference.exposure_factor or grey_factor(first[Role.COLOUR])
    target = to_codes(reference[Role.COLOUR], factor)
    noisy = to_codes(_repeat(material.motion(number)[Role.COLOUR], *material.size), factor)
    columns = [Column("noisy input", noisy, False)]
    for row in _choose_methods(rows):
        result = material.result(row["output"], number)[Role.COLOUR]
        columns.append(Column(row["title"], to_codes(result, factor)))
    return [*columns, Column("reference", target, False)]


def _choose_methods(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """OIDN high, OIDN high with accumulation, and our largest model that uses no later frames,
    without and with guides; if these are missing, the first methods."""
    by_name = {row["name"]: row for row in rows}
    ours = [row for row in rows if row["family"] == "ours" and row["precision"] == "fp32"
            and not (row["alone"] or row["run_up"] or row["both"])]
    chosen = [by_name.get("oidn-high"), by_name.get("oidn-high-accumulated")]
    for guides in (False, True):
        largest_last = [row for row in ours if row["guides"] is guides]
        chosen += largest_last[-1:]
    return [row for row in chosen if row] or rows[:4]


def _choose_pair(columns: list[Column]) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last method, or the only one and the reference."""
    methods = [column.picture for column in columns if column.measured]
    return (methods[0], methods[-1]) if len(methods) > 1 else (methods[0], columns[-1].picture)


def _repeat(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Enlarge by nearest pixels, which shows the input unchanged."""
    h, w = image.shape[:2]
    repeated: np.ndarray = image[(np.arange(height) * h
                                  // height)[:, None], np.arange(width) * w // width]
    return repeated


METHOD_COLOURS = {"ours": "#0b62b8", "oidn": "#c8500a", "plain": "#666666"}
LABELS = {"psnr_late": "PSNR, dB (up is better)", "flicker_late": "flicker, x1000 (down is better)"}
SPOTS = [(8, 5), (8, -13), (-8, 5), (-8, -13), (0, 10), (0, -18), (14, -4), (-14, -4), (10, 18),
         (10, -26), (-10, 18), (-10, -26), (0, 26), (0, -34), (24, 30), (24, -38)]
"""Places for a label, in points from its dot; the first free one is used, with a line to the dot
unless it is one of the first `NEAR_SPOTS`."""
NEAR_SPOTS = 8
"""Places so near to the dot that the label needs no line to it."""
Point = tuple[float, float, dict[str, Any]]
"""Position of a method's dot, and its row."""


def pareto(facts: dict[str, Any], figure: str, path: Path) -> None:
    """Plot a figure over time a frame and draw the front; a PNG.

    Methods without a denoiser that are far off are shown by an arrow at the edge.
    """
    gpu = facts["device"] != "cpu"
    time = "gpu_ms" if gpu else "wall_ms"
    rows = [row for row in choices(facts["methods"])
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
    _dress(axes, facts, rows, figure,
           "GPU milliseconds a frame" if gpu else "milliseconds a frame (wall clock)")
    picture.canvas.draw()
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]  # matplotlib leaves it untyped
    _label(axes, points, figure, renderer)
    with atomic_file(path) as temporary:
        picture.savefig(temporary, format=path.suffix[1:])


def _range(rows: list[dict[str, Any]], figure: str) -> tuple[float, float]:
    """Range of the axis: all methods that denoise, with a margin."""
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
    """Steps through the methods: each is the best choice until the next one is affordable."""
    ordered = sorted((x, y)
                     for x, y, row in points if row["name"] in names and row["scores"][figure] == y)
    axes.step(*zip(*ordered, strict=True), where="post", color="#222222", linewidth=1.2, alpha=0.5,
              zorder=1, label="Pareto front")
    axes.plot([ordered[-1][0], axes.get_xlim()[1]], [ordered[-1][1]] * 2, color="#222222",
              linewidth=1.2, alpha=0.5, zorder=1)


def _dot(axes: Axes, x: float, y: float, row: dict[str, Any], figure: str) -> None:
    value, colour = row["scores"][figure], METHOD_COLOURS[row["family"]]
    marker = "v" if value < y else "^" if value > y else "D" if row["guides"] else "o"
    axes.plot([x], [y], marker, markersize=8, color=colour,
              markerfacecolor="white" if row["alone"] else colour,
              markerfacecoloralt="white", fillstyle=_fill(row), markeredgewidth=1.8, zorder=3)
    spread = [[max(x - row["time"]["wall_ms_min"], 0)], [max(row["time"]["wall_ms_max"] - x, 0)]]
    if row["time"]["gpu_ms"] is None:
        axes.errorbar([x], [y], xerr=spread, color=colour, linewidth=1, alpha=0.6, zorder=2)


def _fill(row: dict[str, Any]) -> str:
    """The part of a dot that is filled."""
    return "left" if row["both"] else "bottom" if row["run_up"] else "full"


def _dress(axes: Axes, facts: dict[str, Any], rows: list[dict[str, Any]], figure: str,
           time: str) -> None:
    """Title, axes, grid and legend of a plot. time: the words for its x axis."""
    sizes = ["x".join(map(str, facts[key])) for key in ("render_size", "output_size")]
    axes.set_title(f"{sizes[0]} to {sizes[1]}, second half of {len(facts['sequence']['frames'])} "
                   f"frames, {facts['device']}, {facts['threads']} CPU threads")
    axes.set_xlabel(f"{time}, logarithmic")
    axes.set_ylabel(LABELS[figure])
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
    axes.grid(True, which="major", color="#dddddd", linewidth=0.8)
    axes.set_axisbelow(True)
    for family in dict.fromkeys(row["family"] for row in rows):
        axes.plot([], [], "o", color=METHOD_COLOURS[family], label=FAMILIES[family])
    if any(row["alone"] for row in rows):
        axes.plot([], [], "o", color=METHOD_COLOURS["ours"], markerfacecolor="white",
                  label="history reset every frame")
    for kind, label in (("run_up", "with a run-up"), ("both", "both ways")):
        if shown := next((row for row in rows if row[kind]), None):
            axes.plot([], [], "o", color=METHOD_COLOURS["ours"], markerfacecoloralt="white",
                      fillstyle=_fill(shown), label=label)
    if any(row["guides"] for row in rows):
        axes.plot([], [], "D", color=METHOD_COLOURS["ours"], label="with guides at output size")
    axes.figure.legend(loc="outside lower center", ncols=3, fontsize=9, frameon=False)


def _label(axes: Axes, points: list[Point], figure: str, renderer: RendererAgg) -> None:
    """Label every dot at a free place beside it."""
    dots = [axes.transData.transform((x, y)) for x, y, _ in points]
    taken = [Bbox.from_bounds(x - 8, y - 8, 16, 16) for x, y in dots]
    frame = axes.get_window_extent(renderer)
    for x, y, row in points:
        value, text = row["scores"][figure], _name(row)
        text += f" {value:.3g}" if value != y else ""
        taken.append(_place(axes, renderer, (x, y), text, METHOD_COLOURS[row["family"]], taken,
                            frame))


def _name(row: dict[str, Any]) -> str:
    """Short name; the marker shows what it leaves out."""
    if row["family"] != "ours":
        return str(row["title"])
    return str(row["model"]).split(".")[0] + ("" if row["precision"] == "fp32"
                                              else f" {row['precision']}")


def _place(
    axes: Axes, renderer: RendererAgg, dot: tuple[float, float], text: str, colour: str,
    taken: list[Bbox], frame: Bbox
) -> Bbox:
    """Write a label at the first free place, or where it covers least; returns the place."""
    label = axes.annotate(text, dot, (0, 0), textcoords="offset points", fontsize=10.5,
                          color=colour, zorder=4, fontweight="bold" if len(text) <= 2 else "normal",
                          arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7,
                                      "shrinkB": 4})
    found: list[tuple[float, int, Bbox]] = []
    for index, (dx, dy) in enumerate(SPOTS):
        _stand(label, dx, dy)
        label.update_positions(renderer)
        box = Text.get_window_extent(label, renderer)  # without the annotation's line
        outside = box.x0 < frame.x0 or box.x1 > frame.x1 or box.y0 < frame.y0 or box.y1 > frame.y1
        cost = sum(_overlap(box, other) for other in taken) + (1e6 if outside else 0)
        found.append((cost, index, box))
        if cost == 0:
            break
    _, index, box = min(found, key=lambda item: item[:2])
    _stand(label, *SPOTS[index])
    assert label.arrow_patch is not None  # made with arrowprops
    label.arrow_patch.set_visible(index >= NEAR_SPOTS)
    return box


def _stand(label: Any, dx: float, dy: float) -> None:
    label.set_position((dx, dy))
    label.set_horizontalalignment("left" if dx > 0 else "right" if dx < 0 else "center")


def _overlap(one: Bbox, other: Bbox) -> float:
    shared = Bbox.intersection(one, other)
    return shared.width * shared.height if shared else 0.0

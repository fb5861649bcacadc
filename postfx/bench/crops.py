"""Details side by side, where methods differ most."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter

from postfx.bench.material import Material
from postfx.bench.metrics import grey_exposure, psnr
from postfx.exposure.views import shown
from postfx.frame import Role

COUNT, SIDE = 3, 96
SHARE = 0.35
"""Greatest part of the picture's smaller side that a crop takes."""


class Column(NamedTuple):
    """One method's picture (H, W, 3), code values 0..1; `measured` says whether its PSNR is of interest."""

    title: str
    picture: np.ndarray
    measured: bool = True


def draw_crops(material: Material, rows: list[dict[str, Any]], path: Path) -> None:
    """Crops of the last frame: noisy, OIDN, ours, reference, with the PSNR of each crop; a PNG.

    They are taken where OIDN's picture and ours differ most (else the result and the reference), not where either is
    good.
    """
    columns = _columns(material, rows, material.noisy.numbers[-1])
    one, other = _compared(columns)
    places = pick(np.abs(one - other).mean(-1), COUNT)
    _draw(columns, places, f"frame {material.noisy.numbers[-1]}", "where methods differ most", path)


def draw_worst(material: Material, rows: list[dict[str, Any]], path: Path) -> None:
    """The same for our failures: the frame and the places where ours is behind OIDN's methods most; a PNG.

    Ours is the largest network without guides, which sees what OIDN sees. The frame is the one where its PSNR is least
    above (or furthest below) the best OIDN method's. Where there is nothing to compare, or no place where ours is
    behind, there is no picture afterwards.
    """
    path.unlink(missing_ok=True)
    wanted = _wanted(rows)
    ours = next((row for row in wanted if row["family"] == "ours"), None)
    theirs = [row for row in wanted if row["family"] == "oidn"]
    if not ours or not theirs:
        return
    gaps = [own["psnr"] - max(row["frames"][index]["psnr"] for row in theirs)
            for index, own in enumerate(ours["frames"])]
    number = material.noisy.numbers[int(np.argmin(gaps))]
    columns = _columns(material, wanted, number)
    errors = {column.title: np.square(column.picture - columns[-1].picture).mean(-1) for column in columns}
    places = behind(errors[ours["title"]], [errors[row["title"]] for row in theirs], COUNT)
    if places:
        _draw(columns, places, f"frame {number}", f"where {ours['title']} is behind OIDN most", path)


def pick(difference: np.ndarray, count: int) -> list[tuple[int, int]]:
    """Upper left corners (y, x) of up to `count` squares of the greatest mean `difference` (H, W), without overlap."""
    return _greatest(_means(difference), count, _side(difference.shape))


def behind(ours: np.ndarray, others: list[np.ndarray], count: int) -> list[tuple[int, int]]:
    """Corners as of `pick`: squares whose mean error (H, W) is furthest above the least of the others' means.

    None where ours is not above it.
    """
    losses = _means(ours) - np.min([_means(other) for other in others], axis=0)
    return _greatest(np.where(losses > 0, losses, -np.inf), count, _side(ours.shape))


def _means(values: np.ndarray) -> np.ndarray:
    """Means of all squares that fit into the picture, by their upper left corners."""
    side = _side(values.shape)
    means: np.ndarray = uniform_filter(values.astype(np.float64), side, mode="nearest", origin=-(side // 2))
    return means[: values.shape[0] - side + 1, : values.shape[1] - side + 1]


def _greatest(means: np.ndarray, count: int, side: int) -> list[tuple[int, int]]:
    """Corners of the squares of the greatest means, without overlap; minus infinity is never taken."""
    open_ = means.copy()
    found: list[tuple[int, int]] = []
    while len(found) < count and np.isfinite(open_).any():
        y, x = np.unravel_index(int(np.argmax(open_)), open_.shape)
        found.append((int(y), int(x)))
        open_[max(y - side + 1, 0) : y + side, max(x - side + 1, 0) : x + side] = -np.inf
    return found


def _draw(columns: list[Column], places: list[tuple[int, int]], frame: str, why: str, path: Path) -> None:
    """A line of crops for each place, the PSNR of each below it."""
    reference = columns[-1].picture
    side = _side(reference.shape[:2])
    figure = Figure(figsize=(len(columns) * 2.9, len(places) * 3.1 + 0.5), dpi=100, layout="constrained")
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
    figure.savefig(path)


def _side(shape: tuple[int, ...]) -> int:
    return max(1, min(SIDE, round(SHARE * min(shape[:2]))))


def _columns(material: Material, rows: list[dict[str, Any]], number: int) -> list[Column]:
    reference = material.reference(number)
    first = material.reference(material.noisy.numbers[0])
    exposure = reference.exposure or grey_exposure(first[Role.COLOUR])
    target = shown(reference[Role.COLOUR], exposure)
    noisy = shown(_repeated(material.motion(number)[Role.COLOUR], *material.size), exposure)
    columns = [Column("noisy input", noisy, False)]
    for row in _wanted(rows):
        result = material.result(row["output"], number)[Role.COLOUR]
        columns.append(Column(row["title"], shown(result, exposure)))
    return [*columns, Column("reference", target, False)]


def _wanted(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """OIDN high, the same with accumulation, and our largest model that sees no later frames, without and with guides;
    else the first ones."""
    by_name = {row["name"]: row for row in rows}
    ours = [row for row in rows if row["family"] == "ours" and not (row["alone"] or row["run_up"] or row["both"])
            and row["precision"] == "fp32"]
    chosen = [by_name.get("oidn-high"), by_name.get("oidn-high-accumulated")]
    chosen += [next((row for row in reversed(ours) if row["guides"] is guides), None) for guides in (False, True)]
    return [row for row in chosen if row] or rows[:4]


def _compared(columns: list[Column]) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last method, or the only one and the reference."""
    methods = [column.picture for column in columns if column.measured]
    return (methods[0], methods[-1]) if len(methods) > 1 else (methods[0], columns[-1].picture)


def _repeated(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Nearest pixels, so that the input is seen as it is."""
    h, w = image.shape[:2]
    repeated: np.ndarray = image[(np.arange(height) * h // height)[:, None], np.arange(width) * w // width]
    return repeated

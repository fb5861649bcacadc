"""Pictures of training.detail_study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from training.detail_scene import PARTS, PATCH, SCALE, Scene

FIGURES = {"psnr": "PSNR, dB", "share": "share of the detail", "coherence": "coherence"}
"""Name of a figure -> title."""
CROP = 56
CROPS = {"star, albedo": (0.5, 0.5), "bars, albedo": (0.5, 1.5), "digits, albedo": (1.5, 1.5),
         "digits, light": (3.5, 1.5), "shadow edges": (5, 1)}
"""Title -> middle in the world, patches."""

Pictures = dict[str, np.ndarray]


def plot(rows: list[dict[str, Any]], title: str, path: Path) -> None:
    """Figures over frames: a row of panels for each part; a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 11), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(PARTS), len(FIGURES), sharex=True)
    names = dict.fromkeys(row["method"] for row in rows)
    for line, part in zip(grid, PARTS, strict=True):
        for axes, (key, label) in zip(line, FIGURES.items(), strict=True):
            for name in names:
                points = [(row["frame"], row[key]) for row in rows if (row["method"], row["part"]) == (name, part)]
                axes.plot(*zip(*points, strict=True), ".-", linewidth=1.2, label=name)
            axes.set_title(f"{part}: {label}", fontsize=10)
            axes.grid(True, color="#dddddd")
    for axes in grid[-1]:
        axes.set_xlabel("frame")
    grid[0, 0].legend(fontsize=8)
    figure.suptitle(title)
    figure.savefig(path)


def draw_crops(columns: Pictures, scene: Scene, t: int, exposure: float, path: Path) -> None:
    """Patches of CROP pixels of frame `t`, as seen, a column for each picture; a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from postfx.bench.metrics import shown

    figure = Figure(figsize=(1.75 * len(columns), 1.75 * len(CROPS) + 0.3), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(CROPS), len(columns))
    for line, (name, place) in zip(grid, CROPS.items(), strict=True):
        middle = (SCALE * (n * PATCH - t * step) for n, step in zip(place, scene.pan, strict=True))
        left, top = (round(value) - CROP // 2 for value in middle)
        for axes, picture in zip(line, columns.values(), strict=True):
            cut = shown(picture[top : top + CROP, left : left + CROP], exposure)
            axes.imshow(cut, interpolation="nearest", vmin=0, vmax=1)
            axes.set_xticks([])
            axes.set_yticks([])
        line[0].set_ylabel(name, fontsize=8)
    for axes, title in zip(grid[0], columns, strict=True):
        axes.set_title(title, fontsize=9)
    figure.savefig(path)

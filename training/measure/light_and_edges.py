"""Light that is kept and the error along silhouettes, of postfx and Open Image Denoise at the
render's size.

    python -m training.measure.light_and_edges FOLDER [--model xl] [--kinds water,fog]

FOLDER holds one folder for each kind, as for `training.measure.table`; all frames count.

Light: the mean of each cell of 32x32 pixels of linear light, exposed and cut at 1,000, against the
reference's. Printed are the median and the 99th percentile of the cells' relative differences:
of the noisy frames, which tell no denoiser more, of postfx, and of OIDN. Cells whose reference is
darker than a thousandth of middle grey do not count.

Edges: pixels within two of a step of depth by more than a tenth, in the render with the most
samples. Printed is the PSNR of displayed pictures there, and how much postfx is above the best of
Open Image Denoise's ways of single frames (planes as clean, prefiltered, as they are, colour
alone).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from postfx import DenoiseUpscale, Device, Pipeline
from postfx.colour.views import to_codes
from postfx.frame import Role
from postfx.io.sequence import Sequence
from postfx.tools.bench.baselines import Oidn
from postfx.tools.bench.metrics import grey_factor
from training.measure.table import SINGLE, Shot, parser_of_kinds, shots

CELL_PX = 32
BAND_PX = 2
DEPTH_STEP = 0.1
"""Relative difference of depth between neighbours that makes a silhouette."""
MOST_LIGHT = 1e3
"""Exposed light that counts, at most; a cell's mean would else be that of its fireflies."""
LEAST_LIGHT = 1.8e-4
"""Exposed mean of a cell that counts, at least."""
POSTFX, NOISY = "postfx", "noisy"


def cell_means(light: np.ndarray) -> np.ndarray:
    """Means over cells (rows, columns) of light (height, width, 3) and of its channels; what is
    left at the right and the bottom does not count."""
    rows, columns = (side // CELL_PX for side in light.shape[:2])
    cut = light[:rows * CELL_PX, :columns * CELL_PX]
    found: np.ndarray = cut.reshape(rows, CELL_PX, columns, CELL_PX, 3).mean(axis=(1, 3, 4))
    return found


def light_change(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Relative differences of the cells of exposed light, of those that are bright enough."""
    means, right = (cell_means(np.clip(light, 0, MOST_LIGHT)) for light in (found, wanted))
    counts = right > LEAST_LIGHT
    return np.asarray(np.abs(means[counts] / right[counts] - 1))


def silhouettes(depth: np.ndarray) -> np.ndarray:
    """Whether a pixel of depth (height, width) lies within `BAND_PX` of a step."""
    distance = np.log(np.clip(depth, 1e-4, 1e10))
    edge = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        step = np.abs(np.diff(distance, axis=axis)) > np.log1p(DEPTH_STEP)
        before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], after[axis] = (0, 1), (1, 0)
        edge |= np.pad(step, before) | np.pad(step, after)
    for _ in range(BAND_PX - 1):
        padded = np.pad(edge, 1)
        edge = edge | padded[2:, 1:-1] | padded[:-2, 1:-1] | padded[1:-1, 2:] | padded[1:-1, :-2]
    return edge


@dataclass
class Sums:
    """Figures of one shot by way: differences of cells, and squared errors along silhouettes."""

    cells: dict[str, list[np.ndarray]]
    edges: dict[str, list[float]]

    def add(self, way: str, found: np.ndarray, wanted: np.ndarray, edge: np.ndarray) -> None:
        """A frame's exposed light, the reference's, and where its silhouettes are."""
        self.cells.setdefault(way, []).append(light_change(found, wanted))
        if edge.any():
            squared = np.square(to_codes(found, 1.0) - to_codes(wanted, 1.0))
            self.edges.setdefault(way, []).append(float(squared[edge].mean()))

    def decibels(self, way: str) -> float:
        """PSNR along silhouettes."""
        return float(-10 * np.log10(np.mean(self.edges[way])))

    def best(self) -> str:
        """The way of Open Image Denoise that is best along silhouettes."""
        return max(SINGLE, key=self.decibels) if self.edges else SINGLE[0]


def measure(shot: Shot, richest: Shot, model: str, threads: int) -> Sums:
    """All ways on a shot."""
    references, noisy = Sequence(shot.reference), Sequence(shot.noisy)
    guide = Sequence(richest.noisy)
    pipeline = Pipeline([DenoiseUpscale(scale=1.0, model=model)], Device("cpu", threads))
    ways = {planes: Oidn("high", "cpu", threads, planes) for planes in SINGLE}
    sums = Sums({}, {})
    for number in noisy.numbers:
        frame = noisy.read(number)
        wanted = references.read(number, [Role.COLOUR])[Role.COLOUR]
        exposure = grey_factor(wanted)
        depth = guide.read(number, [Role.DEPTH]).planes.get(Role.DEPTH)
        edge = (np.zeros(wanted.shape[:2], bool) if depth is None
                else silhouettes(depth[:, :, 0]))
        made = {NOISY: frame[Role.COLOUR], **{name: way(frame) for name, way in ways.items()}}
        made[POSTFX] = pipeline(frame)[Role.COLOUR]
        for name, colour in made.items():
            sums.add(name, np.nan_to_num(colour) * exposure, wanted * exposure, edge)
    return sums


def told(sums: list[Sums], way: str | None) -> str:
    """Median and 99th percentile of the cells in percent; None: of OIDN's best way in each shot."""
    cells = np.concatenate([part for one in sums for part in one.cells[way or one.best()]])
    return f"{100 * np.median(cells):6.2f} {100 * np.percentile(cells, 99):6.2f}"


def row(name: str, sums: list[Sums]) -> str:
    """A line of the table."""
    light = "  ".join(told(sums, way) for way in (NOISY, POSTFX, None))
    edged = [one for one in sums if one.edges]
    if not edged:
        return f"{name:12} {light}   no silhouettes"
    gains = [one.decibels(POSTFX) - one.decibels(one.best()) for one in edged]
    best = edged[0].best() if len(edged) == 1 else f"above in {sum(gain >= 0 for gain in gains)}"
    mean = np.mean([one.decibels(POSTFX) for one in edged])
    return f"{name:12} {light}  {mean:6.2f} {np.mean(gains):+6.2f}  {best}"


def main(argv: list[str] | None = None) -> None:
    parser = parser_of_kinds(__doc__)
    given = parser.parse_args(argv)
    wanted = list(shots(given.folder, list(filter(None, given.kinds.split(","))), ["1x"], []))
    if not wanted:
        parser.error(f"{given.folder} holds no kinds with references: "
                     "training/measure/validation/render_scenes.py makes them")
    print(f"{'':12} cells: median and 99 % of them within, %          edges: dB, and above OIDN")
    print(f"{'':12} {'noisy':>13}  {'postfx':>13}  {'OIDN':>13}")
    found: dict[tuple[str, int], Sums] = {}
    for shot in wanted:
        mine = [one for one in wanted if one.kind == shot.kind]
        richest = max(mine, key=lambda one: one.samples)
        found[shot.kind, shot.samples] = measure(shot, richest, given.model, given.threads)
        print(row(f"{shot.kind} {shot.samples}", [found[shot.kind, shot.samples]]), flush=True)
    for samples in sorted({count for _, count in found}):
        print(row(f"all {samples}", [one for (_, count), one in found.items()
                                     if count == samples]))
    print(row("all", list(found.values())))


if __name__ == "__main__":
    main()

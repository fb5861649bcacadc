"""Curves over the frames of a sequence, for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from postfx.report.frame_log import Row


class Chart(NamedTuple):
    """A chart: `prefix` of the readings that it shows; what follows the prefix is the curve's name."""

    prefix: str
    title: str
    note: str


CHARTS = (
    Chart("change ", "Change along the motion", "1000 times the mean difference to the frame before, followed by the "
          "motion, in code values as shown, of the calmest 80 % of the pixels: flicker, and what light really does."),
    Chart("exposure ", "Exposure, EV", "What the run exposed by, and what the meter says of each input frame alone."),
    Chart("psnr ", "PSNR against the reference, dB", "Of code values as shown, at full size; up is better."),
    Chart("flip ", "FLIP against the reference", "Mean error as the eye sees it at 67 pixels a degree, 0 to 1; down is "
          "better."),
    Chart("ms ", "Milliseconds a frame", "In the passes, without reading and writing. The first frame includes the "
          "compilation."),
)


def charts(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Charts that have a curve of at least two values: 'title', 'note', 'curves': name -> values, None for none."""
    names = dict.fromkeys(name for row in rows for name in row.readings)
    curves = {name: [row.readings.get(name) for row in rows] for name in names}
    drawn = {name: values for name, values in curves.items() if sum(value is not None for value in values) > 1}
    found = [(chart, _of(chart, drawn)) for chart in CHARTS]
    return [{"title": chart.title, "note": chart.note, "curves": own} for chart, own in found if own]


def _of(chart: Chart, curves: Mapping[str, list[float | None]]) -> dict[str, list[float | None]]:
    return {name.removeprefix(chart.prefix): values for name, values in curves.items() if name.startswith(chart.prefix)}

"""Charts over the frames of a sequence: curves by what they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from postfx.tools.report.frame_log import Row


class Chart(NamedTuple):
    """A chart of all readings whose names begin with `prefix`; the rest of a name is the curve's
    name. `span` is the least height in the readings' unit."""

    prefix: str
    title: str
    span: float
    note: str


CHARTS = (
    Chart("change ", "Change along the motion", 10,
          "1000 times the mean difference to the frame before, followed by the motion, in code "
          "values as shown, of the calmest 80 % of the pixels: flicker and changes of light."),
    Chart("exposure ", "Exposure, EV", 1,
          "Used: the exposure of the run. Metered: the meter's reading of each input frame alone."),
    Chart("psnr ", "PSNR against the reference, dB", 2,
          "Of code values as shown, at full size; up is better."),
    Chart("flip ", "FLIP against the reference", 0.02,
          "Mean error as the eye sees it at 67 pixels a degree, 0 to 1; down is better."),
    Chart("ms ", "Milliseconds a frame", 10,
          "In the passes, without reading and writing; the first frame, which compiles, is left "
          "out."),
)


def charts(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Charts with a curve of at least two values: 'title', 'note', least 'span', and 'curves':
    name -> values."""
    names = dict.fromkeys(name for row in rows for name in row.readings)
    curves = {name: [row.readings.get(name) for row in rows] for name in names}
    drawn = {name: values
             for name, values in curves.items() if sum(value is not None for value in values) > 1}
    found = [_drawn(chart, drawn) for chart in CHARTS]
    return [chart for chart in found if chart["curves"]]


def _drawn(chart: Chart, curves: Mapping[str, list[float | None]]) -> dict[str, Any]:
    own = {name.removeprefix(chart.prefix): curve
           for name, curve in curves.items() if name.startswith(chart.prefix)}
    return {"title": chart.title, "note": chart.note, "span": chart.span, "curves": own}

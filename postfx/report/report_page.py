"""The report of a sequence as one HTML page: frames to compare, findings, curves, planes, and what ran."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from postfx.errors import WriteError
from postfx.frame import Frame
from postfx.report.charts import charts
from postfx.report.contact_sheet import contact_sheet
from postfx.report.frame_log import LONGEST, FrameLog
from postfx.report.page import page
from postfx.version import __version__

SCRIPTS = ("report_light.js", "report_viewer.js", "report_charts.js", "report.js")


def write_report(
    path: Path, title: str, log: FrameLog, facts: dict[str, Any], first: Frame, run: dict[str, Any] | None = None
) -> None:
    """Write the page. Raises WriteError.

    log: what was seen of the frames. facts: what `postfx inspect --json` prints, of the input. first: the input's first
    frame with all planes. run: what `postfx run --json` prints, and 'plan', the text of --explain.
    """
    data = {
        "postfx": __version__,
        "display": log.look.display,
        "longest": LONGEST,
        "frames": log.frames(),
        "numbers": [row.number for row in log.rows],
        "cuts": [row.number for row in log.rows if row.cut],
        "charts": charts(log.rows),
        "readings": {row.number: row.readings for row in log.rows},
        "facts": facts,
        "sheet": contact_sheet(first),
        "run": run,
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page(title, "report", SCRIPTS, data), encoding="utf-8")
    except OSError as error:
        raise WriteError(f"report '{path}' cannot be written: {error.strerror or error}") from error

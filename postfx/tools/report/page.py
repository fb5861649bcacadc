"""Pages that open from the disk: one HTML file that needs no other files and no network.

`write_report` writes the page of a sequence, `write_capture` the page and the JSON of a capture,
and `FrameCapture` captures one frame of a run.
"""

from __future__ import annotations

import html
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from postfx.errors import CommandError, SequenceError, WriteError
from postfx.files import write_text, write_texts
from postfx.io.writer import check_folder
from postfx.runtime import Capture, Device
from postfx.runtime.snapshot import CapturedDispatch, CapturedValue, Snapshot
from postfx.tools.report.capture_data import CAPTURE_FILE, as_dict
from postfx.tools.report.charts import charts
from postfx.tools.report.frame_log import LONGEST_SIDE_PX, FrameLog
from postfx.tools.report.networks import describe
from postfx.tools.report.pictures import picture, sheet
from postfx.version import __version__

_ASSETS = Path(__file__).parent / "assets"


def page(title: str, name: str, scripts: Sequence[str], data: dict[str, Any]) -> str:
    """The file's text: the elements of `name`.html with the style of page.css and `name`.css, and
    the scripts.

    page.js runs before the `scripts`, which are files of `assets` and read `data` (JSON types) from
    a variable `data`.
    """
    parts = {
        "title": html.escape(title),
        "style": _part("page.css") + _part(f"{name}.css"),
        "body": _part(f"{name}.html"),
        "script": "".join(map(_part, ("page.js", *scripts))),
        "data": _as_script(data),
    }
    return _fill(_part("page.html"), parts)


def _as_script(data: dict[str, Any]) -> str:
    """JSON that cannot end the HTML element around it."""
    text = json.dumps(data, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _fill(template: str, parts: dict[str, str]) -> str:
    """The template with each `{{name}}` replaced; inserted text is not searched again."""
    pieces = template.split("{{")
    return pieces[0] + "".join(parts[name] + rest
                               for name, _, rest in (piece.partition("}}") for piece in pieces[1:]))


def _part(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


REPORT_SCRIPTS = ("report_light.js", "report_viewer.js", "report_charts.js", "report.js")


def write_report(
    path: Path, title: str, log: FrameLog, facts: Mapping[str, dict[str, Any]],
    sheets: Mapping[str, list[dict[str, Any]]], run: dict[str, Any] | None = None,
) -> None:
    """Write the page. Raises WriteError.

    log: data of the frames. facts: view ('' if there is only one) -> facts about the input, as
    `postfx inspect --json` prints them. sheets: view -> pictures of all planes of the input's first
    frame, by `postfx.doctor.inspection.contact_sheet`.
    run: as `postfx run --json` prints it, with 'plan', the text of --explain.
    """
    data = {
        "postfx": __version__,
        "display": log.look.display,
        "longest": LONGEST_SIDE_PX,
        "frames": log.frames(),
        "numbers": [row.number for row in log.rows],
        "cuts": [row.number for row in log.rows if row.cut],
        "charts": charts(log.rows),
        "readings": {row.number: row.readings for row in log.rows},
        "facts": next(iter(facts.values())),
        "views": facts,
        "sheet": [{**one, "view": view} for view, planes in sheets.items() for one in planes],
        "run": run,
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, page(title, "report", REPORT_SCRIPTS, data))
    except OSError as error:
        raise WriteError(f"report '{path}' cannot be written: {error.strerror or error}") from error


PAGE = "capture.html"
CAPTURE_SCRIPTS = ("capture_graph.js", "network_layout.js", "network_graph.js", "network_rows.js",
                   "network_details.js", "capture.js")
Draw = Callable[[Snapshot], list[dict[str, Any]]]


def write_capture(capture: Capture, folder: str | Path, title: str) -> Path:
    """Write `folder / capture.html` and `folder / capture.json`; returns the path of the page.

    Raises WriteError if they cannot be written: what was there before then stays, and what this
    capture kept of tensors is removed. Else what captures before kept is.
    """
    folder = Path(folder)
    data = as_dict(capture)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_texts({folder / CAPTURE_FILE: json.dumps(data, indent=1, allow_nan=False),
                     folder / PAGE: _page(capture, data, title)})
    except OSError as error:
        capture.discard()
        raise WriteError(f"capture in '{folder}' cannot be written: "
                         f"{error.strerror or error}") from error
    capture.remove_older()
    return folder / PAGE


def _page(capture: Capture, data: dict[str, Any], title: str) -> str:
    dispatches = [dispatch for buffer in capture.buffers for dispatch in buffer.dispatches]
    pictures = _Pictures()
    pairs = zip(data["commands"], dispatches, strict=True)
    commands = [_with_pictures(command, dispatch, pictures) for command, dispatch in pairs]
    facts = {**data, "commands": commands, "pictures": pictures.sets, "networks": _networks(data)}
    return page(title, "capture", CAPTURE_SCRIPTS, facts)


class _Pictures:
    """Pictures of snapshots, each once: an input that ten commands read has one snapshot."""

    def __init__(self) -> None:
        self.sets: list[list[dict[str, Any]]] = []
        self._known: dict[int, int] = {}

    def add(
        self, plain: list[dict[str, Any]], values: Sequence[CapturedValue], draw: Draw
    ) -> list[dict[str, Any]]:
        """The values' entries with 'pictures', a number in `sets` or None."""
        return [{**entry, "pictures": self._number(v.snapshot, draw)}
                for entry, v in zip(plain, values, strict=True)]

    def _number(self, snapshot: Snapshot | None, draw: Draw) -> int | None:
        if snapshot is None or not snapshot.pictures:
            return None
        if id(snapshot) not in self._known:
            self._known[id(snapshot)] = len(self.sets)
            self.sets.append(draw(snapshot))
        return self._known[id(snapshot)]


def _with_pictures(plain: dict[str, Any], dispatch: CapturedDispatch,
                   pictures: _Pictures) -> dict[str, Any]:
    """A command's entry with numbers of pictures, and its nodes' entries likewise."""
    accesses = {key: pictures.add(plain[key], getattr(dispatch, key), _pictures)
                for key in ("reads", "writes")}
    if dispatch.network is None:
        return {**plain, **accesses}
    pairs = zip(plain["network"]["nodes"], dispatch.network.nodes, strict=True)
    nodes = [{**entry, "outputs": pictures.add(entry["outputs"], node.outputs, _node_picture)}
             for entry, node in pairs]
    return {**plain, **accesses, "network": {**plain["network"], "nodes": nodes}}


def _node_picture(snapshot: Snapshot) -> list[dict[str, Any]]:
    count = len(snapshot.pictures)
    label = "the only channel" if count == 1 else f"channels 0 to {count - 1}"
    return [{**sheet(snapshot.pictures), "label": label}]


def _pictures(snapshot: Snapshot) -> list[dict[str, Any]]:
    """The first three slices as one picture and, if all slices were captured, each as a picture of
    its own."""
    slices = snapshot.pictures
    together = slices[:3]
    label = ("the only channel" if snapshot.channels == 1
             else f"channels 0 to {len(together) - 1} as colour")
    pictures = [{**picture(together), "label": label}]
    if snapshot.file is None or len(slices) == 1:
        return pictures
    return pictures + [{**picture([one]), "label": f"channel {number}"}
                       for number, one in enumerate(slices)]


def _networks(data: dict[str, Any]) -> list[dict[str, Any]]:
    """Each network once for every size at which it ran, with the numbers of its 'commands'."""
    ran: dict[tuple[str, tuple[tuple[str, int], ...]], list[int]] = {}
    for command in data["commands"]:
        if command["model"]:
            ran.setdefault((command["model"], tuple(command["dims"].items())),
                           []).append(command["index"])
    return [{**describe(Path(model), dict(dims)), "commands": numbers}
            for (model, dims), numbers in ran.items()]


class FrameCapture:
    """Capture one frame of a run, for --capture; all other frames run as usual.

    Args:
        folder: where to write.
        number: frame number; None for the second frame that is processed.
        tensors, network: as for `Device.capture`.
        check: whether to check that the folder can be written.

    Raises WriteError if the folder cannot be written; CaptureError if options do not fit together,
    or if a package that they need is missing.

    Attributes:
        page: path of the page; None before it is written.
        warnings: why there is no page, if the frame failed.
    """

    def __init__(self, device: Device, folder: str, number: int | None = None,
                 tensors: str = "thumbnails", network: bool = False, check: bool = True) -> None:
        self.page: str | None = None
        self.warnings: list[str] = []
        self._following: list[int] = []  # frames to capture instead of one that fails
        self._device, self._number, self._tensors, self._network = device, number, tensors, network
        self._folder = Path(folder)
        self._make_capture()  # raises its errors now, and not after the first frames
        if check:
            check_folder(self._folder, "capture")

    def choose(self, numbers: Sequence[int]) -> None:
        """Choose among the frames that will be processed, in their order. Raises SequenceError if
        the number is none of them.

        Without --capture-frame it is the second frame, which has a history, or the first if there
        is no other.
        """
        if not numbers:
            return
        if self._number is None:
            self._number, *self._following = numbers[min(1, len(numbers) - 1):]
        if self._number not in numbers:
            raise SequenceError(f"frame {self._number} of --capture-frame is not processed: take "
                                "one that is")

    @contextmanager
    def around(self, number: int) -> Iterator[None]:
        """Context in which a frame is processed. For the frame to capture it writes the capture at
        the end, even if a command fails. If the frame fails before any command, the next one is
        captured, unless --capture-frame names it.
        """
        if self.page or number != self._number:
            yield
            return
        capture = self._make_capture()
        try:
            with capture:
                yield
        except CommandError:  # then the capture is needed most
            self._write(capture, number)
            raise
        except BaseException:
            capture.discard()
            raise
        if capture.buffers:
            self._write(capture, number)
        elif self._following:
            self._number = self._following.pop(0)
        else:
            self.warnings = [f"frame {number} could not be processed: nothing was captured"]

    def _make_capture(self) -> Capture:
        return self._device.capture(self._tensors, self._folder if self._tensors == "all" else None,
                                    self._network)

    def _write(self, capture: Capture, number: int) -> None:
        self.page = str(write_capture(capture, self._folder, f"postfx capture: frame {number}"))

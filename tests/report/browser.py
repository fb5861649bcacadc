"""Pages in headless Chromium: the elements that a page's scripts make, or a page to look at, click
and drag in."""

from __future__ import annotations

import base64
import fcntl
import json
import os
import re
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
ENVIRONMENT = {"DBUS_SESSION_BUS_ADDRESS": "disabled:"}


def program() -> str:
    """The browser; skips where there is none."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"none of {', '.join(NAMES)} is installed")
    return found


class Tab:
    """An open page, driven by the DevTools protocol over pipes.

    Attributes:
        problems: uncaught errors and what the page or the browser logged as warning or error.
        requests: addresses that the page asked for, its own included.
    """

    def __init__(self, commands: Any, answers: Any) -> None:
        self._commands, self._answers = commands, answers
        self._count, self._session = 0, None
        self._read = bytearray()
        self.problems: list[str] = []
        self.requests: list[str] = []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target,
                                   flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")

    def open(self, page: Path, width: int = 1400, height: int = 1000, dark: bool = False) -> None:
        """Load a page into a window of this size."""
        media = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self._call("Emulation.setEmulatedMedia", features=media)
        self._call("Emulation.setDeviceMetricsOverride", width=width, height=height,
                   deviceScaleFactor=1, mobile=False)
        self._call("Page.navigate", url=page.as_uri())
        self.value("new Promise(done => document.readyState === 'complete' ? done() : "
                   "addEventListener('load', done))")

    def leave(self) -> None:
        """Leave the page, and forget its problems and requests."""
        self._call("Page.navigate", url="about:blank")
        self.problems.clear()
        self.requests.clear()

    def rendered(self, page: Path, script: str = "") -> str:
        """A page's elements after its scripts ran, and `script` after them."""
        scripted = page.with_name(f"scripted_{page.name}")
        text = page.read_text(encoding="utf-8")
        scripted.write_text(text.replace("</body>", f"<script>{script}</script></body>"),
                            encoding="utf-8")
        self.open(scripted)
        found = self.value("document.documentElement.outerHTML")
        return re.sub(r"<script.*?</script>", "", found, flags=re.DOTALL)

    def value(self, expression: str) -> Any:
        """What a JavaScript expression gives, awaited if it is a promise."""
        found = self._call("Runtime.evaluate", expression=expression, awaitPromise=True,
                           returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def drag(self, selector: str, start: float, end: float) -> None:
        """Press the mouse in an element, at a share of its width, and let go at another one."""
        box = self.value(f"""(() => {{ const one = document.querySelector({selector!r});
            one.scrollIntoView({{ block: "center" }});
            return one.getBoundingClientRect().toJSON(); }})()""")
        y = box["y"] + box["height"] / 2
        places = [box["x"] + box["width"] * share for share in (start, (start + end) / 2, end, end)]
        for kind, x in zip(("mousePressed", "mouseMoved", "mouseMoved", "mouseReleased"), places,
                           strict=True):
            self._call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1,
                       clickCount=1)

    def press(self, key: str) -> None:
        """Press and release a key, such as 'ArrowRight'."""
        for kind in ("keyDown", "keyUp"):
            self._call("Input.dispatchKeyEvent", type=kind, key=key, code=key,
                       windowsVirtualKeyCode={"ArrowLeft": 37, "ArrowRight": 39, "Home": 36}[key])

    def picture(self, path: Path) -> np.ndarray:
        """A PNG of the window at `path`, and its pixels (height, width, 3), uint8."""
        shot = self._call("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(shot["data"]))
        pixels = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)
        assert pixels is not None, path
        return pixels[..., :3]

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        message |= {"sessionId": self._session} if self._session else {}
        self._commands.write(json.dumps(message).encode() + b"\0")
        self._commands.flush()
        while (answer := self._next()).get("id") != self._count:
            self._note(answer)
        assert "error" not in answer, (method, answer["error"])
        return answer["result"]

    def _next(self) -> dict[str, Any]:
        begin = 0
        while (end := self._read.find(b"\0", begin)) < 0:
            begin = len(self._read)
            self._read += (more := self._answers.read1())
            assert more, "the browser ended"
        message = json.loads(self._read[:end])
        del self._read[:end + 1]
        return message

    def _note(self, event: dict[str, Any]) -> None:
        method, facts = event.get("method"), event.get("params", {})
        if method == "Network.requestWillBeSent":
            self.requests.append(facts["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.problems.append(facts["exceptionDetails"].get("exception", {})
                                 .get("description", "exception"))
        elif (method == "Runtime.consoleAPICalled"
              and facts["type"] in ("error", "warning", "assert")):
            self.problems.append(json.dumps(facts["args"]))
        elif method == "Log.entryAdded" and facts["entry"]["level"] in ("error", "warning"):
            self.problems.append(facts["entry"]["text"])


@contextmanager
def chromium(folder: Path) -> Iterator[Tab]:
    """A tab of a browser whose own files are in `folder`. Skips where there is no Chromium."""
    browser = program()
    options = [*OPTIONS, f"--user-data-dir={folder / 'browser'}", "--remote-debugging-pipe"]
    (command_end, commands), (answers, answer_end) = os.pipe(), os.pipe()
    ends = [fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10) for end in (command_end, answer_end)]
    actions: list[tuple[Any, ...]]
    actions = [(os.POSIX_SPAWN_OPEN, quiet, os.devnull, os.O_WRONLY, 0) for quiet in (1, 2)]
    actions += [(os.POSIX_SPAWN_DUP2, end, wanted)
                for end, wanted in zip(ends, (3, 4), strict=True)]
    process = os.posix_spawn(browser, [browser, *options], os.environ | ENVIRONMENT,
                             file_actions=actions)
    for end in (command_end, answer_end, *ends):
        os.close(end)
    try:
        with os.fdopen(commands, "wb") as into, os.fdopen(answers, "rb") as out:
            yield Tab(into, out)
    finally:
        os.kill(process, signal.SIGTERM)
        os.waitpid(process, 0)

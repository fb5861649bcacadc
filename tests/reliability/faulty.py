"""`postfx` with faults, in a process of its own: see `Faulty`.

A fault is a mapping: `at`, the dotted name of a function that is called by its module's name; `do`,
one of kill (SIGKILL to this process), sleep, fail (ReadError), full (OSError: no space left),
damage (do `how` to `file`) and clock (it goes back by `seconds` for good); `when`, before (default)
or after the call; `of`, what the arguments must name; `calls`, numbers of such calls from 1 on that
it happens at, or all of them without; `seconds` of sleep.
"""

import errno
import importlib
import itertools
import multiprocessing
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import postfx.cli.job  # noqa: F401 - what a run would import first
import postfx.colour.views  # noqa: F401
import postfx.passes.composite  # noqa: F401
import postfx.passes.denoise  # noqa: F401
import postfx.passes.tonemap  # noqa: F401
from postfx.cli.main import main
from postfx.errors import ReadError

Fault = Mapping[str, Any]
"""What happens where, see above."""
WRITE = "postfx.cli.run_setup.write_frame"
"""Where a run writes a frame."""


def make_folder(path: Path) -> None:
    """Put a folder where a file is."""
    path.unlink(missing_ok=True)
    path.mkdir()


DAMAGE: dict[str, Callable[[Path], object]] = {
    "gone": lambda path: path.unlink(missing_ok=True),
    "emptied": lambda path: path.write_bytes(b""),
    "cut short": lambda path: path.write_bytes(path.read_bytes()[:path.stat().st_size // 2]),
    "no picture": lambda path: path.write_bytes(b"no picture" * 50),
    "of one frame later": lambda path: path.write_bytes(
        path.with_name(re.sub(r"(\d+)(?=\.\w+$)", lambda digits: f"{int(digits[1]) + 1:04d}",
                              path.name)).read_bytes()),
    "a folder": make_folder,
}
"""What may happen to a file while a run is under way."""


def turn_back(seconds: float) -> None:
    """Let the clock of this process show an earlier time."""
    now = time.time
    vars(time)["time"] = lambda: now() - seconds


def act(fault: Fault) -> None:
    if fault["do"] == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault["do"] == "sleep":
        time.sleep(fault["seconds"])
    elif fault["do"] == "fail":
        raise ReadError("a read that failed for once")
    elif fault["do"] == "damage":
        DAMAGE[fault["how"]](Path(fault["file"]))
    elif fault["do"] == "clock":
        turn_back(fault["seconds"])
    elif fault["do"] == "full":
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def install(fault: Fault) -> None:
    module_name, _, name = fault["at"].rpartition(".")
    try:
        owner = importlib.import_module(module_name)
    except ModuleNotFoundError:
        parent, _, kind = module_name.rpartition(".")
        owner = getattr(importlib.import_module(parent), kind)
    original, count = getattr(owner, name), itertools.count(1)

    def faulty(*arguments: Any, **options: Any) -> Any:
        meant = fault.get("of", "") in " ".join(map(str, arguments))
        happens = meant and ("calls" not in fault or next(count) in fault["calls"])
        if happens and fault.get("when", "before") == "before":
            act(fault)
        result = original(*arguments, **options)
        if happens and fault.get("when") == "after":
            act(fault)
        return result

    setattr(owner, name, faulty)


def run(faults: list[Fault], arguments: list[str], said: str) -> NoReturn:
    os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), sys.stderr.fileno())
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    for fault in faults:
        install(fault)
    sys.exit(main(arguments))


class Faulty:
    """A process of `postfx ARGUMENTS` with faults, like subprocess.Popen. What it says goes to the
    file `said`.

    It is forked from one that has imported everything and made nothing yet, which spares a second
    or two each time.
    """

    def __init__(self, faults: list[Fault], arguments: list[str], said: Path) -> None:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([__name__])
        self._process = context.Process(target=run, args=(faults, arguments, str(said)),
                                        daemon=True)
        self._process.start()
        self.pid, self._said = self._process.pid, said

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        assert self.pid is not None, "it was started"
        os.kill(self.pid, number)

    def wait(self, timeout: float) -> int:
        """Its exit code. One that does not end in time is killed, as Python would wait for it at
        the end of all tests."""
        self._process.join(timeout)
        code = self.returncode
        if code is None:
            self._process.kill()
            self._process.join()
        assert code is not None, f"it does not end within {timeout:g} s: {self.said()}"
        return code

    def said(self) -> str:
        return self._said.read_text() if self._said.exists() else ""

    def finished(self, timeout: float = 120) -> tuple[int, str]:
        """Exit code and what was said, at its end."""
        code = self.wait(timeout)
        return code, self.said()

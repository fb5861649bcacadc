"""Short shots, runs in this process or in one of their own, and files compared byte by byte."""

import json
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import OpenImageIO as oiio
import pytest

from postfx.cli.main import main
from postfx.runtime import Device, Library, ModelError
from postfx.runtime import session as session_module
from tests.reliability.faulty import Fault, Faulty

FRAMES = 8
SIZE = (32, 48)
WAITS_S = 120.0
"""Seconds that a test waits for what a run logs."""


def write_frame(path: Path, number: int, reset: bool = False, gain: float = 1.0,
                size: tuple[int, int] = SIZE) -> None:
    """One small noisy frame of a brightening, moving pattern."""
    rng = np.random.default_rng(number)
    y, x = np.mgrid[: size[0], : size[1]]
    light = (1.2 + np.sin((x + 2 * number) / 5) * np.cos(y / 7)) * 1.1**number * gain
    noise = rng.gamma(2, 0.5, (*size, 3))
    planes = np.dstack([light[..., None] * noise, np.full(size, 3.0), np.full(size, 2.0),
                        np.zeros(size)])
    spec = oiio.ImageSpec(size[1], size[0], 6, "float")
    spec.channelnames = ("R", "G", "B", "depth.Z", "motion.X", "motion.Y")
    if reset:
        spec.attribute("postfx:reset", 1)
    output = oiio.ImageOutput.create(str(path))
    assert output is not None, oiio.geterror()
    assert (output.open(str(path), spec) and output.write_image(planes.astype(np.float32))
            and output.close())


@pytest.fixture(scope="session")
def shot(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Pattern of eight frames."""
    folder = tmp_path_factory.mktemp("shot")
    for number in range(1, FRAMES + 1):
        write_frame(folder / f"in.{number:04d}.exr", number)
    return str(folder / "in.####.exr")


QUICK = ("--no-denoise", "--tonemap", "--threads", "1")
"""Passes with a history (the exposure's and the tone mapper's) that take no time."""


class Runs:
    """Runs `postfx` with frames of one shot into one folder."""

    def __init__(self, shot: str, folder: Path,
                 capsys: pytest.CaptureFixture[str]) -> None:
        self.shot = shot
        self.folder = folder
        self.log = folder.parent / f"{folder.name}.jsonl"
        self._capsys = capsys
        self._started = 0

    def arguments(self, *more: str, passes: tuple[str, ...] = QUICK) -> list[str]:
        return ["run", self.shot, "-o", str(self.folder / "out.####.exr"), "--log", str(self.log),
                *passes, *more]

    def __call__(self, *more: str, passes: tuple[str, ...] = QUICK) -> tuple[int, str]:
        """Run in this process; gives the exit code and what was said."""
        code = main(self.arguments(*more, passes=passes))
        return code, self._capsys.readouterr().err

    def verify(self) -> tuple[int, dict[str, Any]]:
        code = main(["verify", str(self.folder), "--json"])
        return code, json.loads(self._capsys.readouterr().out)

    def start(self, faults: list[Fault], *more: str, passes: tuple[str, ...] = QUICK) -> Faulty:
        """Start a process of its own, with faults."""
        self._started += 1
        said = self.folder.parent / f"{self.folder.name}.{self._started}.txt"
        return Faulty(faults, self.arguments(*more, passes=passes), said)

    def fail(self, *faults: Fault, more: tuple[str, ...] = (),
             passes: tuple[str, ...] = QUICK) -> tuple[int, str]:
        """Run with faults to the end, whatever it is; gives the exit code and what was said."""
        return self.start(list(faults), *more, passes=passes).finished()

    def killed(self, at: str, call: int, when: str = "before", of: str = "",
               passes: tuple[str, ...] = QUICK, more: tuple[str, ...] = ()) -> None:
        """Run until a call of a function, at which the process is killed."""
        fault = {"at": at, "do": "kill", "calls": [call], "when": when, "of": of}
        code, said = self.fail(fault, passes=passes, more=more)
        assert code == -signal.SIGKILL, said

    def wait_for(self, process: Faulty, event: str, count: int = 1,
                 seconds: float = WAITS_S) -> None:
        """Wait until the log has so many events of a kind, but not longer than the process that
        writes them runs."""
        end = time.monotonic() + seconds
        while True:
            has_ended = process.returncode is not None  # before the log is read for the last time
            if len(self.events(event)) >= count:
                return
            if has_ended or time.monotonic() > end:
                code = process.wait(0) if has_ended else None
                raise AssertionError(f"event {count} of '{event}' did not come, exit code {code}: "
                                     f"{process.said()}")
            time.sleep(0.02)

    def events(self, kind: str | None = None) -> list[dict[str, Any]]:
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return [item for item in map(json.loads, lines) if kind in (None, item["event"])]

    def files(self) -> dict[str, bytes]:
        """Every frame's bytes, by name."""
        return {path.name: path.read_bytes() for path in sorted(self.folder.glob("out.*.exr"))}


@pytest.fixture
def runs(shot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Runs:
    """Runs into an empty folder."""
    return Runs(shot, tmp_path / "out", capsys)


@pytest.fixture(scope="session")
def unbroken(shot: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Files of a run that nothing happened to."""
    folder = tmp_path_factory.mktemp("unbroken")
    assert main(["run", shot, "-o", str(folder / "out.####.exr"), *QUICK]) == 0
    return {path.name: path.read_bytes() for path in sorted(folder.glob("out.*.exr"))}


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Loads a model without a card, or with one, and gives the one line with which it is
    refused."""
    def touched(*_: object, **__: object) -> NoReturn:
        raise AssertionError("ONNX Runtime was handed the model")

    def load(model: Any, card: Mapping[str, Any] | None = None) -> str:
        content = model if isinstance(model, bytes) else model.SerializeToString()
        (tmp_path / "models").mkdir(exist_ok=True)
        (tmp_path / "models/bad.onnx").write_bytes(content)
        if card is not None:
            (tmp_path / "models/bad.json").write_text(json.dumps(card))
        monkeypatch.setattr(session_module.ort, "InferenceSession", touched)
        with pytest.raises(ModelError) as caught:
            Device("cpu").pipeline_state(Library(tmp_path / "models"), "bad", {"height": 4})
        assert ("models/" in str(caught.value) and "\n" not in str(caught.value)
                and len(str(caught.value)) < 500)
        return str(caught.value)

    return load

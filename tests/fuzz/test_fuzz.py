"""A thousand inputs of coverage-guided fuzzing of everything that reads what others wrote."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from postfx.errors import PostfxError
from tests.fuzz import fuzz
from tests.fuzz.targets import TARGETS

RUNS, SEED = 1000, 1
"""Inputs of each target, nearly the same each time: what chance finds must not stop others. Look for more by hand."""
SECONDS = 60
"""After which a very busy machine has tried enough."""
AT_ONCE = 2
BY_A_SHELL = ("sh", "-c", '"$@"; exit $?', "sh")
"""A process's peak memory begins with that of the process that starts it, which ran other tests: a shell is small."""


def run(target: str, out: Path) -> subprocess.CompletedProcess:
    out.mkdir()
    script = Path(__file__).with_name("fuzz.py")
    command = [*BY_A_SHELL, sys.executable, str(script), target, str(SECONDS), f"-seed={SEED}", f"-runs={RUNS}"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=900, errors="replace",
                          env={**os.environ, "POSTFX_FUZZ_OUT": str(out), "PYTHONHASHSEED": "0"})


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future]]:
    """What came of each target; a few run at once."""
    pytest.importorskip("atheris")
    folder = tmp_path_factory.mktemp("fuzz")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield {target: pool.submit(run, target, folder / target) for target in TARGETS}
        pool.shutdown(cancel_futures=True)


@pytest.mark.parametrize("target", TARGETS)
def test_any_input_is_read_or_refused_in_one_line(target: str, fuzzed: dict[str, Future]) -> None:
    """No crash, no hang, no memory over the limit; more with `python tests/fuzz/fuzz.py TARGET SECONDS`."""
    done = fuzzed[target].result()
    assert done.returncode == 0, "".join(done.stderr.partition("=== Uncaught")[1:])[:3000] or done.stderr[-3000:]
    runs = [line for line in done.stderr.splitlines() if line.startswith("stat::number_of_executed_units")]
    assert int(runs[0].split()[-1]) > 20, done.stderr[-2000:]


def compute(_: bytes) -> None:
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass


@pytest.mark.parametrize(("target", "said"), [
    (lambda content: os.listdir("/"), r"looked at \['/'\]"), (compute, "computed for 0.2"),
    (lambda content: {}[content], "b'input'"),
])
def test_what_looks_elsewhere_or_computes_for_long_is_found(target: Callable[[bytes], None], said: str,
                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "LONGEST_S", 0.1)
    with pytest.raises((AssertionError, KeyError), match=said):
        fuzz.limit(target, fuzz.Fence(sys.prefix))(b"input")


def test_a_busy_machine_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """What waits computes nothing, and an error in words is what a target is for."""
    def wait(content: bytes) -> None:
        time.sleep(0.3)
        raise PostfxError("frame 7: is no picture: render it again")

    monkeypatch.setattr(fuzz, "LONGEST_S", 0.2)
    fuzz.limit(wait, fuzz.Fence(sys.prefix))(b"input")

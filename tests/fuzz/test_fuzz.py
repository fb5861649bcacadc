"""Hundreds of inputs of coverage-guided fuzzing of everything that reads what others wrote."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from postfx.errors import PostfxError
from tests.fuzz import fuzz
from tests.fuzz.targets import TARGETS

SEED = 1
"""Nearly the same inputs each time: what chance finds must not stop others. Look for more by
hand."""
RUNS = [300, pytest.param(3000, marks=pytest.mark.soak)]
"""Inputs of each target."""
SECONDS = 120
"""After which a very busy machine has tried enough of a target."""
BY_A_SHELL = ("sh", "-c", '"$@"; exit $?', "sh")
"""A process's peak memory begins with that of the process that starts it, which ran other tests: a
shell is small."""


@pytest.fixture(scope="module", params=RUNS)
def fuzzed(request: pytest.FixtureRequest,
           tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Target -> exit code, and what was said. One process imports for all: that takes longer than
    some of them."""
    pytest.importorskip("atheris")
    out, script = tmp_path_factory.mktemp("fuzz"), Path(__file__).with_name("fuzz.py")
    command = [*BY_A_SHELL, sys.executable, str(script), ",".join(TARGETS), str(SECONDS),
               f"-seed={SEED}", f"-runs={request.param}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, errors="replace",
                          env={**os.environ, "POSTFX_FUZZ_OUT": str(out), "PYTHONHASHSEED": "0"})
    codes = dict(line.split() for line in done.stdout.splitlines()[-len(TARGETS):])
    assert list(codes) == list(TARGETS), done.stderr[-3000:]
    return {target: (int(code), (out / f"{target}.log").read_text(errors="replace"))
            for target, code in codes.items()}


@pytest.mark.parametrize("target", TARGETS)
def test_any_input_is_read_or_refused_in_one_line(target: str,
                                                  fuzzed: dict[str, tuple[int, str]]) -> None:
    """No crash, no hang, no memory over the limit; more with `python tests/fuzz/fuzz.py TARGET
    SECONDS`."""
    code, said = fuzzed[target]
    assert code == 0, "".join(said.partition("=== Uncaught")[1:])[:3000] or said[-3000:]
    runs = [line for line in said.splitlines() if line.startswith("stat::number_of_executed_units")]
    assert int(runs[0].split()[-1]) > 20, said[-2000:]


def compute(_: bytes) -> None:
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass


@pytest.mark.parametrize(("target", "said"), [
    (lambda content: os.listdir("/"), r"looked at \['/'\]"), (compute, "computed for 0.2"),
    (lambda content: {}[content], "b'input'"),
])
def test_what_looks_elsewhere_or_computes_for_long_is_found(
    target: Callable[[bytes], None], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
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

"""A few seconds of coverage-guided fuzzing of everything that reads what others wrote."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.fuzz.targets import TARGETS

SECONDS = 3
AT_ONCE = 2
BY_A_SHELL = ("sh", "-c", '"$@"; exit $?', "sh")
"""A process's peak memory begins with that of the process that starts it, which ran other tests: a shell is small."""


def fuzz(target: str, out: Path) -> subprocess.CompletedProcess:
    out.mkdir()
    script = Path(__file__).with_name("fuzz.py")
    return subprocess.run([*BY_A_SHELL, sys.executable, str(script), target, str(SECONDS)], capture_output=True,
                          text=True, check=False, timeout=180, errors="replace",
                          env={**os.environ, "POSTFX_FUZZ_OUT": str(out)})


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Future]]:
    """What came of each target; a few run at once."""
    pytest.importorskip("atheris")
    folder = tmp_path_factory.mktemp("fuzz")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield {target: pool.submit(fuzz, target, folder / target) for target in TARGETS}
        pool.shutdown(cancel_futures=True)


@pytest.mark.parametrize("target", TARGETS)
def test_any_input_is_read_or_refused_in_one_line(target: str, fuzzed: dict[str, Future]) -> None:
    """No crash, no hang, no memory over the limit; more with `python tests/fuzz/fuzz.py TARGET SECONDS`."""
    done = fuzzed[target].result()
    assert done.returncode == 0, done.stderr[-3000:]
    runs = [line for line in done.stderr.splitlines() if line.startswith("stat::number_of_executed_units")]
    assert int(runs[0].split()[-1]) > 20, done.stderr[-2000:]

"""postfx on other machines: by a Python for Windows, which wine runs, and by one for arm64, which
an emulator runs."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import OpenImageIO as oiio
import pytest

from tests import arm64_python, windows_python
from tests.kernels import foreign

ROOM = windows_python.REPOSITORY / "samples/room/noisy.####.exr"
NUMBERS = (1, 2, 3)
MOST_OFF_DB = -60.0
"""Mean square between pixels where networks round otherwise, of a picture's white."""
needs_wine = pytest.mark.skipif(foreign.WINE is None, reason="needs wine64")
needs_same_python = pytest.mark.skipif(sys.version_info[:2] != windows_python.VERSION,
                                       reason="needs Python 3.11")
needs_qemu = pytest.mark.skipif(foreign.QEMU is None, reason="needs qemu-aarch64")
needs_debian = pytest.mark.skipif(shutil.which("apt-get") is None, reason="needs Debian's apt-get")


@pytest.fixture(scope="module", params=[
    pytest.param(windows_python, id="windows", marks=(needs_wine, needs_same_python)),
    pytest.param(arm64_python, id="arm64", marks=(needs_qemu, needs_debian))])
def machine(request: pytest.FixtureRequest,
            tmp_path_factory: pytest.TempPathFactory) -> tuple[ModuleType, Path]:
    """What runs another machine's Python, and where that Python lies."""
    folder = tmp_path_factory.mktemp("machine")
    request.param.make(folder)
    return request.param, folder


@pytest.mark.soak
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs ziglang")
@pytest.mark.parametrize("model", ["s", "m", "xl"])
def test_the_command_writes_the_same_pixels(machine: tuple[ModuleType, Path], tmp_path: Path,
                                            model: str) -> None:
    """Denoised with history, and tone-mapped. All of them on Windows; on arm64 networks round
    otherwise in few places."""
    python, folder = machine
    if python is arm64_python and model == "xl":
        pytest.skip("takes a quarter of an hour in the emulator")
    same_bits = python is windows_python
    for ending in ("exr", "png"):
        words = ("-m", "postfx", "run", ROOM, "--frames", f"{NUMBERS[0]}-{NUMBERS[-1]}",
                 "--run-up", "0", "--model", model)
        here, there = tmp_path / f"here/a.####.{ending}", tmp_path / f"there/a.####.{ending}"
        subprocess.run([sys.executable, *words, "-o", here], check=True, capture_output=True)
        done = python.run(folder, *words, "-o", there)
        assert done.returncode == 0, done.stderr
        for number in NUMBERS:
            name = f"a.{number:04}.{ending}"
            found, wanted = pixels(there.parent / name), pixels(here.parent / name)
            off_db = 10 * np.log10(np.square(found - wanted).mean() + 1e-30)
            print(f"{name}: {np.mean(found != wanted):.2%} differ, {off_db:.1f} dB")
            assert np.array_equal(found, wanted) or not same_bits, name
            assert off_db <= MOST_OFF_DB, name
    done = python.run(folder, "-m", "postfx", "verify", tmp_path / "there")
    assert done.returncode == 0, done.stderr


def pixels(path: Path) -> np.ndarray:
    """All channels of a file, as its own type has them."""
    found = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
    assert found is not None
    return found

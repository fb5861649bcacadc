"""The CUDA kernels, run on the host, against the compiled rows."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.kernels.denoise_filter import MIX_LEVELS
from postfx.kernels.kernel import Kernel
from postfx.runtime import Device
from tests.kernels import host_cuda
from tests.kernels.denoise_cases import CASES, KERNELS, Case, arguments, run, shape
from tests.kernels.test_denoise_kernels import assert_same

pytestmark = pytest.mark.skipif(host_cuda.COMPILER is None, reason="no g++")

WRITTEN = [kernel for kernel in KERNELS if (host_cuda.FOLDER / f"{kernel.name}.cu").exists()]
RUNS = [(kernel, case) for kernel in WRITTEN for case in CASES if kernel is not MIX_LEVELS or case.heads > 25]


@pytest.fixture(scope="module")
def compiled() -> Device:
    return Device("cpu", threads=2)


@pytest.mark.parametrize("bad", [False, True], ids=["clean", "bad"])
@pytest.mark.parametrize(("kernel", "case"), RUNS, ids=lambda item: getattr(item, "name", str(item)))
def test_cuda_kernels_compute_what_the_compiled_rows_do(kernel: Kernel, case: Case, bad: bool, compiled: Device) -> None:
    inputs = arguments(kernel, case, bad=bad)
    found = {name: np.full(shape(kernel, name, case), np.nan, np.float32) for name in kernel.writes}
    host_cuda.run(kernel, inputs | found)
    assert_same(found, run(kernel, compiled, inputs, case))

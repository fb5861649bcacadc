"""The upscaler's kernels: compiled rows against the portable ONNX definitions."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.kernels.denoise_filter import MIX_LEVELS
from postfx.kernels.kernel import Kernel
from postfx.runtime import Device
from tests.kernels.denoise_cases import CASES, KERNELS, Case, arguments, run

TOLERANCE = 1e-4


@pytest.fixture(scope="module")
def compiled() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def portable() -> Device:
    return Device("cpu", threads=2, compiled_kernels=False)


def assert_same(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> None:
    for name, value in wanted.items():
        scale = max(1.0, float(np.abs(value).max()))
        np.testing.assert_allclose(found[name], value, atol=TOLERANCE * scale, rtol=TOLERANCE, err_msg=name)


RUNS = [(kernel, case) for kernel in KERNELS for case in CASES if kernel is not MIX_LEVELS or case.heads > 25]


@pytest.mark.parametrize("bad", [False, True], ids=["clean", "bad"])
@pytest.mark.parametrize(("kernel", "case"), RUNS, ids=lambda item: getattr(item, "name", str(item)))
def test_compiled_rows_match_the_portable_definition(
    kernel: Kernel, case: Case, bad: bool, compiled: Device, portable: Device
) -> None:
    inputs = arguments(kernel, case, bad=bad)
    found, wanted = run(kernel, compiled, inputs, case), run(kernel, portable, inputs, case)
    finite = {name: value for name, value in wanted.items() if name != "next_depth"}  # kept as it comes
    assert all(np.isfinite(value).all() for value in finite.values())
    assert_same(found, wanted)

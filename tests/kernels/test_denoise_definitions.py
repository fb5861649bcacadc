"""The upscaler's portable kernels against the torch definitions that they are exported from."""

from __future__ import annotations

import numpy as np
import pytest

from postfx.kernels import Kernel
from postfx.runtime import Device
from tests.kernels.denoise_cases import CASES, KERNELS, arguments, in_frame, run

torch = pytest.importorskip("torch")

from training.denoise.export import KERNELS as DEFINITIONS  # noqa: E402

TOLERANCE, WIDER = 1e-5, {"denoise_fit": 5e-5, "denoise_correct": 2e-5}
"""By the largest value; a fit of four numbers to nine pixels multiplies what is rounded."""


@pytest.fixture(scope="module")
def portable() -> Device:
    return Device("cpu", threads=2, compiled_kernels=False)


def test_every_kernel_has_a_definition() -> None:
    assert set(DEFINITIONS) == set(KERNELS)


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: kernel.name)
def test_portable_definition_matches_torch(kernel: Kernel, portable: Device) -> None:
    definition = DEFINITIONS[kernel]()
    for case in [case for case in CASES if case.heads > 25]:
        inputs = arguments(kernel, case)
        with torch.no_grad():
            results = definition(*(torch.from_numpy(inputs[name]) for name in kernel.reads))
        arrays = [x.numpy() for x in (results if isinstance(results, tuple) else (results,))]
        wanted = in_frame(kernel, dict(zip(kernel.writes, arrays, strict=True)), case)
        found = run(kernel, portable, inputs, case)
        for name, value in wanted.items():
            assert np.isfinite(value).all(), (name, case)
            np.testing.assert_allclose(found[name], value, rtol=0, atol=WIDER.get(
                kernel.name, TOLERANCE
            ) * max(1.0, np.abs(value).max()), err_msg=f"{name} {case}")

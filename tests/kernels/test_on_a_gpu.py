"""The CUDA kernels on a GPU, against the compiled rows."""

from __future__ import annotations

import pytest

from postfx.kernels import Kernel
from postfx.kernels.denoise import MIX
from postfx.kernels.denoise.prepare import ACCUMULATE
from postfx.runtime import Device
from postfx.runtime.device import cuda_fault
from tests.kernels.denoise_cases import ODD, arguments, run, runs_of
from tests.kernels.test_cuda_kernels import WRITTEN
from tests.kernels.test_denoise_kernels import assert_same


@pytest.fixture(scope="module")
def compiled() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def gpu() -> Device:
    return Device("cuda")


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
@pytest.mark.parametrize("kernel", WRITTEN, ids=lambda kernel: kernel.name)
def test_a_gpu_computes_what_the_compiled_rows_do(kernel: Kernel, gpu: Device,
                                                  compiled: Device) -> None:
    for case, bad in runs_of(kernel):
        inputs = arguments(kernel, case, bad=bad)
        assert_same(run(kernel, gpu, inputs, case), run(kernel, compiled, inputs, case),
                    f"{case} {bad}")


@pytest.mark.gpu
@pytest.mark.skipif(cuda_fault(0) is not None, reason="needs a GPU")
def test_the_last_channels_of_the_fine_head_are_enough(gpu: Device, compiled: Device) -> None:
    inputs = arguments(ACCUMULATE, ODD)
    inputs["fine"] = inputs["fine"][:, MIX:].copy()
    assert_same(run(ACCUMULATE, gpu, inputs, ODD), run(ACCUMULATE, compiled, inputs, ODD))

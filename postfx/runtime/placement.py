"""Choosing a device: its ONNX Runtime provider and its memory."""

from __future__ import annotations

import re
import warnings
from functools import cache

import onnxruntime as ort

from postfx.errors import DeviceError, PostfxError
from postfx.runtime.cuda import CudaMemory
from postfx.runtime.memory import HostMemory, Memory
from postfx.runtime.provider_memory import ProviderMemory
from postfx.runtime.session import Placement, first_line

_NAME = re.compile(r"(auto|cpu|cuda)(?::(\d+))?")


def choose(name: str, threads: int, graphs: bool = True) -> tuple[Placement, Memory]:
    """Placement and memory of 'cpu', 'cuda', 'cuda:1' or 'auto'. Raises DeviceError when it is not available."""
    match = _NAME.fullmatch(name)
    if match is None or (match[2] and match[1] != "cuda"):
        raise DeviceError(f"no device '{name}': use auto, cpu, cuda or cuda:N")
    index = int(match[2] or 0)
    fault = None if match[1] == "cpu" else cuda_fault(index)
    if match[1] == "cuda" and fault:
        raise DeviceError(f"device '{name}' is not available: {fault}")
    if match[1] == "cpu" or fault:
        return Placement("CPUExecutionProvider", "cpu", 0, threads), HostMemory()
    try:
        memory = CudaMemory(index, graphs)
    except DeviceError:
        placement = Placement("CUDAExecutionProvider", "cuda", index, threads)
        return placement, ProviderMemory(placement)
    return Placement("CUDAExecutionProvider", "cuda", index, threads, memory.stream), memory


@cache
def cuda_fault(index: int) -> str | None:
    """Why CUDA device `index` cannot be used, or None when a copy to it and back works."""
    if "CUDAExecutionProvider" not in ort.get_available_providers():
        return "this onnxruntime has no CUDA provider; install it by pip install 'postfx[cuda]'"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            getattr(ort, "preload_dlls", lambda: None)()  # since 1.21: CUDA libraries that came by pip
            ProviderMemory(Placement("CUDAExecutionProvider", "cuda", index, 1)).check()
    except (PostfxError, RuntimeError, OSError) as error:
        return first_line(error)
    return None

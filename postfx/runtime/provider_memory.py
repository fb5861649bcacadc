"""Memory of an execution provider that the host cannot see: chunks by ONNX Runtime, copies by a one-node model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime as ort

from postfx.errors import DeviceError
from postfx.runtime.memory import Immediate, address
from postfx.runtime.session import Placement, Session

_COPY = Path(__file__).with_name("copy.onnx")


class ProviderChunk:
    """A chunk that ONNX Runtime allocated on the provider's device."""

    def __init__(self, placement: Placement, nbytes: int) -> None:
        self._value = ort.OrtValue.ortvalue_from_shape_and_type([nbytes], np.uint8, placement.memory, placement.index)
        self.pointer = self._value.data_ptr()
        self.nbytes = nbytes


class ProviderMemory(Immediate):
    """Memory of `placement`. ONNX Runtime copies between devices where a session's inputs and outputs are bound, and
    waits at the end of each run."""

    host_visible = False

    def __init__(self, placement: Placement) -> None:
        self._placement = placement
        self._copy = Session(_COPY.read_bytes(), "copy", placement, {})

    def allocate(self, nbytes: int) -> ProviderChunk:
        """A new chunk on the device."""
        return ProviderChunk(self._placement, nbytes)

    def write(self, pointer: int, array: np.ndarray) -> None:
        """Copy a C-contiguous host array to the device."""
        self._copy.copy_bytes(("cpu", 0, address(array)), self._here(pointer), array.nbytes)

    def read(self, pointer: int, array: np.ndarray) -> None:
        """Copy from the device into a C-contiguous host array."""
        self._copy.copy_bytes(self._here(pointer), ("cpu", 0, address(array)), array.nbytes)

    def check(self) -> None:
        """Copy a few bytes to the device and back; DeviceError when they come back changed."""
        sent, received = np.arange(64, dtype=np.uint8), np.zeros(64, np.uint8)
        chunk = self.allocate(sent.nbytes)
        self.write(chunk.pointer, sent)
        self.read(chunk.pointer, received)
        if not np.array_equal(sent, received):
            raise DeviceError(f"a copy to {self._placement.memory} came back changed")

    def _here(self, pointer: int) -> tuple[str, int, int]:
        return self._placement.memory, self._placement.index, pointer

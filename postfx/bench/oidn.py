"""Open Image Denoise, through the package pyoidn."""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any

import numpy as np

from postfx.bench import require
from postfx.errors import BenchError
from postfx.frame import Frame, Role


class Oidn:
    """Denoises frames of one size one by one, with albedo and normal as clean auxiliary images where there are any.

    Args:
        quality: 'fast', 'balanced' or 'high'.
        device: 'cpu' or 'cuda'.
        threads: CPU threads.

    Attributes:
        milliseconds: sum of the time in the filter, without copies to the device and back.

    The albedo is the sum of the diffuse and the specular one, at most 1: better for OIDN than the diffuse one alone.
    Raises BenchError when pyoidn is not installed or OIDN cannot run there.
    """

    def __init__(self, quality: str, device: str, threads: int) -> None:
        require("pyoidn", "pyoidn", "runs Open Image Denoise")
        self._oidn: Any = import_module("pyoidn")
        self._quality = getattr(self._oidn, f"OIDN_QUALITY_{quality.upper()}")
        self._device = self._new_device(device, threads)
        self._host = device == "cpu"
        self._images: dict[str, Any] = {}
        self._filter: Any = None
        self.milliseconds = 0.0

    def __call__(self, frame: Frame) -> np.ndarray:
        """Denoised colour (h, w, 3) of a frame."""
        planes = _planes(frame)
        if self._filter is None:
            self._prepare(planes)
        for name, plane in planes.items():
            self._images[name].write(0, plane.nbytes, plane)
        begin = time.perf_counter()
        self._filter.execute()
        self._device.wait()
        self.milliseconds += 1e3 * (time.perf_counter() - begin)
        self._check()
        result = np.empty(planes["color"].shape, np.float32)
        self._images["output"].read(0, result.nbytes, result)
        return result

    def _new_device(self, name: str, threads: int) -> Any:
        if name == "cuda" and not self._oidn.Device.is_cuda_available():
            raise BenchError("OIDN finds no CUDA device: use --device cpu, or leave OIDN out by --methods")
        kind = self._oidn.OIDN_DEVICE_TYPE_CUDA if name == "cuda" else self._oidn.OIDN_DEVICE_TYPE_CPU
        device = self._oidn.Device(kind)
        if name == "cpu":
            device.set_int("numThreads", threads)
        device.commit()
        return device

    def _prepare(self, planes: dict[str, np.ndarray]) -> None:
        """Filter and images, which later frames of the same size use again."""
        height, width = planes["color"].shape[:2]
        self._filter = self._oidn.Filter(self._device, self._oidn.OIDN_FILTER_TYPE_RT)
        storage = self._oidn.OIDN_STORAGE_HOST if self._host else self._oidn.OIDN_STORAGE_DEVICE
        for name in (*planes, "output"):
            image = self._oidn.Buffer(self._device, planes["color"].nbytes, storage)
            self._filter.set_image(name, image, self._oidn.OIDN_FORMAT_FLOAT3, width, height)
            self._images[name] = image
        self._filter.set_bool("hdr", True)
        self._filter.set_bool("cleanAux", "albedo" in planes)
        self._filter.set_quality(self._quality)
        self._filter.commit()
        self._check()

    def _check(self) -> None:
        message = self._device.get_error()
        if message:
            raise BenchError(f"OIDN failed: {message}")


def _planes(frame: Frame) -> dict[str, np.ndarray]:
    """Images by OIDN's names. OIDN takes normals only together with an albedo, and no value that is not finite."""
    found = {"color": frame[Role.COLOUR]}
    albedos = [frame[role] for role in (Role.DIFFUSE_ALBEDO, Role.SPECULAR_ALBEDO) if role in frame]
    if albedos:
        found["albedo"] = np.clip(sum(albedos), 0, 1)
        if Role.NORMAL in frame:
            found["normal"] = frame[Role.NORMAL]
    finite = {name: np.nan_to_num(plane, posinf=0.0, neginf=0.0) for name, plane in found.items()}
    return {name: np.ascontiguousarray(plane, np.float32) for name, plane in finite.items()}

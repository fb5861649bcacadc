"""Open Image Denoise through the package pyoidn: its filters for pictures of one size after the
other."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial
from importlib import import_module, metadata
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from postfx.caching import LRUCache
from postfx.errors import DeviceError
from postfx.version import pip_install

OIDN_PACKAGE = "pyoidn"
QUALITIES = ("fast", "balanced", "high")
GUIDE_WAYS = ("clean", "prefiltered", "raw")
"""How albedo and normal are taken: as if they had no noise; each filtered alone first; as noisy
ones."""
MOST_COMMITTED_SIZES = 4
"""Most sizes and sets of planes whose filters stay committed."""


def is_installed() -> bool:
    """Whether the package is there; it is not imported."""
    return find_spec(OIDN_PACKAGE) is not None


def version() -> str:
    """The package's version, '' where it is not installed."""
    return metadata.version(OIDN_PACKAGE) if is_installed() else ""


def finds_cuda() -> bool:
    """Whether the filters can run on a CUDA device."""
    return bool(import_module(OIDN_PACKAGE).Device.is_cuda_available())


def require() -> None:
    """Raise DeviceError where the package is not installed."""
    if not is_installed():
        raise DeviceError(f"the package {OIDN_PACKAGE}, which runs Open Image Denoise, is not "
                          f"installed: {pip_install('oidn')}")


class Kind(NamedTuple):
    """Pictures that one set of filters is made for.

    Attributes:
        height, width: of the picture.
        aids: names of the planes beside it.
        planes: how these are taken, one of GUIDE_WAYS.
        hdr: whether the picture is light without a limit.
    """

    height: int
    width: int
    aids: tuple[str, ...]
    planes: str
    hdr: bool


class OpenImageDenoise:
    """Denoises pictures, by albedo and normal where they are given.

    By default albedo and normal are filtered alone first, each by a filter of its own, and are then
    clean for the picture's filter. So Open Image Denoise's guide advises for planes that are noisy
    themselves. Filters are committed once for each size.

    Args:
        quality: 'fast', 'balanced' or 'high'.
        device: 'cpu' or 'cuda'.
        threads: CPU threads.
        planes: how albedo and normal are taken, one of GUIDE_WAYS.

    Attributes:
        milliseconds: total time in the filters, without copies to and from the device.

    Raises DeviceError if the package is not installed, or the filters cannot run on the device.
    """

    def __init__(self, quality: str, device: str, threads: int,
                 planes: str = "prefiltered") -> None:
        require()
        self._oidn: Any = import_module(OIDN_PACKAGE)
        self._quality = getattr(self._oidn, f"OIDN_QUALITY_{quality.upper()}")
        self._planes = planes
        self._device = self._new_device(device, threads)
        self._ready: LRUCache[Kind, Filters] = LRUCache(MOST_COMMITTED_SIZES)
        self.milliseconds = 0.0

    def __call__(self, picture: np.ndarray, aids: Mapping[str, np.ndarray], output: np.ndarray,
                 hdr: bool = True) -> None:
        """Denoise a picture (h, w, 3) into `output`.

        Args:
            aids: 'albedo' (h, w, 3), and 'normal' beside it, which is not taken alone.
            hdr: whether the picture is light; if not, its values are 0 to 1.

        What is not a finite number counts as 0.
        """
        taken = {"albedo": aids["albedo"]} if "albedo" in aids else {}
        if taken and "normal" in aids:
            taken["normal"] = aids["normal"]
        height, width = picture.shape[:2]
        kind = Kind(height, width, tuple(taken), self._planes, hdr)
        filters = self._ready.get_or_make(kind, partial(Filters, self._oidn, self._device,
                                                        self._quality, kind))
        for name, plane in {"color": picture, **taken}.items():
            filters.write(name, plane)
        begin = time.perf_counter()
        filters.execute()
        self._device.wait()
        self.milliseconds += 1e3 * (time.perf_counter() - begin)
        self._check()
        filters.read(output)

    def _new_device(self, name: str, threads: int) -> Any:
        if name == "cuda" and not finds_cuda():
            raise DeviceError("Open Image Denoise finds no CUDA device: use the CPU, or leave it "
                              "out")
        kind = (self._oidn.OIDN_DEVICE_TYPE_CUDA if name == "cuda"
                else self._oidn.OIDN_DEVICE_TYPE_CPU)
        device = self._oidn.Device(kind)
        if name == "cpu":
            device.set_int("numThreads", threads)
        device.commit()
        return device

    def _check(self) -> None:
        message = self._device.get_error()
        if message:
            raise DeviceError(f"Open Image Denoise failed: {message}")


class Filters:
    """The committed filters for pictures of one kind, and the images that they read and write."""

    def __init__(self, oidn: Any, device: Any, quality: int, kind: Kind) -> None:
        self._oidn = oidn
        self._shape = kind.height, kind.width, 3
        nbytes = 4 * kind.height * kind.width * 3
        names = ("color", *kind.aids, "output")
        self._images = {name: oidn.Buffer(device, nbytes, oidn.OIDN_STORAGE_DEVICE)
                        for name in names}
        self._filters = [self._alone(device, quality, name)
                         for name in kind.aids if kind.planes == "prefiltered"]
        last = self._new(device, names)
        last.set_bool("hdr", kind.hdr)
        last.set_bool("cleanAux", bool(kind.aids) and kind.planes != "raw")
        self._commit(last, quality)
        self._filters.append(last)

    def write(self, name: str, plane: np.ndarray) -> None:
        """Set an image to a plane (h, w, 3)."""
        finite = np.nan_to_num(plane, nan=0.0, posinf=0.0, neginf=0.0)
        values = np.ascontiguousarray(finite, np.float32)
        self._images[name].write(0, values.nbytes, values)

    def execute(self) -> None:
        """Run all filters, in order."""
        for one in self._filters:
            one.execute()

    def read(self, output: np.ndarray) -> None:
        """Copy the denoised picture into an array."""
        found = np.empty(self._shape, np.float32)
        self._images["output"].read(0, found.nbytes, found)
        output[...] = found

    def _alone(self, device: Any, quality: int, name: str) -> Any:
        """A filter of an albedo or normal, in place."""
        made = self._new(device, (name,))
        made.set_image("output", self._images[name], self._oidn.OIDN_FORMAT_FLOAT3,
                       *self._shape[1::-1])
        self._commit(made, quality)
        return made

    def _new(self, device: Any, names: tuple[str, ...]) -> Any:
        made = self._oidn.Filter(device, self._oidn.OIDN_FILTER_TYPE_RT)
        for name in names:
            made.set_image(name, self._images[name], self._oidn.OIDN_FORMAT_FLOAT3,
                           *self._shape[1::-1])
        return made

    def _commit(self, made: Any, quality: int) -> None:
        made.set_quality(quality)
        made.commit()


def total_albedo(*albedos: np.ndarray) -> np.ndarray:
    """The albedo that Open Image Denoise wants: all that surfaces reflect, at most 1."""
    finite = [np.nan_to_num(albedo, nan=0.0, posinf=1.0, neginf=0.0) for albedo in albedos]
    total: np.ndarray = np.clip(np.sum(finite, axis=0), 0, 1)
    return total

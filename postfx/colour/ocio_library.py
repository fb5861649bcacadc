"""OpenColorIO itself: by its own package `opencolorio` where that is installed, else as OpenImageIO
carries it.

The package is newer than the copy in OpenImageIO's wheel, and has more built-in configs. Both give
the same colours for the same config.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module, metadata
from importlib.util import find_spec
from typing import Any

import numpy as np
import OpenImageIO as oiio

from postfx.errors import ColourError
from postfx.version import pip_install

OCIO_PACKAGE = "opencolorio"
_MODULE = "PyOpenColorIO"

Colours = Callable[[np.ndarray], np.ndarray]
"""Colours (count, 3) float32 to others. Raises RuntimeError with the reason where it cannot be
done."""


class Config(ABC):
    """A config of OpenColorIO.

    Attributes:
        displays, spaces, roles: the names that it has.
    """

    displays: Sequence[str]
    spaces: Sequence[str]
    roles: Sequence[str]

    @abstractmethod
    def views(self, display: str) -> Sequence[str]:
        """Names of a display's views."""

    @abstractmethod
    def default_view(self, display: str) -> str:
        """Name of the view that a display shows by default."""

    @abstractmethod
    def resolve(self, space: str) -> str:
        """A colour space's own name for a name, alias or role; '' for others."""

    @abstractmethod
    def is_linear(self, space: str) -> bool:
        """Whether a colour space holds scene-linear light."""

    @abstractmethod
    def interop_id(self, space: str) -> str:
        """A colour space's identifier of the Color Interop Forum, '' without one."""

    @abstractmethod
    def show(self, source: str, display: str, view: str) -> Colours:
        """From a colour space to code values of a display."""

    @abstractmethod
    def convert(self, source: str, target: str) -> Colours:
        """From a colour space to another."""

    @abstractmethod
    def look_up(self, file: str) -> Colours:
        """A look-up table in a file."""


def version() -> str:
    """Version of the OpenColorIO in use."""
    return (metadata.version(OCIO_PACKAGE) if is_installed()
            else str(oiio.get_string_attribute("opencolorio_version")))


def is_installed() -> bool:
    """Whether the package is there; it is not imported."""
    return find_spec(_MODULE) is not None


@cache
def load(name: str) -> Config:
    """The config in a file, or a built-in one as ocio://NAME. Raises ColourError where it cannot be
    read."""
    config: Config = _OfPackage(name) if is_installed() else _OfOpenImageIO(name)
    if not config.displays:
        raise _unreadable(name, "it has no displays")
    return config


def _unreadable(name: str, why: str) -> ColourError:
    is_old = name.startswith("ocio://") and not is_installed()
    newer = (f" This is OpenColorIO {version()}; a newer one comes by {pip_install('ocio')}"
             if is_old else "")
    return ColourError(f"{name}: not a readable OpenColorIO config: {why}{newer}")


class _OfPackage(Config):
    def __init__(self, name: str) -> None:
        self._library: Any = import_module(_MODULE)
        self._faults = self._library.Exception, self._library.ExceptionMissingFile
        try:
            self._config = self._library.Config.CreateFromFile(name)
            self._config.validate()
        except self._faults as error:
            raise _unreadable(name, str(error).partition("\n")[0]) from error
        except UnicodeDecodeError as error:
            raise _unreadable(name, "it holds bytes that are no text") from error
        self.displays = tuple(self._config.getDisplays())
        self.spaces = tuple(self._config.getColorSpaceNames())
        self.roles = tuple(self._config.getRoleNames())

    def views(self, display: str) -> Sequence[str]:
        return tuple(self._config.getViews(display))

    def default_view(self, display: str) -> str:
        return str(self._config.getDefaultView(display))

    def resolve(self, space: str) -> str:
        found = self._config.getColorSpace(space)
        return found.getName() if found else ""

    def is_linear(self, space: str) -> bool:
        return bool(self._config.isColorSpaceLinear(space, self._library.REFERENCE_SPACE_SCENE))

    def interop_id(self, space: str) -> str:
        return str(self._config.getColorSpace(space).getInteropID())

    def show(self, source: str, display: str, view: str) -> Colours:
        return self._by(self._library.DisplayViewTransform(source, display, view))

    def convert(self, source: str, target: str) -> Colours:
        return self._by(self._library.ColorSpaceTransform(source, target))

    def look_up(self, file: str) -> Colours:
        wanted = self._library.FileTransform(file, interpolation=self._library.INTERP_BEST)
        return self._by(wanted)

    def _by(self, transform: Any) -> Colours:
        """Colours by a transform of PyOpenColorIO, whose processor is made at the first call."""
        made: list[Any] = []

        def apply(colours: np.ndarray) -> np.ndarray:
            try:
                if not made:
                    made.append(self._config.getProcessor(transform).getDefaultCPUProcessor())
                out = np.array(colours, np.float32, order="C")
                made[0].applyRGB(out)
            except self._faults as error:
                raise RuntimeError(str(error)) from error
            return out

        return apply


class _OfOpenImageIO(Config):
    def __init__(self, name: str) -> None:
        self._name, self._config = name, oiio.ColorConfig(name)
        try:
            problem = self._config.geterror()
        except UnicodeDecodeError:
            problem = "it holds bytes that are no text"
        if problem:
            raise _unreadable(name, problem)
        self.displays = tuple(self._config.getDisplayNames())
        self.spaces = tuple(self._config.getColorSpaceNames())
        self.roles = tuple(self._config.getRoles())

    def views(self, display: str) -> Sequence[str]:
        return tuple(self._config.getViewNames(display))

    def default_view(self, display: str) -> str:
        return str(self._config.getDefaultViewName(display))

    def resolve(self, space: str) -> str:
        found = str(self._config.resolve(space))
        return found if found in self.spaces else ""

    def is_linear(self, space: str) -> bool:
        return bool(self._config.isColorSpaceLinear(space))

    def interop_id(self, space: str) -> str:
        return str(self._config.get_color_interop_id(space))

    def show(self, source: str, display: str, view: str) -> Colours:
        return self._by(lambda image: oiio.ImageBufAlgo.ociodisplay(
            image, display=display, view=view, fromspace=source, colorconfig=self._name,
            unpremult=False))

    def convert(self, source: str, target: str) -> Colours:
        return self._by(lambda image: oiio.ImageBufAlgo.colorconvert(
            image, fromspace=source, tospace=target, colorconfig=self._name, unpremult=False))

    def look_up(self, file: str) -> Colours:
        return self._by(lambda image: oiio.ImageBufAlgo.ociofiletransform(
            image, name=file, colorconfig=self._name, unpremult=False))

    def _by(self, transform: Callable[[oiio.ImageBuf], oiio.ImageBuf]) -> Colours:
        """Colours by a transform of OpenImageIO."""
        def apply(colours: np.ndarray) -> np.ndarray:
            result = transform(oiio.ImageBuf(np.ascontiguousarray(colours.reshape(-1, 1, 3),
                                                                  np.float32)))
            if result.has_error:
                raise RuntimeError(result.geterror())
            return np.asarray(result.get_pixels("float")).reshape(colours.shape)

        return apply
